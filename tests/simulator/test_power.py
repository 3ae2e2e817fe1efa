"""The power levels of the paper's Fig. 4, and whole missions."""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import mean, stdev

import numpy as np
import pytest

from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

TASKS = ("computation", "video", "network")
SEEDS = range(5)


class Mission:
    """The circular mission of Fig. 4, noting the mean power of each phase."""

    def __init__(self, task, seed, parameters=None):
        self._simulation = Simulation(seed, parameters=parameters)
        self._robot = self._simulation.turtlebot3()
        self.phases = {}
        self._phase("asleep", 5)
        self._drive("forward", 10, 0.2, 0.0)
        for _ in range(3):
            self._phase("awake", 5)
            assert self._robot.call(f"task/{task}/start")["success"]
            self._phase("task", 10)
            assert self._robot.call(f"task/{task}/stop")["success"]
        self._phase("awake", 5)
        self._drive("turning", math.pi / 0.2, 0.0, 0.2)
        self._drive("forward", 10, 0.2, 0.0)
        self._phase("awake", 5)
        self.energy = self._robot.energy
        self._simulation.close()

    def _drive(self, name, seconds, linear, angular):
        self._robot.drive(linear, angular)
        self._phase(name, seconds)
        self._robot.drive(0.0, 0.0)

    def _phase(self, name, seconds):
        before = self._robot.energy
        self._simulation.clock.sleep(seconds)
        self.phases.setdefault(name, []).append((self._robot.energy - before) / seconds)


@pytest.fixture(scope="module")
def missions():
    return {task: [Mission(task, seed) for seed in SEEDS] for task in TASKS}


def levels(missions, task, phase):
    return [level for mission in missions[task] for level in mission.phases[phase]]


@pytest.mark.long
@pytest.mark.parametrize(
    ("task", "phase", "level"),
    [
        ("video", "asleep", 7.6),
        ("video", "awake", 8.0),
        ("video", "forward", 10.5),
        ("video", "task", 9.5),
        ("computation", "task", 9.5),
        ("network", "task", 8.25),
    ],
)
def test_each_phase_draws_what_the_paper_shows(missions, task, phase, level):
    found = levels(missions, task, phase)
    assert mean(found) == pytest.approx(level, abs=0.12)
    assert all(abs(one - level) < 0.35 for one in found)


@pytest.mark.long
def test_sleep_costs_more_after_the_first_movement_than_before_it(missions):
    for task in TASKS:
        for mission in missions[task]:
            assert min(mission.phases["awake"]) > mission.phases["asleep"][0] + 0.2


@pytest.mark.long
def test_movement_draws_the_most(missions):
    for task in TASKS:
        for mission in missions[task]:
            assert min(mission.phases["forward"]) > max(mission.phases["task"])


@pytest.mark.long
def test_computation_and_video_are_above_network_in_all_runs_by_more_than_the_noise(missions):
    network = [mission.energy for mission in missions["network"]]
    for task in ("computation", "video"):
        energies = [mission.energy for mission in missions[task]]
        assert min(energies) > max(network) + stdev(network)


@pytest.mark.long
def test_a_whole_mission_is_of_the_paper_s_order_of_magnitude(missions):
    assert mean(mission.energy for mission in missions["video"]) == pytest.approx(877, rel=0.03)
    assert mean(mission.energy for mission in missions["network"]) == pytest.approx(719, rel=0.25)


@pytest.mark.long
def test_runs_differ_by_half_a_percent_or_so(missions):
    for task in TASKS:
        energies = [mission.energy for mission in missions[task]]
        assert 0.002 < stdev(energies) / mean(energies) < 0.01
        assert all(one != other for one, other in pairwise(sorted(energies)))


@pytest.mark.long
def test_a_task_that_draws_ten_percent_more_shows(missions):
    costly = Mission("video", 0, Turtlebot3Parameters(task_power_factor=1.1))
    usual = missions["video"][0]
    assert mean(costly.phases["task"]) / mean(usual.phases["task"]) == pytest.approx(1.1, abs=0.005)
    assert mean(costly.phases["awake"]) == pytest.approx(mean(usual.phases["awake"]), abs=0.01)


def test_without_noise_the_levels_are_exact():
    quiet = Turtlebot3Parameters(
        run_power_deviation=0, task_power_deviation=0, sample_power_deviation=0, wandering_power_deviation=0
    )
    simulation = Simulation(seed=1, parameters=quiet)
    robot = simulation.turtlebot3()
    simulation.clock.sleep(2)
    asleep = robot.energy
    robot.call("task/network/start")
    simulation.clock.sleep(2)
    assert asleep == pytest.approx(2 * 7.6, rel=0.005)
    assert robot.energy - asleep == pytest.approx(2 * (7.6 + 8.25 - 7.95), rel=0.005)


def test_power_does_not_depend_on_how_often_somebody_looks():
    def energies(pieces):
        simulation = Simulation(seed=5)
        robot = simulation.turtlebot3()
        robot.drive(0.2, 0.1)
        for piece in pieces:
            simulation.clock.sleep(piece)
            energy = robot.energy
        return energy

    assert energies([8.0]) == energies([0.005, 0.995, 3.3, 0.7, 3.0])


def test_accelerating_draws_more_than_cruising():
    simulation = Simulation(seed=1)
    robot = simulation.turtlebot3()
    robot.drive(0.22, 0.0)
    simulation.clock.sleep(5)
    assert robot.energy > 0
    power = robot._supply.power
    assert np.mean(power[15:40]) > np.mean(power[600:]) + 0.15
