"""The mission carried out: one phase after the other, on an absolute schedule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.plugins.systems.basic_turtlebot3.mission import PhaseKind
from robot_runner.plugins.systems.basic_turtlebot3.motion import TICK

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.events.clock import Clock
    from robot_runner.plugins.systems.basic_turtlebot3.mission import CircularMission, Phase, Task
    from robot_runner.plugins.systems.basic_turtlebot3.phase_log import PhaseLog
    from robot_runner.plugins.systems.basic_turtlebot3.robot import Robot

__all__ = ["Performance", "Performer"]

#: How often a robot that stands still is asked whether it is still there, s.
_LOOK_PERIOD = 0.5


@dataclass(frozen=True, slots=True)
class Performance:
    """What came of a mission.

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


class Performer:
    """Carries out one mission once.

    Args:
        mission: what is to be done.
        task: what the robot works on in the task phases.
        robot: who does it.
        clock: the run's clock.
        log: takes the phases that are over.
    """

    def __init__(self, mission: CircularMission, task: Task, robot: Robot, clock: Clock, log: PhaseLog) -> None:
        self._mission = mission
        self._task = task
        self._robot = robot
        self._clock = clock
        self._log = log

    def perform(self, announce: Callable[[int, Phase], None]) -> Performance:
        """Carry out the mission and tell of each phase as it begins; the robot is stopped whatever happens.

        Raises:
            LinkError: the odometry fell silent or the robot cannot be reached.
        """
        try:
            performance = self._perform(announce)
        except BaseException as fault:
            self._make_safe_after(fault)
            raise
        self._robot.make_safe()
        return performance

    def _make_safe_after(self, fault: BaseException) -> None:
        """Make the robot safe; that it cannot be reached for that, either, does not hide what came first."""
        try:
            self._robot.make_safe()
        except LinkError as error:
            fault.add_note(f"The robot could not be made safe: {error}")

    def _perform(self, announce: Callable[[int, Phase], None]) -> Performance:
        odometer = self._robot.odometer
        home, way_before = odometer.pose(), odometer.travelled
        self._aim = home  # where the robot should be, were it to move without error
        begun = due = self._clock.now()
        for number, phase in enumerate(self._mission.phases, start=1):
            announce(number, phase)
            start, due = self._clock.now(), due + phase.seconds
            self._carry_out(phase, due)
            task = self._task if phase.kind is PhaseKind.TASK else None
            self._log.add(phase, task, start, self._clock.now(), odometer.pose())
        return Performance(
            duration=self._clock.now() - begun,
            distance=odometer.travelled - way_before,
            pose_error=home.distance_to(odometer.pose()),
            planned_distance=2 * self._mission.way_out.way,
        )

    def _carry_out(self, phase: Phase, due: float) -> None:
        """Carry out one phase. Movements take their full time; what they were late by comes off the sleeps."""
        match phase.kind:
            case PhaseKind.SLEEP:
                self._rest(due)
            case PhaseKind.TASK:
                self._robot.tasks.start(self._task)
                self._rest(due)
                self._robot.tasks.stop(self._task)
            case PhaseKind.FORWARD:
                self._robot.pilot.drive(self._aim, self._mission.way_out, self._clock.now())
                self._aim = self._aim.ahead(self._mission.way_out.way)
            case PhaseKind.ROTATE:
                self._robot.pilot.turn(self._aim, self._mission.turn, self._clock.now())
                self._aim = self._aim.turned(self._mission.turn.way)

    def _rest(self, due: float) -> None:
        while (left := due - self._clock.now()) > TICK:
            self._clock.sleep(min(left, _LOOK_PERIOD))
            self._robot.odometer.pose()
