"""CPU and memory utilisation of the on-board computer."""

from __future__ import annotations

from statistics import mean, stdev

import pytest

from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

QUIET = Turtlebot3Parameters(cpu_deviation=0, memory_deviation=0, run_cpu_deviation=0, run_memory_deviation=0)


def sampled(parameters, act, *, seconds=2.0, rate=10, seed=1):
    simulation = Simulation(seed, parameters=parameters)
    robot = simulation.turtlebot3()
    act(robot)
    simulation.clock.sleep(1.0)
    start = simulation.clock.now_ns
    simulation.clock.sleep(seconds)
    return robot.utilisation(start_ns=start, stop_ns=simulation.clock.now_ns, rate=rate)


def rest(robot):
    assert not robot.is_moving


@pytest.mark.parametrize(
    ("act", "cpu", "memory"),
    [
        (rest, 11.0, 23.5),
        (lambda robot: robot.drive(0.1, 0.0), 14.0, 23.5),
        (lambda robot: robot.call("task/computation/start"), 36.0, 23.9),
        (lambda robot: robot.call("task/video/start"), 25.4, 27.3),
        (lambda robot: robot.call("task/network/start"), 29.5, 24.45),
    ],
)
def test_it_depends_on_task_and_motion(act, cpu, memory):
    samples = sampled(QUIET, act)
    assert [sample.cpu for sample in samples] == pytest.approx([cpu] * 20)
    assert [sample.memory for sample in samples] == pytest.approx([memory] * 20)


def test_samples_come_at_the_rate_from_one_period_after_the_start():
    samples = sampled(QUIET, rest, seconds=1.0, rate=10)
    assert [sample.time for sample in samples] == pytest.approx([1.1 + number / 10 for number in range(10)])


@pytest.mark.parametrize(("seconds", "rate", "count"), [(0.05, 10, 0), (0.3, 10, 3), (1.0, 3, 3), (1.0, 200, 200)])
def test_only_whole_periods_are_sampled(seconds, rate, count):
    assert len(sampled(QUIET, rest, seconds=seconds, rate=rate)) == count


def test_a_sample_is_the_mean_since_the_one_before():
    simulation = Simulation(seed=1, parameters=QUIET)
    robot = simulation.turtlebot3()
    simulation.clock.sleep(0.5)
    robot.call("task/computation/start")
    simulation.clock.sleep(0.5)
    [sample] = robot.utilisation(start_ns=0, stop_ns=simulation.clock.now_ns, rate=1)
    assert sample.cpu == pytest.approx(11.0 + 25.0 / 2, abs=0.2)
    assert sample.memory == pytest.approx(23.9)


@pytest.mark.long
def test_noise_is_seeded():
    def cpus(seed):
        return [sample.cpu for sample in sampled(None, rest, seconds=20.0, seed=seed)]

    assert cpus(1) == cpus(1)
    assert cpus(1) != cpus(2)
    assert mean(cpus(1)) == pytest.approx(11.0, abs=1.5)
    assert stdev(cpus(1)) == pytest.approx(1.5, abs=0.3)


@pytest.mark.long
def test_runs_differ_more_than_their_many_samples_would_make_them():
    means = [mean(sample.cpu for sample in sampled(None, rest, seconds=15.0, seed=seed)) for seed in range(12)]
    assert mean(means) == pytest.approx(11.0, abs=0.4)
    assert 0.2 < stdev(means) < 0.8


def test_utilisation_stays_a_percentage():
    wild = Turtlebot3Parameters(cpu_idle=99, cpu_deviation=20, memory_idle=1, memory_deviation=20)
    samples = sampled(wild, rest, seconds=10.0)
    assert all(0 <= sample.cpu <= 100 and 0 <= sample.memory <= 100 for sample in samples)
    assert max(sample.cpu for sample in samples) == 100
