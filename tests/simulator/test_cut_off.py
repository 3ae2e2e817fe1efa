"""A battery below its cut-off voltage: the motors are switched off, and the run says so."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.simulator.simulated_link import SimulatedRobotLink
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

TWIST = "geometry_msgs/Twist"
#: 0.4 % of 71.9 kJ last for about half a minute.
NEARLY_EMPTY = 0.8


def made(seed=1, **changed):
    simulation = Simulation(seed, parameters=Turtlebot3Parameters(**{"initial_charge": NEARLY_EMPTY} | changed))
    return simulation, simulation.turtlebot3()


def test_below_the_cut_off_the_robot_stands_still_and_draws_no_more_for_its_motors():
    simulation, robot = made()
    robot.drive(0.05, 0.0)
    simulation.clock.sleep(2.0)
    assert robot.is_moving
    assert robot.cut_off is None
    simulation.clock.sleep(60.0)
    assert not robot.is_moving
    assert robot.cut_off is not None
    assert robot.cut_off.voltage < 9.0
    assert 2.0 < robot.cut_off.time < 60.0
    where, before = robot.pose, robot.energy
    simulation.clock.sleep(5.0)
    assert (robot.pose.x, robot.pose.y) == pytest.approx((where.x, where.y), abs=1e-4)
    assert (robot.energy - before) / 5.0 == pytest.approx(7.95, abs=0.2)  # awake, without motors


def test_a_robot_that_may_drain_its_battery_goes_on():
    simulation, robot = made(cut_off_voltage=0.0)
    robot.drive(0.05, 0.0)
    simulation.clock.sleep(60.0)
    assert robot.is_moving
    assert robot.cut_off is None


@pytest.mark.long
def test_when_it_is_does_not_depend_on_how_often_somebody_looks():
    def cut_off(pieces):
        simulation, robot = made(seed=4)
        robot.drive(0.05, 0.1)
        for piece in pieces:
            simulation.clock.sleep(piece)
            assert robot.energy > 0
        return robot.cut_off, robot.energy, robot.pose

    assert cut_off([100.0]) == cut_off([0.013] * 1000 + [7.0, 0.5, 79.5])


def test_a_command_to_move_after_it_is_refused_with_voltage_and_time():
    simulation, robot = made()
    link = SimulatedRobotLink(simulation)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.05}})
    simulation.clock.sleep(60.0)
    with pytest.raises(LinkError, match=r"below its cut-off of 9 V.*motors are switched off") as caught:
        link.publish("cmd_vel", TWIST, {"linear": {"x": 0.05}})
    assert f"{robot.cut_off.time:.0f} s" in caught.value.problem
    assert "initial_charge" in caught.value.fix
    link.publish("cmd_vel", TWIST, {})  # to stand still is no fault
    link.close()  # it was said already


def test_a_run_that_commands_nothing_after_it_is_told_when_its_link_is_closed():
    simulation, _ = made()
    link = SimulatedRobotLink(simulation)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.05}})
    simulation.clock.sleep(60.0)
    with pytest.raises(LinkError, match="motors are switched off"):
        link.close()


def test_a_run_whose_robot_stood_still_before_it_has_lost_nothing():
    simulation, robot = made()
    link = SimulatedRobotLink(simulation)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.05}})
    simulation.clock.sleep(2.0)
    link.publish("cmd_vel", TWIST, {})
    simulation.clock.sleep(60.0)
    assert robot.cut_off is not None
    link.close()


def test_a_link_that_only_listened_is_closed_in_peace():
    simulation, robot = made()
    link = SimulatedRobotLink(simulation)
    robot.drive(0.05, 0.0)
    simulation.clock.sleep(60.0)
    assert robot.cut_off is not None
    link.close()


@pytest.mark.long
def test_the_battery_says_that_it_is_dead():
    simulation, robot = made()
    robot.drive(0.05, 0.0)
    healths = []
    robot.topics["battery_state"].listen(lambda message: healths.append(message["power_supply_health"]))
    simulation.clock.sleep(60.0)
    assert (healths[0], healths[-1]) == (1, 3)  # POWER_SUPPLY_HEALTH_GOOD, POWER_SUPPLY_HEALTH_DEAD


def test_a_cold_battery_is_cut_off_sooner():
    times = []
    for temperature in (25.0, -10.0):
        simulation, robot = made(battery_temperature=temperature)
        robot.drive(0.0, 0.5)
        simulation.clock.sleep(60.0)
        times.append(robot.cut_off.time)
    assert times[1] < times[0]


def test_motors_whose_gears_lose_more_than_the_battery_bears_are_switched_off():
    # 195 W where the robot climbs at its speed: the voltage falls below 9 V long before the battery is empty.
    simulation, robot = made(initial_charge=80.0, motor_efficiency=2.0, mass=8.0, floor_slope=20.0)
    robot.drive(0.22, 0.0)
    simulation.clock.sleep(3.0)
    assert robot.cut_off is not None
