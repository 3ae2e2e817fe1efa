"""The rules for every system, as tests for its author to inherit."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, cast

from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.links.connect import connect_robot
from robot_runner.core.plugin import System
from robot_runner.testing.fake_robot import FakeRobotLink
from robot_runner.testing.fake_run import Rehearsal, context_for
from robot_runner.testing.plugin_contract import MissionFailed, PluginContract, require

#: How long a robot may take to stop, s, and how far it may move after that, m and rad.
_STOPPING_SECONDS = 0.5
_STANDING_SECONDS = 0.5
_STANDING_TOLERANCE = 0.002
#: When the process of a run dies, as shares of the run's duration.
_DEATHS = (0.3, 0.6)
#: The least duration of a run that is broken off, s.
_LEAST_SECONDS = 1.0
#: The timeout for waiting for a thread of the contract, s.
_DEADLINE = 60.0


class SystemContract(PluginContract):
    """The rules that a system must keep to; pytest finds the tests in a subclass whose name begins with `Test`.

    Attributes:
        namespace: the robot's ROS namespace.
        breaking_points: at how many moments, evenly spread over the mission, it is broken off.
        goes_on_without_its_process: whether what the mission has begun goes on where the run's process dies. The
            simulated robot's goals do not: their server dies with it, and nothing there cancels those of others. Nor do
            processes that a run started: its keeper ends them, or the next run does.

    Example:
        >>> from robot_runner.plugins.systems import BasicTurtlebot3
        >>> from robot_runner.testing import SystemContract
        >>> class TestBasicTurtlebot3(SystemContract):
        ...     combination = {"Task": "Video"}
        ...     def make_plugin(self):
        ...         return BasicTurtlebot3(sleep_s=0.2, drive_s=1.0, task_s=0.5, rotate_s=3.0)
    """

    namespace: ClassVar[str] = ""
    breaking_points: ClassVar[int] = 8
    goes_on_without_its_process: ClassVar[bool] = True

    def robot_stands_still(self, context: RobotRunnerContext) -> bool:
        """Return whether the robot stands still, by its odometry; to be overridden for a robot without odometry."""
        link = connect_robot(context, namespace=self.namespace)
        if isinstance(link, FakeRobotLink):
            return link.stands_still
        heard: list[Mapping[str, Any]] = []
        subscription = link.subscribe("odom", "nav_msgs/Odometry", heard.append)
        context.clock.sleep(_STOPPING_SECONDS)
        require(heard, "the robot says nothing about its motion: override robot_stands_still")
        before = heard[-1]
        context.clock.sleep(_STANDING_SECONDS)
        subscription.close()
        return _moved(before, heard[-1]) < _STANDING_TOLERANCE

    def test_it_is_a_system(self) -> None:
        """Check that it derives from `System`, so that it is called before the profilers."""
        plugin = self.make_plugin()
        require(isinstance(plugin, System), f"{plugin!r} does not derive from System")

    def test_the_robot_stands_still_after_a_good_run(self, tmp_path: Path) -> None:
        """Check that all motion has ended after the mission."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (context, rehearsal):
            rehearsal.execute(lambda: self.mission(context))
            require(self.robot_stands_still(context), "the robot still moves after a good run")

    def test_the_robot_stands_still_whenever_the_mission_breaks_off(self, tmp_path: Path) -> None:
        """Check that an exception at any moment of the mission stops the robot."""
        duration = self._seconds_of_a_good_run(tmp_path / "good")
        for point in range(self.breaking_points):
            moment = duration * (point + 0.5) / self.breaking_points
            require(
                self._stands_still_after_breaking_off(tmp_path / f"broken_{point}", moment),
                f"the robot still moves after an exception {moment:.2f} s into the run",
            )

    def test_the_robot_is_stopped_by_a_process_that_did_not_move_it(self, tmp_path: Path) -> None:
        """Check that `make_safe` needs no state of the run's callbacks, whose process may have been killed."""
        duration = self._seconds_of_a_good_run(tmp_path / "good") if self.goes_on_without_its_process else 0.0
        for number, moment in enumerate(duration * part for part in _DEATHS if duration):
            require(
                self._stands_still_after_its_death(tmp_path / f"dead_{number}", moment),
                f"the robot still moves where the run died after {moment:.2f} s, and another process called make_safe: "
                "connect to the robot there (connect_robot) instead of using what start_run has kept",
            )

    def test_it_can_be_made_safe_at_any_time_and_twice(self, tmp_path: Path) -> None:
        """Check that `make_safe` works before, after and without a run."""
        plugin = self.make_plugin()
        with self.rehearsal(tmp_path, plugin) as (context, rehearsal):
            rehearsal.make_safe()
            rehearsal.make_safe()
            rehearsal.execute(lambda: self.mission(context))
            rehearsal.make_safe()
            rehearsal.make_safe()
            require(self.robot_stands_still(context), "the robot moves after it was made safe")

    def _seconds_of_a_good_run(self, folder: Path) -> float:
        with self.rehearsal(folder, self.make_plugin()) as (context, rehearsal):
            begun = context.clock.now()
            rehearsal.execute(lambda: self._lasting_mission(context, begun))
            return context.clock.now() - begun

    def _lasting_mission(self, context: RobotRunnerContext, begun: float) -> None:
        """Execute the mission, and let time pass if it takes none, to detect a robot that still drives."""
        self.mission(context)
        if context.clock.now() <= begun:
            context.clock.sleep(_LEAST_SECONDS)

    def _stands_still_after_breaking_off(self, folder: Path, moment: float) -> bool:
        plugin = self.make_plugin()
        context = self.make_context(folder, plugin)
        begun = context.clock.now()
        breaking = replace(context, clock=_BreakingClock(context.clock, begun + moment))
        try:
            Rehearsal(breaking, plugin).execute(lambda: self._lasting_mission(breaking, begun))
        except MissionFailed:
            return self.robot_stands_still(context)
        finally:
            context.resources.close()
        problem = f"an exception of context.clock.sleep {moment:.2f} s into the run did not end it"
        raise AssertionError(f"{problem}: sleep on context.clock only, and let exceptions through")

    def _stands_still_after_its_death(self, folder: Path, moment: float) -> bool:
        plugin, standing_by = (cast("System", self.make_plugin()) for _ in range(2))
        context = self.make_context(folder, plugin)
        dying = _DyingClock(context.clock, context.clock.now() + moment)
        run = threading.Thread(target=self._execute_until_death, args=(replace(context, clock=dying), plugin))
        run.start()
        try:
            require(dying.is_dead.wait(_DEADLINE), "the run did not sleep on context.clock any more")
            own = context_for(standing_by, context)
            standing_by.stand_by(own)
            standing_by.make_safe(own)
            return self.robot_stands_still(context)
        finally:
            dying.is_over.set()
            run.join(_DEADLINE)
            context.resources.close()

    def _execute_until_death(self, context: RobotRunnerContext, plugin: System) -> None:
        rehearsal, begun = Rehearsal(context, plugin), context.clock.now()
        with suppress(MissionFailed):
            for event in (RobotRunnerEvents.START_RUN, RobotRunnerEvents.START_MEASUREMENT):
                rehearsal.emit(event)
            rehearsal.emit(RobotRunnerEvents.LAUNCH_MISSION)
            self._lasting_mission(context, begun)


