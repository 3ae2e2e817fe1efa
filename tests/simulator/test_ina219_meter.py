"""The power meter as a device on a line: what it sends, and when it arrives."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_runner.simulator.power_meter import CONFIGURATION
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters


def split(data):
    """Return the frames of an undisturbed stream as (type, sequence, payload)."""
    frames = []
    while data:
        assert data[:2] == b"\xa5\x5a"
        length = data[3]
        frames.append((data[2], struct.unpack_from("<H", data, 4)[0], data[6 : 6 + length]))
        data = data[8 + length :]
    return frames


def bytes_of(meter):
    return b"".join(arrival.data for arrival in meter.arrived())


def samples_of(frames):
    return [(sequence, *struct.unpack("<IhH", payload)) for kind, sequence, payload in frames if kind == 0x11]


@pytest.fixture
def simulation():
    return Simulation(seed=11)


def test_it_begins_with_a_hello_and_sends_one_a_second(simulation):
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(3.5)
    frames = split(bytes_of(meter))
    assert [index for index, frame in enumerate(frames) if frame[0] == 0x12] == [0, 201, 402, 603]
    kind, sequence, payload = frames[201]
    assert (kind, sequence) == (0x12, 200)
    assert struct.unpack("<IHIH", payload) == (1_000_000, 200, 100_000, CONFIGURATION)


def test_it_samples_two_hundred_times_a_second_by_its_own_clock(simulation):
    simulation.clock.sleep(1.2345)
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(10)
    samples = samples_of(split(bytes_of(meter)))
    assert len(samples) == 2000
    assert [sample[0] for sample in samples] == list(range(2000))
    assert [sample[1] for sample in samples] == list(range(0, 10_000_000, 5000))


def test_its_registers_give_the_robot_s_power(simulation):
    robot = simulation.turtlebot3()
    meter = robot.open_power_meter()
    simulation.clock.sleep(20)
    samples = samples_of(split(bytes_of(meter)))
    powers = [(bus >> 3) * 4e-3 * shunt * 10e-6 / 0.1 for _, _, shunt, bus in samples]
    assert np.mean(powers) == pytest.approx(robot.energy / 20, rel=0.001)
    assert all(bus & 0b111 == 0b010 for *_, bus in samples)


@pytest.mark.parametrize(
    ("parameters", "column", "shift", "limit"),
    [
        (Turtlebot3Parameters(asleep_power=20.0, meter_shunt=0.3), 2, 0, 32000),
        (Turtlebot3Parameters(battery_voltage=24.0), 3, 3, 4000),
    ],
)
def test_registers_stop_at_the_end_of_their_range(parameters, column, shift, limit):
    simulation = Simulation(seed=1, parameters=parameters)
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(0.5)
    samples = samples_of(split(bytes_of(meter)))
    assert {sample[column] >> shift for sample in samples} == {limit}


def test_bytes_arrive_in_packets_after_the_time_that_the_line_needs(simulation):
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(1)
    arrivals = meter.arrived()
    times = [arrival.received_at for arrival in arrivals]
    assert times == sorted(times)
    assert times[-1] <= simulation.clock.now()
    # what came without a pause comes together: a hello and the first sample, then one sample after the other
    assert [len(arrival.data) for arrival in arrivals] == [36, *(len(arrivals) - 1) * [16]]
    assert times[0] == pytest.approx(36 * 10 / 115200, abs=1e-6)
    assert times[1] == pytest.approx(5e-3 + 16 * 10 / 115200, abs=1e-6)


def test_nothing_arrives_twice_or_before_its_time(simulation):
    meter = simulation.turtlebot3().open_power_meter()
    assert meter.arrived() == []
    simulation.clock.sleep(0.002)
    assert meter.arrived() == []
    simulation.clock.sleep(0.1)
    assert meter.arrived()
    assert meter.arrived() == []


@pytest.mark.long
@settings(max_examples=settings.default.max_examples // 5)
@given(st.lists(st.integers(0, 400), min_size=1, max_size=12))
def test_the_stream_does_not_depend_on_when_it_is_read(milliseconds):
    def stream(durations):
        simulation = Simulation(seed=4)
        meter = simulation.turtlebot3().open_power_meter()
        simulation.turtlebot3().drive(0.2, 0.1)
        data = b""
        for duration in durations:
            simulation.clock.sleep(duration / 1000)
            data += bytes_of(meter)
        return data

    assert stream(milliseconds) == stream([sum(milliseconds)])


def test_it_answers_a_question_mark_with_a_hello_before_the_next_sample(simulation):
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(0.052)
    meter.write(b"x?")
    simulation.clock.sleep(0.1)
    frames = split(bytes_of(meter))
    assert [sequence for kind, sequence, _ in frames if kind == 0x12] == [0, 11]


def test_it_ignores_all_other_bytes(simulation):
    meter = simulation.turtlebot3().open_power_meter()
    meter.write(b"hello\x00")
    simulation.clock.sleep(0.5)
    assert [sequence for kind, sequence, _ in split(bytes_of(meter)) if kind == 0x12] == [0]


def test_opening_the_port_again_restarts_the_device(simulation):
    robot = simulation.turtlebot3()
    robot.open_power_meter()
    simulation.clock.sleep(2)
    again = robot.open_power_meter()
    simulation.clock.sleep(0.1)
    assert split(bytes_of(again))[1][:2] == (0x11, 0)


@pytest.mark.long
def test_numbers_and_hellos_go_on_after_the_wrap(simulation):
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(65520 / 200)
    bytes_of(meter)
    simulation.clock.sleep(2)
    frames = split(bytes_of(meter))
    assert 0 in {sequence for kind, sequence, _ in frames if kind == 0x11}
    assert [sequence for kind, sequence, _ in frames if kind == 0x12] == [0, 200]


def test_another_rate_is_said_and_kept():
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(meter_rate=50))
    meter = simulation.turtlebot3().open_power_meter()
    simulation.clock.sleep(2)
    frames = split(bytes_of(meter))
    assert struct.unpack_from("<H", frames[0][2], 4)[0] == 50
    assert len(samples_of(frames)) == 100
