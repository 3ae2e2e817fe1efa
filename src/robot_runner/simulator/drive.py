"""Odometry from the wheels' encoders, as the robot's firmware computes it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robot_runner.core.events.early_end import undivided
from robot_runner.simulator.model import rolling_torque, slope_angle
from robot_runner.simulator.physics import CORRECTION_STEPS, Physics
from robot_runner.simulator.physics_library import mujoco
from robot_runner.simulator.rooms import Pose
from robot_runner.simulator.simulated_clock import STEP_NS, STEPS_PER_SECOND, tick_time
from robot_runner.simulator.turtlebot3_parameters import Floats, Turtlebot3Parameters

#: A wheel that turns faster than this (rad/s; 1.7 mm/s on the ground) moves.
MOVING_WHEEL_SPEED = 0.05

#: A motor whose set point is nearer than this (rad/s) to its target has finished accelerating.
_SETTLED = 0.05


class DifferentialDrive:
    """Two driven wheels and a body, by its number in its world, advanced in steps of the simulation's grid.

    Row i of each trace is the state after i steps: `wheel_angles` (rad), `wheel_speeds` (rad/s) and
    `motor_torques` (N m), each with a column for the left and one for the right wheel.
    """

    def __init__(self, parameters: Turtlebot3Parameters, physics: Physics, number: int = 0) -> None:
        self._parameters = parameters
        self._physics = physics
        self._number = number
        self._body = self._physics.body(number)
        # Of the left and the right wheel. In Python's numbers, as NumPy is slower for only two.
        self._target = [0.0, 0.0]
        # The lead of the set points over the speeds, so that the motors bear their load at the commanded speed; on a
        # slope they hold the robot from the beginning.
        self._holding_lead: list[float] = self._body.set_points.tolist()
        self._lead = list(self._holding_lead)
        self._rolling_lead = rolling_torque(parameters) / parameters.servo_gain
        self._correction = CORRECTION_STEPS / STEPS_PER_SECOND / parameters.servo_settling_time
        self._physics.ride(self)

    @property
    def steps(self) -> int:
        """The number of steps since the beginning."""
        return self._physics.steps

    @property
    def wheel_angles(self) -> Floats:
        """The trace of the wheels' angles in rad, shape (steps + 1, 2)."""
        return self._physics.traces[0][: self.steps + 1, self._number]

    def wheel_angles_at(self, step: int) -> list[float]:
        """Return the wheels' angles in rad after `step` steps, left and right."""
        angles: list[float] = self._physics.traces[0][step, self._number].tolist()
        return angles

    @property
    def wheel_speeds(self) -> Floats:
        """The trace of the wheels' speeds in rad/s, shape (steps + 1, 2)."""
        return self._physics.traces[1][: self.steps + 1, self._number]

    @property
    def motor_torques(self) -> Floats:
        """The trace of the motors' torques in N m, shape (steps + 1, 2)."""
        return self._physics.traces[2][: self.steps + 1, self._number]

    @property
    def pose(self) -> Pose:
        """The true pose after the last step."""
        x, y, _, w, qx, qy, qz = map(float, self._body.pose)
        return Pose(x, y, math.atan2(2 * (w * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)))

    @property
    def orientation(self) -> tuple[float, float, float, float]:
        """The true orientation as a quaternion: x, y, z, w (ROS' order); z is vertical, not normal to the slope."""
        half = -slope_angle(self._parameters) / 2
        turned = np.empty(4)
        mujoco.mju_mulQuat(turned, np.array([math.cos(half), 0.0, math.sin(half), 0.0]), self._body.pose[3:7])
        w, x, y, z = turned.tolist()
        return x, y, z, w

    @property
    def angular_velocity(self) -> Floats:
        """The reading of an ideal gyroscope: rad/s in the robot's frame."""
        self.sense()
        return np.array(self._body.sensed[0:3])

    @property
    def acceleration(self) -> Floats:
        """The reading of an ideal accelerometer: m/s² in the robot's frame, including gravity."""
        self.sense()
        return np.array(self._body.sensed[3:6])

    @property
    def is_moving(self) -> bool:
        """Whether a wheel turns."""
        return bool(np.abs(self._body.wheel_speeds).max() > MOVING_WHEEL_SPEED)

    def sense(self) -> None:
        """Compute the inertial sensors from now on."""
        self._physics.sense()

    @undivided
    def command(self, linear: float, angular: float) -> None:
        """Drive at these velocities (m/s, rad/s), each within the robot's limits, until the next command."""
        limits = self._parameters
        forward = _limited(linear, limits.max_linear_velocity)
        turning = _limited(angular, limits.max_angular_velocity) * limits.wheel_separation / 2
        speeds = ((forward - turning) / limits.wheel_radius, (forward + turning) / limits.wheel_radius)
        targets = [_limited(speed, limits.max_wheel_speed) for speed in speeds]
        for wheel, target in enumerate(targets):
            self._lead[wheel] += (_sign(target) - _sign(self._target[wheel])) * self._rolling_lead
        self._target = targets
        self._set()

    def advance(self, steps: int) -> None:
        """Advance to this number of steps since the beginning; earlier ones are not repeated."""
        self._physics.advance(steps)

    def put_back(self) -> None:
        """Stop the robot, and put it back to its start, with motors that only hold it."""
        self._target, self._lead = [0.0, 0.0], list(self._holding_lead)
        self._set()
        self._physics.put_back(self._number)

    def correct(self) -> None:
        """Adjust the set points to the load: the integral part of the servo's speed control.

        During acceleration and braking most of the load is the robot's inertia, for which they are not adjusted.
        """
        lagging = self._body.lagging.tolist()
        if any(
            abs(point - lags) > _SETTLED for point, lags in zip(self._body.set_points.tolist(), lagging, strict=True)
        ):
            return
        for wheel, speed in enumerate(self._body.wheel_speeds.tolist()):
            self._lead[wheel] += self._correction * (lagging[wheel] - speed - self._lead[wheel])
        self._set()

    def _set(self) -> None:
        (left, right), (left_lead, right_lead) = self._target, self._lead
        self._body.set_points[:] = left + left_lead, right + right_lead