class _DyingClock:
    """The run's clock, on which one sleep lasts until the contract is over, as in a process that was killed."""

    def __init__(self, clock: Clock, dies_at: float) -> None:
        self._clock = clock
        self._dies_at = dies_at
        self.is_dead = threading.Event()
        self.is_over = threading.Event()

    def now(self) -> float:
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        if not self.is_dead.is_set() and self.now() + seconds < self._dies_at:
            self._clock.sleep(seconds)
            return
        self.is_dead.set()
        self.is_over.wait()
        raise MissionFailed


class _BreakingClock:
    """The run's clock, on which one sleep raises."""

    def __init__(self, clock: Clock, breaks_at: float) -> None:
        self._clock = clock
        self._breaks_at: float | None = breaks_at

    def now(self) -> float:
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        if self._breaks_at is None or self.now() + seconds < self._breaks_at:
            self._clock.sleep(seconds)
            return
        left, self._breaks_at = self._breaks_at - self.now(), None
        self._clock.sleep(left)
        raise MissionFailed


def _moved(before: Mapping[str, Any], after: Mapping[str, Any]) -> float:
    """Return the largest change of a component of the pose (m; of the quaternion, about half the angle in rad)."""
    first, second = before["pose"]["pose"], after["pose"]["pose"]
    changes: list[float] = [
        abs(second[part][component] - first[part][component])
        for part in ("position", "orientation")
        for component in first[part]
    ]
    return max(changes)
