"""Systems of several robots begin together, are joined, and are stopped together."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.waiting import PATIENCE

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunFailed
from robot_runner.core.links.connect import connect_robot
from robot_runner.core.plugin import Circumstances
from robot_runner.plugins import Measure, System, treatment
from robot_runner.plugins.systems import BasicTurtlebot3, Together, TopicMission, Waypoints
from robot_runner.ros.missions.joint_missions import JointMission, SharedClock, StoppedWithOthers, execute_together
from robot_runner.testing import FakeClock, SystemContract, make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.core.events.context import RobotRunnerContext


def _pair(**more: Any) -> Together:
    return Together(
        Waypoints([(0.6, 0.0)], name="alice", namespace="/alice", **more),
        Waypoints([(0.0, 0.6)], name="bob", namespace="/bob"),
    )


@pytest.mark.long
class TestTogether(SystemContract):
    """Two robots that drive at once."""

    namespace = "/bob"
    breaking_points = 4

    def make_plugin(self) -> Together:
        return _pair()


def _seconds(folder: Path, *systems: System) -> float:
    context = make_context(folder, *systems)
    try:
        rehearse(context, *systems)
        assert context.window is not None
        return context.window.end - context.window.start
    finally:
        context.resources.close()


def test_two_robots_in_one_simulation_move_at_the_same_time(tmp_path: Path) -> None:
    alone = Waypoints([(1.0, 0.0)], name="alice", namespace="/alice")
    other = Waypoints([(1.0, 0.0)], name="bob", namespace="/bob")
    one = _seconds(tmp_path / "one", alone)
    after_each_other = _seconds(tmp_path / "two", alone, other)
    together = _seconds(tmp_path / "both", Together(alone, other))
    assert after_each_other == pytest.approx(2 * one, rel=0.05)
    assert together == pytest.approx(one, rel=0.02)


def test_each_robot_measures_what_it_would_measure_alone(tmp_path: Path) -> None:
    alone = make_context(tmp_path / "alone", bob := Waypoints([(0.0, 0.6)], name="bob", namespace="/bob"))
    both = make_context(tmp_path / "both", pair := _pair())
    expected, measured = rehearse(alone, bob), rehearse(both, pair)
    assert measured["bob.Distance"] == pytest.approx(expected["Distance"], rel=0.01)
    assert measured["alice.Duration"] < measured["bob.Duration"]  # bob has to turn first
    assert (tmp_path / "both" / "runs" / "r_1" / "Together" / "alice" / "trajectory.csv").exists()
    assert sorted(phase.name for phase in both.phases) == ["alice_leg_1", "bob_leg_1"]
    for context in (alone, both):
        context.resources.close()


def test_treatments_reach_the_systems_inside(tmp_path: Path) -> None:
    pair = _pair(speed=treatment("Speed"))
    durations = []
    for speed in (0.1, 0.2):
        context = make_context(tmp_path / str(speed), pair, combination={"Speed": speed})
        durations.append(rehearse(context, pair)["alice.Duration"])
        context.resources.close()
    assert durations[0] > 1.5 * durations[1]


class _Failing(System):
    """Fails after a second of its clock."""

    measures = (Measure("Nothing", "1", "Nothing."),)

    def launch_mission(self, context: RobotRunnerContext) -> None:
        context.clock.sleep(1.0)
        raise ValueError("the gripper is stuck")


def test_where_one_fails_the_others_are_stopped_at_once_and_it_is_said_which(tmp_path: Path) -> None:
    mover = TopicMission(
        "cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}}, until=20.0, name="bob", namespace="/bob"
    )
    together = Together(_Failing(name="arm"), mover)
    context = make_context(tmp_path, together)
    with pytest.raises(PluginError, match="arm failed: ValueError: the gripper is stuck; bob was stopped with it"):
        rehearse(context, together)
    assert context.clock.now() == pytest.approx(1.0, abs=0.1)
    link, poses = connect_robot(context, namespace="/bob"), []
    context.clock.sleep(0.5)
    link.subscribe("odom", "nav_msgs/Odometry", lambda odom: poses.append(odom["pose"]["pose"]["position"]["x"]))
    context.clock.sleep(0.5)
    assert max(poses) - min(poses) < 0.001
    context.resources.close()


class _Doubting(System):
    """Doubts one of its two measures."""

    measures = (Measure("Way", "m"), Measure("Slip", "m"))

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Do nothing."""

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Doubt it, as its author may write that who never has two to doubt."""
        context.doubt("it slipped", measures="Way")


def test_a_doubt_about_one_measure_may_be_given_as_its_name_alone(tmp_path: Path) -> None:
    pair = Together(_Doubting(name="alice"), _Doubting(name="bob"))
    context = make_context(tmp_path, pair)
    rehearse(context, pair)
    assert [each.problem for each in context.broker.findings] == ["alice: it slipped", "bob: it slipped"]
    context.resources.close()


def test_two_systems_with_one_name_or_one_robot_are_refused() -> None:
    with pytest.raises(PluginError, match="2 of its systems are named 'alice'"):
        Together(Waypoints([(1, 0)], name="alice"), Waypoints([(1, 0)], name="Alice".lower()))
    with pytest.raises(PluginError, match="1 system is given"):
        Together(Waypoints([(1, 0)]))
    one_robot = Together(Waypoints([(1, 0)], name="alice"), Waypoints([(1, 0)], name="bob"))
    found = [finding.problem for finding in one_robot.check(Circumstances(robot="simulated"))]
    assert found == ["alice and bob command the same robot at the same time, on '/cmd_vel'"]


def test_a_turtlebot3_that_another_kind_of_system_drives_at_the_same_time_is_refused() -> None:
    circling = BasicTurtlebot3(name="alice", task="Video", task_factor=None)
    one_robot = Together(circling, Waypoints([(1, 0)], name="bob"))
    found = [finding.problem for finding in one_robot.check(Circumstances(robot="simulated"))]
    assert found == ["alice and bob command the same robot at the same time, on '/cmd_vel'"]
    turtlebots = Together(*(BasicTurtlebot3(name=name, task="Video", task_factor=None) for name in ("a", "b")))
    assert "so does 'a'" in next(iter(turtlebots.check(Circumstances(robot="simulated")))).problem


def test_on_a_clock_that_goes_by_itself_missions_overlap_and_stop_at_once() -> None:
    closing_took: list[float] = []
    clock, has_begun = SharedClock(SystemClock()), threading.Event()

    def long() -> None:
        has_begun.set()
        try:
            clock.sleep(3600.0)
        except StoppedWithOthers:
            begun = time.monotonic()
            clock.sleep(0.1)  # what it closes may take its time
            closing_took.append(time.monotonic() - begun)
            raise

    def failing() -> None:
        assert has_begun.wait(PATIENCE)
        clock.sleep(0.2)
        raise LookupError("no map")

    missions = [JointMission("long", long), JointMission("planner", failing)]
    with pytest.raises(PluginError, match="planner failed: LookupError: no map; long was stopped"):
        execute_together(missions, clock, takes_turns=False)
    assert closing_took[0] >= 0.1
    assert not any(thread.name in {"long", "planner"} for thread in threading.enumerate())


def test_what_interrupts_the_run_stops_all_missions() -> None:
    interrupted = FakeClock()

    def interrupt() -> None:
        raise RunFailed("the battery is empty")

    interrupted.at(2.0, interrupt)

    ended: list[str] = []
    clock = SharedClock(interrupted)

    def sleeping() -> None:
        try:
            clock.sleep(5.0)
        finally:
            ended.append("")

    missions = [JointMission(name, sleeping) for name in ("alice", "bob")]
    with pytest.raises(RunFailed, match="the battery is empty"):
        execute_together(missions, clock, takes_turns=True)
    assert len(ended) == 2
    assert interrupted.now() == 2.0
