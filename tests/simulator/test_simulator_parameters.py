"""The robot's figures: sane, and documented with value and source."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import NoiseStreams, Turtlebot3Parameters

DOCUMENT = Path(__file__).parents[2] / "docs" / "simulator-parameters.md"


def documented():
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+) \| [^|]+ \| ([^|]+) \|$", DOCUMENT.read_text("utf-8"), re.MULTILINE)
    return {name: (float(value), source.strip()) for name, value, source in rows}


def test_value_and_source_of_every_parameter_are_documented():
    rows = documented()
    assert {name: value for name, (value, _) in rows.items()} == {
        parameter.name: parameter.default for parameter in fields(Turtlebot3Parameters)
    }
    assert all(source for _, source in rows.values())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("mass", 0), ("asleep_power", -1), ("meter_rate", 0), ("video_power", math.nan)],
        *[
            ("rolling_resistance", -0.1),
            ("floor_slope", 101),
            ("floor_slope", math.nan),
            ("battery_temperature", -40),
            ("battery_temperature", 90),
        ],
        # Its two wheels weigh 57 g; and nothing happens more often than at each point of the simulation's grid.
        *[("mass", 0.05), ("odometry_rate", 201), ("imu_rate", 400), ("scan_rate", 1000), ("meter_rate", 201)],
        # No share is above the whole; and what the meter says of its shunt are whole microhms of 32 bits.
        *[("initial_charge", 150), ("motor_efficiency", 101), ("turning_motor_share", 101), ("cpu_idle", 101)],
        *[("memory_video", 101), ("meter_shunt", 1e-7), ("meter_shunt", 5000), ("scan_minimum", 4)],
        *[("meter_rate", 10**400), ("encoder_ticks", 10**400), ("mass", 10**400)],
        *[("mass", True), ("mass", "1"), ("mass", None), ("odometry_rate", 30.5)],
    ],
)
def test_figures_that_cannot_be_are_refused(name, value):
    with pytest.raises(LinkError, match=name):
        Turtlebot3Parameters(**{name: value})


def test_a_floor_may_fall_and_a_battery_be_colder_than_ice():
    parameters = Turtlebot3Parameters(floor_slope=-5.0, battery_temperature=-10.0)
    assert (parameters.floor_slope, parameters.battery_temperature) == (-5.0, -10.0)


@pytest.mark.parametrize(("name", "value"), [("body_height", 0.01), ("wheel_mass", 1e-16), ("wheel_radius", 1e-9)])
def test_a_body_that_the_physics_does_not_take_is_refused_with_a_reason(name, value):
    simulation = Simulation(1, parameters=Turtlebot3Parameters(**{name: value}))
    with pytest.raises(LinkError, match=r"MuJoCo does not take the simulated robot: .*must be") as refused:
        simulation.robot()
    assert "parameters" in refused.value.fix


@pytest.mark.parametrize("name", ["initial_charge", "sample_power_deviation", "cpu_idle", "memory_video"])
def test_noise_and_load_may_be_zero(name):
    assert getattr(Turtlebot3Parameters(**{name: 0}), name) == 0


def test_a_number_has_the_same_noise_however_it_is_asked_for():
    numbers = [3, 4, 255, 256, 700, 2, 256]  # of three blocks, and back
    together = NoiseStreams(7, "/alice").numbered("imu", width=6).at(numbers)
    by_itself = NoiseStreams(7, "/alice").numbered("imu", width=6)
    assert [each.tolist() for each in together] == [by_itself.of(number).tolist() for number in numbers]
    assert by_itself.at([]).shape == (0, 6)
