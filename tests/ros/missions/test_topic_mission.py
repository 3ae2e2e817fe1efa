"""A mission that publishes until a condition holds."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner import all_of, text_in
from robot_runner.conditions.topic_messages import topic_above
from robot_runner.core.errors import ConditionTimeout, PluginError
from robot_runner.core.links import commanded_topics
from robot_runner.core.plugin import Circumstances
from robot_runner.plugins import treatment
from robot_runner.plugins.systems import TopicMission
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, SystemContract, make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

_TWIST = "geometry_msgs/Twist"
_FAR = topic_above("odom", "nav_msgs/Odometry", "pose.pose.position.x", 0.5)


class TestTopicMission(SystemContract):
    """Half a metre ahead."""

    breaking_points = 4

    def make_plugin(self) -> TopicMission:
        return TopicMission("cmd_vel", _TWIST, {"linear": {"x": 0.2}}, until=_FAR)


def test_it_publishes_at_its_rate_until_the_condition_holds(tmp_path: Path) -> None:
    mission = TopicMission("cmd_vel", _TWIST, {"linear": {"x": treatment("Speed")}}, until=_FAR, rate_hz=5.0)
    context = make_context(tmp_path, mission, combination={"Speed": 0.1})
    measured = rehearse(context, mission)
    assert 5.0 < measured["Duration"] < 5.6
    assert measured["Messages"] == pytest.approx(5.0 * measured["Duration"], abs=1.0)
    context.resources.close()


def test_for_some_seconds_it_publishes_as_often_as_it_says_and_the_safe_message_afterwards(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    lamp = TopicMission("lamp", "std_msgs/String", {"data": "on"}, until=2.0, rate_hz=10.0, afterwards={"data": "off"})
    context = make_context(tmp_path, lamp, links=FakeLinks(robot=link), clock=clock)
    measured = rehearse(context, lamp)
    assert dict(measured) == {"Duration": pytest.approx(2.0), "Messages": 20}
    assert [each.message["data"] for each in link.publications if each.topic == "lamp"][-2:] == ["off", "off"]
    once = TopicMission("lamp", "std_msgs/String", {"data": "on"}, until=2.0, rate_hz=0)
    context = make_context(tmp_path, once, links=FakeLinks(robot=FakeRobotLink(clock)), clock=clock)
    assert rehearse(context, once)["Messages"] == 1


@pytest.mark.parametrize("message_type", ["ackermann_msgs/AckermannDrive", "ackermann_msgs/msg/AckermannDriveStamped"])
def test_a_car_is_stopped_as_any_other_robot_is(tmp_path: Path, message_type: str) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    message = {"drive": {"speed": 1.0}} if message_type.endswith("Stamped") else {"speed": 1.0}
    mission = TopicMission("drive", message_type, message, until=2.0)
    context = make_context(tmp_path, mission, robot="dds", links=FakeLinks(robot=link), clock=clock)
    clock.at(1.0, lambda: link.stands_still and pytest.fail("it drives"))
    assert rehearse(context, mission)["Messages"] == 20
    assert link.publications[-1].message == {"data": 0}  # the heartbeat's farewell
    assert link.stands_still


class _UnreachedLink(FakeRobotLink):
    """A link whose only subscriber has another version of the type, so that it never connects."""

    def advertise(self, *_: Any, **_more: Any) -> bool:
        return False


def test_a_mission_is_doubted_whose_messages_did_not_reach_a_subscriber(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.0)
    clock = FakeClock()
    lamp = TopicMission("lamp", "std_msgs/String", {"data": "on"}, until=2.0)
    context = make_context(tmp_path, lamp, links=FakeLinks(robot=_UnreachedLink(clock)), clock=clock)
    rehearse(context, lamp)
    (doubt,) = context.broker.findings
    assert "'lamp' may have missed messages of the mission: the robot's subscription is not reached" in doubt.problem


def test_a_condition_that_never_holds_fails_the_run_with_what_was_seen(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    clock.at(0.5, lambda: link.deliver("odom", {"pose": {"pose": {"position": {"x": 0.25}}}}))
    mission = TopicMission("cmd_vel", _TWIST, {"linear": {"x": 0.2}}, until=_FAR, timeout_s=3.0)
    context = make_context(tmp_path, mission, links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(ConditionTimeout, match=r"after 3 s of publishing on 'cmd_vel' .* is above 0\.5: 0\.25"):
        rehearse(context, mission)
    assert clock.now() == pytest.approx(3.0)
    assert link.stands_still


@pytest.mark.parametrize("is_mixed", [False, True])
def test_what_goes_on_outside_a_simulation_is_awaited_in_real_time(tmp_path: Path, is_mixed: bool) -> None:
    output = tmp_path / "output.txt"
    done = text_in(output, "done")
    until = all_of(done, topic_above("odom", "nav_msgs/Odometry", "pose.pose.position.x", -1.0)) if is_mixed else done
    mission = TopicMission("cmd_vel", _TWIST, {"linear": {"x": 0.01}}, until=until, timeout_s=60.0)
    context = make_context(tmp_path, mission)
    program = threading.Timer(0.2, output.write_text, ["done"])
    began = time.monotonic()
    program.start()
    assert rehearse(context, mission)["Duration"] <= time.monotonic() - began
    program.join()
    context.resources.close()


@pytest.mark.parametrize(("places", "is_doubted"), [([0.9, 0.91], True), ([0.45, 0.6], False)])
def test_a_mission_that_was_over_before_it_began_makes_the_run_doubtful(
    tmp_path: Path, places: list[float], is_doubted: bool
) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    for number, x in enumerate(places):  # the odometry goes on where the run before has left the robot
        clock.at(0.1 + 0.2 * number, lambda x=x: link.deliver("odom", {"pose": {"pose": {"position": {"x": x}}}}))
    mission = TopicMission("cmd_vel", _TWIST, {"linear": {"x": 0.2}}, until=_FAR)
    context = make_context(tmp_path, mission, links=FakeLinks(robot=link), clock=clock)
    rehearse(context, mission)
    told = [each.problem for each in context.broker.findings]
    assert all("0.1 s after the mission began, and was not seen not to hold" in problem for problem in told)
    assert len(told) == is_doubted


@pytest.mark.parametrize(
    ("parameter", "value"), [("until", "arrived"), ("until", -1), ("rate_hz", -1), ("timeout_s", None), ("publish", 3)]
)
def test_a_parameter_out_of_its_range_is_refused(parameter: str, value: object) -> None:
    given = {"publish": {}, "until": 1.0, parameter: value}
    with pytest.raises(PluginError, match=f"{parameter} is"):
        TopicMission("cmd_vel", _TWIST, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("mission", "problem", "fix"),
    [
        (TopicMission("cmd_vell", _TWIST, {}, until=1.0), "does not subscribe '/cmd_vell'", "Did you mean '/cmd_vel'?"),
        (TopicMission("/cmd_vel", _TWIST, {}, until=1.0, namespace="bob"), "does not subscribe", "'/bob/cmd_vel'"),
        (TopicMission("cmd_vel", f"{_TWIST}Stamped", {}, until=1.0), "as geometry_msgs/Twist, not", "Name the type"),
        (TopicMission("/bob/cmd_vel", _TWIST, {}, until=1.0, namespace="bob"), "", ""),
        (TopicMission("joint_commands", "sensor_msgs/JointState", {}, until=1.0), "", ""),
    ],
)
def test_a_topic_that_the_embedded_robot_does_not_subscribe_is_found_by_check(
    mission: TopicMission, problem: str, fix: str
) -> None:
    found = list(mission.check(Circumstances("simulated")))
    assert len(found) == bool(problem)
    assert all(problem in each.problem and fix in each.fix for each in found)
