"""The body: what is commanded is what the robot truly does."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from robot_runner.simulator.drive import DifferentialDrive
from robot_runner.simulator.model import Body, burger_model
from robot_runner.simulator.physics import Physics
from robot_runner.simulator.rooms import Wall
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

PARAMETERS = Turtlebot3Parameters()
RADII = (PARAMETERS.wheel_radius, PARAMETERS.wheel_radius)


@pytest.fixture
def drive():
    return DifferentialDrive(PARAMETERS, Physics(PARAMETERS, [Body(RADII)]))


def go(drive, seconds, linear=0.0, angular=0.0):
    drive.command(linear, angular)
    drive.advance(drive.steps + round(seconds * STEPS_PER_SECOND))


def test_ten_seconds_at_a_speed_and_a_stop_make_the_true_distance(drive):
    go(drive, 10, linear=0.2)
    go(drive, 1)
    assert drive.pose.x == pytest.approx(2.0, abs=0.004)
    assert drive.pose.y == pytest.approx(0.0, abs=0.002)
    assert drive.pose.yaw == pytest.approx(0.0, abs=0.002)


def test_the_speed_on_the_ground_is_the_commanded_one(drive):
    go(drive, 2, linear=0.15)
    before = drive.pose.x
    go(drive, 4, linear=0.15)
    assert (drive.pose.x - before) / 4 == pytest.approx(0.15, rel=0.002)


def test_it_drives_backwards(drive):
    go(drive, 5, linear=-0.1)
    go(drive, 1)
    assert drive.pose.x == pytest.approx(-0.5, abs=0.002)


@pytest.mark.parametrize("angular", [0.2, 0.5, 1.0, -1.0, 2.0])
def test_half_a_turn_in_place_is_half_a_turn(drive, angular):
    go(drive, math.pi / abs(angular), angular=angular)
    go(drive, 1)
    turned = math.degrees(drive.pose.yaw) * math.copysign(1, angular) % 360
    assert turned == pytest.approx(180, abs=0.5)
    assert math.hypot(drive.pose.x, drive.pose.y) < 0.005


def test_velocities_are_limited_to_what_the_robot_can_do(drive):
    go(drive, 2, linear=5.0)
    before = drive.pose.x
    go(drive, 5, linear=5.0)
    assert (drive.pose.x - before) / 5 == pytest.approx(0.22, rel=0.005)


def test_turning_is_limited_to_what_the_robot_can_do(drive):
    go(drive, 3, angular=100.0)
    assert drive.angular_velocity[2] == pytest.approx(2.84, rel=0.01)


def test_a_wheel_never_exceeds_its_highest_speed_when_both_limits_are_asked_for(drive):
    go(drive, 3, linear=0.22, angular=2.84)
    assert np.abs(drive.wheel_speeds).max() <= PARAMETERS.max_wheel_speed * 1.001


def test_at_rest_it_stays_where_it_is(drive):
    before = drive.pose
    go(drive, 60)
    assert not drive.is_moving
    assert math.hypot(drive.pose.x - before.x, drive.pose.y - before.y) < 1e-4


def test_it_moves_until_it_is_told_to_stop(drive):
    go(drive, 2, linear=0.1)
    assert drive.is_moving
    go(drive, 1)
    assert not drive.is_moving


def cruising_torque(model_text):
    model = mujoco.MjModel.from_xml_string(model_text)
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.2 / PARAMETERS.wheel_radius
    mujoco.mj_step(model, data, nstep=3 * STEPS_PER_SECOND)
    return float(np.abs(data.actuator_force).max())


def test_the_caster_does_not_drag():
    as_built = burger_model(Turtlebot3Parameters(rolling_resistance=0.0), RADII)
    dragging = as_built.replace('condim="1" priority="1"', "")
    assert dragging != as_built
    assert cruising_torque(as_built) < 0.001
    assert cruising_torque(dragging) > 0.02


def test_the_robot_weighs_what_its_parameters_say():
    model = mujoco.MjModel.from_xml_string(burger_model(PARAMETERS, RADII))
    assert model.body_mass.sum() == pytest.approx(PARAMETERS.mass)


def test_a_wall_stops_it(drive):
    go(drive, 60, linear=0.22)
    assert 3.5 < drive.pose.x < 4.0


def test_a_robot_that_pushed_a_wall_stands_still_once_it_is_put_back():
    drive = DifferentialDrive(PARAMETERS, Physics(PARAMETERS, [Body(RADII)], [Wall(0.3, 0.0, 0.05, 1.0)]))
    drive.command(0.2, 0.0)
    drive.advance(1000)
    drive.put_back()
    drive.advance(1200)
    assert math.hypot(drive.pose.x, drive.pose.y) < 1e-3
    assert drive.pose.yaw == pytest.approx(0.0, abs=1e-3)


def test_advancing_in_pieces_is_advancing_at_once(drive):
    other = DifferentialDrive(PARAMETERS, Physics(PARAMETERS, [Body(RADII)]))
    for one in (drive, other):
        one.command(0.2, 0.3)
    drive.advance(1000)
    for steps in (1, 7, 7, 300, 999, 1000):
        other.advance(steps)
    assert drive.pose == other.pose
    assert np.array_equal(drive.wheel_angles, other.wheel_angles)


def test_steps_that_were_made_are_not_repeated(drive):
    drive.command(0.2, 0.0)
    drive.advance(400)
    pose = drive.pose
    drive.advance(100)
    assert drive.steps == 400
    assert drive.pose == pose


def test_the_trace_outgrows_its_first_room(drive):
    go(drive, 30, linear=0.05)
    assert drive.wheel_angles.shape == (30 * STEPS_PER_SECOND + 1, 2)
    assert (np.diff(drive.wheel_angles[400:], axis=0) > 0).all()
    assert drive.motor_torques.shape == drive.wheel_speeds.shape == drive.wheel_angles.shape


def test_an_imu_at_rest_reads_gravity(drive):
    drive.advance(200)
    assert drive.acceleration == pytest.approx([0, 0, 9.81], abs=0.1)
    assert drive.angular_velocity == pytest.approx([0, 0, 0], abs=1e-3)
    assert drive.orientation == pytest.approx((0, 0, 0, 1), abs=0.01)


def test_to_read_the_imu_changes_nothing(drive):
    other = DifferentialDrive(PARAMETERS, Physics(PARAMETERS, [Body(RADII)]))
    for one in (drive, other):
        go(one, 1, linear=0.05, angular=1.0)
    first = drive.angular_velocity
    for one in (drive, other):
        go(one, 1, linear=0.05, angular=-1.0)
    assert first[2] == pytest.approx(1.0, rel=0.02)
    assert np.array_equal(drive.wheel_speeds, other.wheel_speeds)
    assert drive.pose == other.pose


def test_what_the_physics_leaves_out_changes_nothing():
    walls = (Wall(0.3, 0.0, 0.05, 1.0, 0.2, 0.5), Wall(0.0, 0.3, 1.0, 0.05, -0.3, 0.5))
    usual, whole = (Physics(PARAMETERS, [Body(RADII)], walls) for _ in range(2))
    model, _ = whole.parts
    model.opt.disableflags = 0
    drives = [DifferentialDrive(PARAMETERS, each) for each in (usual, whole)]
    for angular in (0.0, 2.0, -1.0):  # into the walls' corner, and along them
        for each in drives:
            go(each, 2, linear=0.22, angular=angular)
    assert drives[0].pose.x < 0.3, "the robot came through the wall"
    assert np.array_equal(drives[0].motor_torques, drives[1].motor_torques)
    assert drives[0].pose == drives[1].pose


def test_mujoco_does_not_look_at_the_clock_while_it_steps():
    physics = Physics(PARAMETERS, [Body(RADII)])
    physics.advance(100)
    _, data = physics.parts
    assert data.timer.number.any(), "it no longer counts its steps by these"
    assert not data.timer.duration.any()
