"""Odometry from the wheels' encoders, as the robot's firmware computes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.simulator.clock import STEP_NS, STEPS_PER_SECOND, tick_time

if TYPE_CHECKING:
    from robot_runner.simulator.drive import DifferentialDrive
    from robot_runner.simulator.parameters import Turtlebot3Parameters

__all__ = ["OdometryState", "WheelOdometry"]

_TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class OdometryState:
    """Where the wheels say that the robot is (m, rad) and how fast it goes (m/s, rad/s)."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    linear: float = 0.0
    angular: float = 0.0


class WheelOdometry:
    """Counts encoder ticks at the odometry's rate and adds up arcs, whether or not anybody listens.

    It trusts the nominal wheel radius and separation; the true ones differ a little, as on a real robot.

    Args:
        phases: where between two ticks the encoders stand at the start, 0..1, left and right.
    """

    def __init__(self, parameters: Turtlebot3Parameters, drive: DifferentialDrive, phases: tuple[float, float]) -> None:
        self._drive = drive
        self._rate = parameters.odometry_rate
        self._ticks_per_radian = parameters.encoder_ticks / _TURN
        self._separation = parameters.wheel_separation
        self._metres_per_tick = parameters.wheel_radius * _TURN / parameters.encoder_ticks
        self._phases = phases
        self._state = OdometryState()
        self._number = 0
        self._step = 0
        self._ticks = self._read(0)

    def latest(self) -> OdometryState:
        """Return the odometry at the last of its ticks that the robot's body has reached."""
        while (step := tick_time(self._number + 1, self._rate) // STEP_NS) <= self._drive.steps:
            self._number += 1
            self._add(step)
        return self._state

    def _add(self, step: int) -> None:
        left, right = self._read(step)
        left_way = (left - self._ticks[0]) * self._metres_per_tick
        right_way = (right - self._ticks[1]) * self._metres_per_tick
        way, turn = (left_way + right_way) / 2, (right_way - left_way) / self._separation
        seconds = (step - self._step) / STEPS_PER_SECOND
        before = self._state
        heading = before.yaw + turn / 2
        self._state = OdometryState(
            before.x + way * math.cos(heading),
            before.y + way * math.sin(heading),
            math.remainder(before.yaw + turn, _TURN),
            way / seconds,
            turn / seconds,
        )
        self._ticks = (left, right)
        self._step = step

    def _read(self, step: int) -> tuple[int, int]:
        left, right = self._drive.wheel_angles[step]
        return (
            math.floor(left * self._ticks_per_radian + self._phases[0]),
            math.floor(right * self._ticks_per_radian + self._phases[1]),
        )
