"""What the robot draws, in watts, from what it does: the levels of the paper's Fig. 4 and seeded noise around them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.clock import STEPS_PER_SECOND
from robot_runner.simulator.drive import MOVING_WHEEL_SPEED

if TYPE_CHECKING:
    import numpy.typing as npt

    from robot_runner.simulator.drive import DifferentialDrive
    from robot_runner.simulator.parameters import Turtlebot3Parameters
    from robot_runner.simulator.randomness import NoiseStreams
    from robot_runner.simulator.tasks import TaskRunner

    Floats = npt.NDArray[np.float64]

__all__ = ["PowerModel"]

# From this speed of a wheel on, its motor draws all of what turning costs it whatever the speed (rad/s).
_TURNING_WHEEL_SPEED = 0.5


class PowerModel:
    """The power that the robot draws at each step, computed for many steps at once and each step only once.

    Base level (asleep until the first movement, awake after it), plus the motors, plus the task; each with
    its seeded deviation, and noise from step to step on top.
    """

    def __init__(
        self,
        parameters: Turtlebot3Parameters,
        drive: DifferentialDrive,
        tasks: TaskRunner,
        streams: NoiseStreams,
    ) -> None:
        self._parameters = parameters
        self._drive = drive
        self._tasks = tasks
        self._noise = streams.named("power samples")
        self._wandering = _Wandering(streams.named("wandering power"), parameters.wandering_power_deviation)
        gains = streams.named("run power").standard_normal(2)
        base, motors = (1.0 + parameters.run_power_deviation / 100 * gains).tolist()
        self._base_gain: float = base
        self._motor_gain: float = motors
        self._awake_from: int | None = None

    def between(self, first: int, last: int) -> Floats:
        """Return the power in watts at each of the steps `first` to `last`; to be asked in order, without gaps."""
        noise = self._parameters.sample_power_deviation * self._noise.standard_normal(last - first + 1)
        power: Floats = (
            self._base(first, last)
            + self._motors(first, last)
            + self._task(first, last)
            + self._wandering.between(first, last)
            + noise
        )
        return np.maximum(power, 0.0)

    def _base(self, first: int, last: int) -> Floats:
        parameters = self._parameters
        if self._awake_from is None:
            turning = np.abs(self._drive.wheel_speeds[first : last + 1]).max(axis=1) > MOVING_WHEEL_SPEED
            self._awake_from = first + int(turning.argmax()) if turning.any() else None
        is_awake = np.zeros(last - first + 1, dtype=bool)
        if self._awake_from is not None:
            is_awake[max(0, self._awake_from - first) :] = True
        level: Floats = np.where(is_awake, parameters.awake_power, parameters.asleep_power)
        return level * self._base_gain

    def _motors(self, first: int, last: int) -> Floats:
        parameters = self._parameters
        speeds = self._drive.wheel_speeds[first : last + 1]
        share = parameters.turning_motor_share / 100
        turning = np.minimum(np.abs(speeds) / _TURNING_WHEEL_SPEED, 1.0)
        running = np.abs(speeds) * (parameters.wheel_radius / parameters.max_linear_velocity)
        cost = (parameters.moving_power - parameters.awake_power) * self._motor_gain
        work = np.maximum(speeds * self._drive.motor_torques[first : last + 1], 0.0).sum(axis=1)
        rotation = (share * turning + (1 - share) * running).mean(axis=1)
        drawn: Floats = cost * rotation + work / (parameters.motor_efficiency / 100)
        return drawn

    def _task(self, first: int, last: int) -> Floats:
        parameters = self._parameters
        levels = np.array([parameters.computation_power, parameters.video_power, parameters.network_power])
        powers = np.append(levels * parameters.task_power_factor, parameters.awake_power)
        drawn = powers[self._tasks.numbers(first, last)] * self._tasks.gains(first, last)
        extra: Floats = drawn - parameters.awake_power
        return extra


class _Wandering:
    """Noise that wanders slowly: a normal value for each second, with straight lines in between."""

    def __init__(self, noise: np.random.Generator, deviation: float) -> None:
        self._noise = noise
        self._deviation = deviation
        self._knots = np.empty(0)

    def between(self, first: int, last: int) -> Floats:
        needed = last // STEPS_PER_SECOND + 2
        if needed > len(self._knots):
            fresh = self._deviation * self._noise.standard_normal(needed - len(self._knots))
            self._knots = np.append(self._knots, fresh)
        return np.interp(np.arange(first, last + 1) / STEPS_PER_SECOND, np.arange(len(self._knots)), self._knots)