def _limited(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


_TURN = 2 * math.pi


class OdometryState(NamedTuple):
    """The pose (m, rad) and velocity (m/s, rad/s) of the robot by its wheels."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    linear: float = 0.0
    angular: float = 0.0

    def rolled(self, left: float, right: float, separation: float, seconds: float) -> OdometryState:
        """Return the state after the wheels, `separation` (m) apart, have rolled these ways (m): along an arc."""
        way, turn = (left + right) / 2, (right - left) / separation
        heading = self.yaw + turn / 2
        return OdometryState(
            self.x + way * math.cos(heading),
            self.y + way * math.sin(heading),
            math.remainder(self.yaw + turn, _TURN),
            way / seconds,
            turn / seconds,
        )


class WheelOdometry:
    """Counts encoder ticks at the odometry's rate and adds up arcs, also without subscribers.

    It uses the nominal wheel radius and separation; the true ones differ a little, as on a real robot. `phases` are the
    positions of the encoders between two ticks at the start, 0..1, left and right.
    """

    def __init__(self, parameters: Turtlebot3Parameters, drive: DifferentialDrive, phases: tuple[float, float]) -> None:
        self._drive = drive
        self._rate = parameters.odometry_rate
        self._ticks_per_radian = parameters.encoder_ticks / _TURN
        self._separation = parameters.wheel_separation
        self._metres_per_tick = parameters.wheel_radius * _TURN / parameters.encoder_ticks
        self._phases = phases
        self._state = OdometryState()
        self._step = 0
        self._ticks = self._read(0)
        self._number = 1
        self._next = self._due()  # the step at which the encoders are read next

    @undivided
    def latest(self) -> OdometryState:
        """Return the odometry at its last tick that the robot's body has reached."""
        while self._next <= self._drive.steps:
            self._add(self._next)
            self._number += 1
            self._next = self._due()
        return self._state

    def restart(self) -> None:
        """Count from zero, as the robot was put back."""
        self.latest()
        self._step = self._drive.steps  # the way since the last tick was before, too
        self._ticks, self._state = self._read(self._step), OdometryState()

    def _due(self) -> int:
        return tick_time(self._number, self._rate) // STEP_NS

    def _add(self, step: int) -> None:
        (left, right), (left_before, right_before) = ticks, _ = self._read(step), self._ticks
        self._state = self._state.rolled(
            (left - left_before) * self._metres_per_tick,
            (right - right_before) * self._metres_per_tick,
            self._separation,
            (step - self._step) / STEPS_PER_SECOND,
        )
        self._ticks, self._step = ticks, step

    def _read(self, step: int) -> tuple[int, int]:
        left, right = self._drive.wheel_angles_at(step)
        return (
            math.floor(left * self._ticks_per_radian + self._phases[0]),
            math.floor(right * self._ticks_per_radian + self._phases[1]),
        )
