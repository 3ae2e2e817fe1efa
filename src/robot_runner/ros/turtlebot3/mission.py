"""The mission of the paper (Fig. 4) as data, and its execution phase by phase on an absolute schedule."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, TextIO

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import Clock
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.graph_transport import is_simulated_time
from robot_runner.ros.turtlebot3.motion import MAXIMUM_SPEED, MAXIMUM_TURN_RATE, TICK, Ramp

if TYPE_CHECKING:
    from robot_runner.ros.turtlebot3.odometry import Pose
    from robot_runner.ros.turtlebot3.steered_robot import Robot, Task


class PhaseKind(Enum):
    """The activity of the robot in a phase."""

    SLEEP = "sleep"
    FORWARD = "forward"
    TASK = "task"
    ROTATE = "rotate"


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of a mission: the activity of the robot, and its duration, s."""

    kind: PhaseKind
    seconds: float


_WHERE = "the TurtleBot3's mission"


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
        speed: the cruising speed, m/s.
        angle: of the turn, rad, anticlockwise.

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
        names = ("sleep_s", "drive_s", "task_s", "rotate_s", "speed")
        check_numbers(_WHERE, **{name: getattr(self, name) for name in names})
        if self.speed > MAXIMUM_SPEED:
            raise _refusal("speed", self.speed, f"Give a speed of at most {MAXIMUM_SPEED} m/s.")
        if abs(self.turn.cruise) > MAXIMUM_TURN_RATE:
            least = math.ceil(100 * Ramp.covering(self.angle, MAXIMUM_TURN_RATE).seconds) / 100
            fix = f"Give rotate_s at least {least} s, as the robot turns by at most {MAXIMUM_TURN_RATE} rad/s."
            raise _refusal("rotate_s", self.rotate_s, fix)

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
        """The duration of the whole mission, s."""
        return sum(phase.seconds for phase in self.phases)


def _refusal(parameter: str, value: float, fix: str) -> PluginError:
    return PluginError(f"{parameter} is {value!r}", where=_WHERE, fix=fix)


#: How often the odometry is checked while the robot stands still, s.
_LOOK_PERIOD = 0.5
#: How long a robot may take to come to rest, s, and how far it may move after that, m: the odometry of a robot that
#: stands still does not drift.
_SETTLING, _MOST_DRIFT = 2.0, 0.1
#: The share of the planned way below which the robot did not move at all.
_LEAST = 0.1


@dataclass(frozen=True, slots=True)
class Performance:
    """The result of a mission.

    Attributes:
        duration: s on the run's clock.
        distance: the way covered by odometry, m.
        pose_error: how far from its beginning it ended by odometry, m.
        planned_distance: the way that should have been covered, m.

    Example:
        >>> Performance(duration=95.0, distance=3.6, pose_error=0.004, planned_distance=3.6).pose_error
        0.004
    """

    duration: float
    distance: float
    pose_error: float
    planned_distance: float


_HEADING = ("number", "phase", "task", "start_s", "end_s", "x_m", "y_m", "heading_rad")


class PhaseLog:
    """Writes one row a phase: its times on the run's clock, and the pose of the odometry at its end."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(_HEADING)
        self._count = 0

    def add(self, phase: Phase, task: Task | None, start: float, end: float, pose: Pose) -> None:
        """Write the row of a phase that is over, and flush it."""
        self._count += 1
        numbers = (f"{number:.4f}" for number in (start, end, pose.x, pose.y, pose.heading))
        self._rows.writerow((self._count, phase.kind.value, task.value if task else "", *numbers))
        self._file.flush()


@dataclass(slots=True)
class Performer:
    """Carries out one mission once."""

    mission: CircularMission
    task: Task
    robot: Robot
    clock: Clock
    log: PhaseLog
    _aim: Pose = field(init=False)  # where the robot would be without errors

    def perform(
        self, announce: Callable[[int, Phase], None], mark: Callable[[str], AbstractContextManager[object]]
    ) -> Performance:
        """Carry out the mission; the robot is stopped in any case.

        `announce` is called with each phase as it begins; `mark` returns the context manager for its kind:
        `context.phase`.

        Raises:
            LinkError: the odometry fell silent, or the robot cannot be reached, does not move as commanded, or moves
                where it has to stand still.
        """
        try:
            performance = self._perform(announce, mark)
        except BaseException as fault:
            try:
                self.robot.make_safe()
            except LinkError as error:  # which does not hide the first exception
                fault.add_note(f"The robot could not be made safe: {error}")
            raise
        self.robot.make_safe()
        return performance

    def _perform(
        self, announce: Callable[[int, Phase], None], mark: Callable[[str], AbstractContextManager[object]]
    ) -> Performance:
        odometer = self.robot.odometer
        home, way_before = odometer.pose(), odometer.travelled
        self._aim = home
        begun = due = self.clock.now()
        for number, phase in enumerate(self.mission.phases, start=1):
            announce(number, phase)
            start, due = self.clock.now(), due + phase.seconds
            with mark(phase.kind.value):
                self._carry_out(phase, due)
            task = self.task if phase.kind is PhaseKind.TASK else None
            self.log.add(phase, task, start, self.clock.now(), odometer.pose())
        performance = Performance(
            duration=self.clock.now() - begun,
            distance=odometer.travelled - way_before,
            pose_error=home.distance_to(odometer.pose()),
            planned_distance=2 * self.mission.way_out.way,
        )
        self._check_moved(performance)
        return performance

    def _carry_out(self, phase: Phase, due: float) -> None:
        """Carry out one phase. Movements take their full time; delays are taken off the sleeps."""
        match phase.kind:
            case PhaseKind.SLEEP:
                self._rest(due)
            case PhaseKind.TASK:
                self.robot.tasks.start(self.task)
                self._rest(due)
                self.robot.tasks.stop(self.task)
            case PhaseKind.FORWARD:
                self.robot.pilot.drive(self._aim, self.mission.way_out, self.clock.now())
                self._aim = self._aim.ahead(self.mission.way_out.way)
            case PhaseKind.ROTATE:
                self.robot.pilot.turn(self._aim, self.mission.turn, self.clock.now())
                self._aim = self._aim.turned(self.mission.turn.way)

    def _rest(self, due: float) -> None:
        settled, resting = self.clock.now() + _SETTLING, None
        while (left := due - self.clock.now()) > TICK:
            self.clock.sleep(min(left, _LOOK_PERIOD))
            pose = self.robot.odometer.pose()
            if self.clock.now() >= settled:
                resting = resting or pose
                # A simulation's time may go by much faster than messages do.
                if (drift := resting.distance_to(pose)) > _MOST_DRIFT and not is_simulated_time(self.clock):
                    problem = f"the robot moved by {drift:.2f} m while it was to stand still"
                    fix = "See that nobody pushes it, and that nothing else commands it."
                    raise LinkError(problem, where="mission", fix=fix)

    def _check_moved(self, performance: Performance) -> None:
        if performance.distance < _LEAST * performance.planned_distance:
            problem = f"the robot covered {performance.distance:.3f} m of {performance.planned_distance:.2f} m"
            fix = "Check whether its way is free, its motors are on, and its driver obeys the commands."
            raise LinkError(problem, where="mission", fix=fix)
