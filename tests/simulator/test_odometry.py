"""Odometry: what the encoders say, near to the truth but not the truth."""

from __future__ import annotations

import math

import pytest

from robot_runner.simulator.drive import DifferentialDrive, WheelOdometry
from robot_runner.simulator.model import Body
from robot_runner.simulator.physics import Physics
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

PARAMETERS = Turtlebot3Parameters()
RADII = (PARAMETERS.wheel_radius, PARAMETERS.wheel_radius)
TICK = 2 * math.pi * PARAMETERS.wheel_radius / PARAMETERS.encoder_ticks


@pytest.fixture
def drive():
    return DifferentialDrive(PARAMETERS, Physics(PARAMETERS, [Body(RADII)]))


def odometry_of(drive, phases=(0.3, 0.7)):
    return WheelOdometry(PARAMETERS, drive, phases)


def test_it_begins_at_zero(drive):
    state = odometry_of(drive).latest()
    assert (state.x, state.y, state.yaw, state.linear, state.angular) == (0, 0, 0, 0, 0)


def test_a_straight_way_is_near_the_truth(drive):
    odometry = odometry_of(drive)
    drive.command(0.2, 0.0)
    drive.advance(2000)
    state = odometry.latest()
    assert state.x == pytest.approx(drive.pose.x, abs=0.005)
    assert state.linear == pytest.approx(0.2, abs=TICK / 0.03)


def test_an_arc_is_near_the_truth(drive):
    odometry = odometry_of(drive)
    drive.command(0.1, 0.4)
    drive.advance(1400)
    state, pose = odometry.latest(), drive.pose
    assert math.hypot(state.x - pose.x, state.y - pose.y) < 0.01
    assert state.yaw == pytest.approx(pose.yaw, abs=0.02)
    assert state.angular == pytest.approx(0.4, abs=0.1)


def test_the_heading_stays_within_half_a_turn_either_way(drive):
    odometry = odometry_of(drive)
    drive.command(0.0, 1.0)
    drive.advance(1000)
    assert odometry.latest().yaw == pytest.approx(math.remainder(drive.pose.yaw, 2 * math.pi), abs=0.03)


def test_it_does_not_depend_on_when_somebody_looks(drive):
    often, once = odometry_of(drive), odometry_of(drive)
    drive.command(0.2, 0.5)
    for steps in range(0, 600, 7):
        drive.advance(steps)
        often.latest()
    assert often.latest() == once.latest()


def test_larger_wheels_go_farther_than_the_odometry_says():
    drive = DifferentialDrive(PARAMETERS, Physics(PARAMETERS, [Body((0.0335, 0.0335))]))
    odometry = odometry_of(drive)
    drive.command(0.2, 0.0)
    drive.advance(2000)
    assert drive.pose.x / odometry.latest().x == pytest.approx(0.0335 / 0.033, abs=0.002)


def test_a_robot_that_is_put_back_while_it_drives_has_covered_nothing_since(drive):
    odometry = odometry_of(drive)
    drive.command(0.2, 0.0)
    drive.advance(206)  # the encoders were read at step 200, and it drove on for 6 mm
    drive.put_back()
    odometry.restart()
    drive.advance(400)
    assert odometry.latest().x == pytest.approx(0.0, abs=2 * TICK)
