"""The mission as data: phases with their durations (paper, Fig. 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from robot_runner.errors import PluginError
from robot_runner.plugins.systems.basic_turtlebot3.motion import MAXIMUM_SPEED, MAXIMUM_TURN_RATE, Ramp

__all__ = ["CircularMission", "Phase", "PhaseKind", "Task"]


class PhaseKind(Enum):
    """What the robot does in a phase."""

    SLEEP = "sleep"
    FORWARD = "forward"
    TASK = "task"
    ROTATE = "rotate"


class Task(Enum):
    """What the robot's computer does in a task phase (paper, section II.C); the value names its services."""

    COMPUTATION = "computation"
    VIDEO = "video"
    NETWORK = "network"

    @classmethod
    def named(cls, treatment: object) -> Task | None:
        """Return the task that a treatment names, ignoring case, or None.

        Example:
            >>> Task.named("Video")
            <Task.VIDEO: 'video'>
        """
        name = str(treatment).casefold()
        return next((task for task in cls if task.value == name), None)


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of a mission.

    Attributes:
        kind: what the robot does.
        seconds: how long, s.
    """

    kind: PhaseKind
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CircularMission:
    """The durations of the phases of Fig. 4, and how the robot moves; 95 s in all with the defaults.

    The robot drives away, works three times, turns round and drives back, so that there is no need to
    reposition it before the next run.

    Attributes:
        sleep_s: each sleep, s.
        drive_s: the way out, and the way back, s.
        task_s: each of the three tasks, s.
        rotate_s: the turn, s.
        speed: the speed to cruise at, m/s.
        angle: how far to turn, rad, anticlockwise.

    Raises:
        PluginError: a duration is not positive, or the robot cannot move so fast.

    Example:
        >>> CircularMission().seconds
        95.0
    """

    sleep_s: float = 5.0
    drive_s: float = 10.0
    task_s: float = 10.0
    rotate_s: float = 15.0
    speed: float = 0.2
    angle: float = math.pi

    def __post_init__(self) -> None:
        for parameter in ("sleep_s", "drive_s", "task_s", "rotate_s", "speed"):
            value = getattr(self, parameter)
            if not 0 < value < math.inf:
                raise _refusal(parameter, value, f"Give {parameter} a number above 0.")
        if self.speed > MAXIMUM_SPEED:
            raise _refusal("speed", self.speed, f"Give a speed of at most {MAXIMUM_SPEED} m/s.")
        if abs(self.turn.cruise) > MAXIMUM_TURN_RATE:
            raise _refusal("rotate_s", self.rotate_s, f"Give the turn more time: at most {MAXIMUM_TURN_RATE} rad/s.")

    @property
    def way_out(self) -> Ramp:
        """The way out as distance over time; the way back is the same."""
        return Ramp.cruising(self.speed, self.drive_s)

    @property
    def turn(self) -> Ramp:
        """The turn as angle over time."""
        return Ramp(self.angle, self.rotate_s)

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases in order."""
        sleep = Phase(PhaseKind.SLEEP, self.sleep_s)
        drive = Phase(PhaseKind.FORWARD, self.drive_s)
        task = Phase(PhaseKind.TASK, self.task_s)
        turn = Phase(PhaseKind.ROTATE, self.rotate_s)
        return (sleep, drive, sleep, task, sleep, task, sleep, task, sleep, turn, drive, sleep)

    @property
    def seconds(self) -> float:
        """How long the whole mission takes, s."""
        return sum(phase.seconds for phase in self.phases)


def _refusal(parameter: str, value: float, fix: str) -> PluginError:
    return PluginError(f"{parameter} is {value!r}", where="the TurtleBot3's mission", fix=fix)
