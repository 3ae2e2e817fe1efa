"""What holds for every system, as tests for its author to inherit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.links.connect import connect_robot
from robot_runner.core.plugin import System
from robot_runner.testing.fake_robot import FakeRobotLink
from robot_runner.testing.fake_run import Rehearsal
from robot_runner.testing.plugin_contract import MissionFailed, PluginContract, require

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.core.events.context import Clock, RobotRunnerContext

__all__ = ["SystemContract"]

#: A robot that was told to stop is given this long, s, and then may not move by more than this, m and rad.
_STOPPING_SECONDS = 0.5
_STANDING_SECONDS = 0.5
_STANDING_TOLERANCE = 0.002


class SystemContract(PluginContract):
    """The facts that a system must keep to; pytest finds them in a subclass whose name begins with `Test`.

    Attributes:
        namespace: the robot's ROS namespace.
        breaking_points: at how many moments, evenly spread over the mission, it is broken off.

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

    def robot_stands_still(self, context: RobotRunnerContext) -> bool:
        """Return whether the robot stands still, by its odometry; to be overridden for a robot without any."""
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
        """Hold that it derives from `System`, so that it is called at events before the profilers."""
        plugin = self.make_plugin()
        require(isinstance(plugin, System), f"{plugin!r} does not derive from System")

    def test_the_robot_stands_still_after_a_good_run(self, tmp_path: Path) -> None:
        """Hold that the mission's end is the end of all motion."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (context, rehearsal):
            rehearsal.execute(lambda: self.mission(context))
            require(self.robot_stands_still(context), "the robot still moves after a good run")

    def test_the_robot_stands_still_whenever_the_mission_breaks_off(self, tmp_path: Path) -> None:
        """Hold that an exception at any moment of the mission stops the robot."""
        duration = self._seconds_of_a_good_run(tmp_path / "good")
        for point in range(self.breaking_points if duration > 0 else 0):
            moment = duration * (point + 0.5) / self.breaking_points
            require(
                self._stands_still_after_breaking_off(tmp_path / f"broken_{point}", moment),
                f"the robot still moves after an exception {moment:.2f} s into the run",
            )

    def test_it_can_be_made_safe_at_any_time_and_twice(self, tmp_path: Path) -> None:
        """Hold that `make_safe` works before, after and without a run."""
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
            rehearsal.execute(lambda: self.mission(context))
            return context.clock.now() - begun

    def _stands_still_after_breaking_off(self, folder: Path, moment: float) -> bool:
        plugin = self.make_plugin()
        context = self.make_context(folder, plugin)
        breaking = replace(context, clock=_BreakingClock(context.clock, context.clock.now() + moment))
        try:
            Rehearsal(breaking, plugin).execute(lambda: self.mission(breaking))
        except MissionFailed:
            return self.robot_stands_still(context)
        finally:
            context.resources.close()
        raise AssertionError(
            f"an exception of context.clock.sleep {moment:.2f} s into the run did not end it: "
            "sleep on context.clock only, and let exceptions through"
        )


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
