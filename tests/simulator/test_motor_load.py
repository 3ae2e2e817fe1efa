"""What mass, floor and slope cost: the motors' load, and the current that it takes."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from robot_runner.simulator.drive import DifferentialDrive
from robot_runner.simulator.model import Body
from robot_runner.simulator.physics import Physics
from robot_runner.simulator.rooms import Pose, Room
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.supply import motor_power
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

QUIET = {
    "run_power_deviation": 0,
    "task_power_deviation": 0,
    "sample_power_deviation": 0,
    "wandering_power_deviation": 0,
    "wheel_radius_deviation": 0,
}
RADIUS, GRAVITY, SPEED = 0.033, 9.81, 0.2


def driven(**changed):
    """Return a robot that has driven ahead at 0.2 m/s for 5 s, and its simulation."""
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(**QUIET, **changed))
    robot = simulation.turtlebot3()
    robot.drive(changed.pop("speed", SPEED), 0.0)
    simulation.clock.sleep(5.0)
    return simulation, robot


def cruise_power(**changed):
    """Return the mean power in watts of a robot that cruises at 0.2 m/s."""
    simulation, robot = driven(**changed)
    before = robot.energy
    simulation.clock.sleep(5.0)
    return (robot.energy - before) / 5.0


def test_cruising_costs_what_the_paper_says_whatever_is_new_in_the_model():
    # 7.95 W awake, and of the 2.55 W that 0.22 m/s cost more, 70 % and the rest in proportion to the speed.
    assert cruise_power() == pytest.approx(7.95 + 2.55 * (0.7 + 0.3 * 0.2 / 0.22), abs=0.002)


def test_a_heavier_robot_draws_more():
    powers = [cruise_power(mass=mass) for mass in (1.0, 1.5, 2.0, 3.0)]
    assert all(later > sooner + 0.02 for sooner, later in pairwise(powers))


def test_a_floor_that_resists_more_costs_more():
    powers = [cruise_power(rolling_resistance=share) for share in (0.0, 0.015, 0.05, 0.1)]
    assert all(later > sooner + 0.04 for sooner, later in pairwise(powers))


def test_up_costs_more_than_level_and_down_less_and_up_more_than_down_saves():
    down, level, up = (cruise_power(floor_slope=slope) for slope in (-5, 0, 5))
    assert down < level < up
    assert up - level > level - down


def test_the_motors_cost_what_a_calculation_by_hand_says():
    # The rest of the power is that of a robot of 1 kg on a level floor, as published.
    # Two wheels share the weight's 1.5 % and the slope's pull; gears and motor as in the data sheet: 1.4 N m take
    # 1.3 A at 11.1 V, and 57.9 % of what the rotor turns with arrives at the wheel.
    mass, slope = 2.0, 6.0
    angle = math.atan(slope / 100)
    torque = mass * GRAVITY * (0.015 * math.cos(angle) + math.sin(angle)) * RADIUS / 2
    current = torque / (1.4 / 1.3)
    each = current**2 * (11.1 / 1.3) + torque * (SPEED / RADIUS) / 0.579
    reference_torque = 1.0 * GRAVITY * 0.015 * RADIUS / 2
    reference_current = reference_torque / (1.4 / 1.3)
    reference = reference_current**2 * (11.1 / 1.3) + reference_torque * (SPEED / RADIUS) / 0.579
    found = cruise_power(mass=mass, floor_slope=slope) - cruise_power()
    assert found == pytest.approx(2 * (each - reference), rel=0.01)


def test_the_torque_is_that_of_rolling_resistance_and_slope():
    for mass, slope in ((1.0, 0.0), (3.0, 0.0), (1.5, 10.0), (3.0, -10.0)):
        parameters = Turtlebot3Parameters(mass=mass, floor_slope=slope)
        drive = DifferentialDrive(parameters, Physics(parameters, [Body((RADIUS, RADIUS))]))
        drive.command(SPEED, 0.0)
        drive.advance(1600)
        angle = math.atan(slope / 100)
        expected = mass * GRAVITY * (0.015 * math.cos(angle) + math.sin(angle)) * RADIUS / 2
        assert drive.motor_torques[1200:].mean(axis=0) == pytest.approx([expected, expected], rel=0.01)


def test_at_stall_a_motor_takes_the_current_of_the_data_sheet():
    power = motor_power(np.array([[1.4, 0.0]]), np.array([[0.0, 0.0]]), Turtlebot3Parameters())
    assert power == pytest.approx([1.3 * 11.1])


def test_a_motor_that_is_pushed_gives_nothing_back():
    assert motor_power(np.array([[-0.05, -0.05]]), np.array([[6.0, 6.0]]), Turtlebot3Parameters()) == [0.0]


@pytest.mark.parametrize("changed", [{"mass": 3.0}, {"rolling_resistance": 0.1}, {"floor_slope": 10.0, "mass": 2.0}])
def test_the_speed_stays_the_commanded_one_under_load(changed):
    simulation, robot = driven(**changed)
    before = robot.pose.x
    simulation.clock.sleep(5.0)
    assert (robot.pose.x - before) / 5.0 == pytest.approx(SPEED, rel=0.005)


def test_a_robot_on_a_slope_stays_where_it_is_and_pays_for_it():
    level = Simulation(seed=1, parameters=Turtlebot3Parameters(**QUIET))
    steep = Simulation(seed=1, parameters=Turtlebot3Parameters(**QUIET, floor_slope=15.0, mass=3.0))
    for simulation in (level, steep):
        simulation.turtlebot3()
        simulation.clock.sleep(2.0)
    before = steep.turtlebot3().pose.x
    for simulation in (level, steep):
        simulation.clock.sleep(30.0)
    assert steep.turtlebot3().pose.x == pytest.approx(before, abs=0.005)
    assert steep.turtlebot3().energy > level.turtlebot3().energy + 1.0


@pytest.mark.parametrize("yaw", [0.0, 0.8, math.pi / 2, math.pi, -2.0])
def test_whichever_way_it_faces_a_robot_stands_still_on_a_slope_until_it_is_commanded(yaw):
    parameters = Turtlebot3Parameters(**QUIET, floor_slope=15.0)
    simulation = Simulation(seed=1, parameters=parameters, room=Room((), {"": Pose(1.0, 2.0, yaw)}))
    robot = simulation.turtlebot3()
    for _ in range(2):
        simulation.clock.sleep(3.0)
        assert math.hypot(robot.pose.x - 1.0, robot.pose.y - 2.0) < 2e-3
        assert robot.pose.yaw == pytest.approx(yaw, abs=2e-3)
        robot.put_back()
    simulation.clock.sleep(1.0)
    assert robot.energy / 7.0 < 7.7, "it drew the power of a robot that has moved"


def test_on_a_floor_without_grip_a_slope_cannot_be_climbed():
    climbed = [driven(floor_slope=15.0, floor_friction=grip)[1].pose.x for grip in (1.0, 0.1)]
    assert climbed[0] > 0.9
    assert climbed[1] < 0.1


def test_an_imu_on_a_slope_tells_of_it():
    parameters = Turtlebot3Parameters(floor_slope=10.0)
    drive = DifferentialDrive(parameters, Physics(parameters, [Body((RADIUS, RADIUS))]))
    drive.advance(200)
    angle = math.atan(0.1)
    assert drive.acceleration == pytest.approx([9.81 * math.sin(angle), 0, 9.81 * math.cos(angle)], abs=0.05)
    x, y, z, w = drive.orientation
    pitch = math.asin(2 * (w * y - z * x))
    assert pitch == pytest.approx(-angle, abs=0.005)  # REP 103: a nose that points up has a negative pitch


def test_the_same_seed_is_the_same_run_on_any_floor():
    changed = {"mass": 2.0, "floor_slope": 5.0, "rolling_resistance": 0.04, "battery_temperature": -5.0}
    energies = set()
    for _ in range(2):
        simulation = Simulation(seed=9, parameters=Turtlebot3Parameters(**changed))
        simulation.turtlebot3().drive(0.2, 0.3)
        simulation.clock.sleep(7.0)
        energies.add((simulation.turtlebot3().energy, simulation.turtlebot3().pose))
    assert len(energies) == 1
