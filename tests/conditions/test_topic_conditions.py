"""Conditions of the simulated robot's graph and topics, awaited on its clock."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, NoReturn

import pytest

from robot_runner import (
    ConditionError,
    battery_above,
    battery_below,
    lifecycle_state,
    message_on,
    node_present,
    not_,
    service_present,
    topic_above,
    topic_below,
    topic_present,
)
from robot_runner.core.errors import LinkError
from robot_runner.plugins import change_state, connect_robot
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, LifecycleNode, make_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from robot_runner import Condition, RobotRunnerContext

BATTERY = "sensor_msgs/BatteryState"
ODOMETRY = "nav_msgs/Odometry"


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[RobotRunnerContext]:
    context = make_context(tmp_path, robot="simulated:initial_charge=55")
    yield context
    context.resources.close()


def test_names_are_relative_to_the_namespace_of_the_runs_robot(tmp_path: Path) -> None:
    context = make_context(tmp_path, robot="simulated:namespace=/alice")
    for condition in (
        node_present("turtlebot3_node"),
        topic_present("odom", ODOMETRY),
        topic_present("/alice/odom"),
        service_present("task/stop"),
        message_on("odom", ODOMETRY),
        battery_above(50),
    ):
        assert condition.wait(context, timeout_s=2.0).holds, str(condition)
    with pytest.raises(ConditionError, match=r"/odom is not: \d topics are there, among them /alice/odom"):
        topic_present("/odom").wait(context, timeout_s=0.3)
    with pytest.raises(ConditionError, match=r": \d+ messages on /alice/odom"):
        message_on("odom", ODOMETRY, lambda _: False).wait(context, timeout_s=0.3)
    context.resources.close()


def test_a_topic_on_which_nothing_came_is_named_as_on_the_graph_of_the_runs_robot(tmp_path: Path) -> None:
    links = FakeLinks(robot=FakeRobotLink(FakeClock()), namespace="/front")
    context = make_context(tmp_path, robot="ros2://alice", links=links)
    with pytest.raises(ConditionError, match="no message on /alice/front/battery_state yet"):
        battery_above(10, namespace="/front").wait(context, timeout_s=0.3)


def test_what_is_on_the_graph_of_a_simulated_robot_holds_at_once(simulated: RobotRunnerContext) -> None:
    for condition in (
        node_present("turtlebot3_node"),
        topic_present("odom", ODOMETRY),
        topic_present("odom", "nav_msgs/msg/Odometry"),
        service_present("task/stop"),
        battery_above(50),
        battery_below(56),
    ):
        assert condition.wait(simulated, timeout_s=2.0).holds, str(condition)
        assert list(condition.check(simulated.robot)) == []
    with pytest.raises(ConditionError, match=r"\d topics are there, among them /odom"):
        topic_present("odmo").wait(simulated, timeout_s=0.3)
    with pytest.raises(ConditionError, match="/odom is there and carries nav_msgs/Odometry"):
        topic_present("odom", BATTERY).wait(simulated, timeout_s=0.3)


def test_a_managed_node_is_awaited_until_it_is_in_a_state(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    context = make_context(tmp_path, links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(ConditionError, match="there is no service '/slam/get_state'"):
        lifecycle_state("slam").wait(context, timeout_s=0.5)
    LifecycleNode(link, "/slam")
    with pytest.raises(ConditionError, match="/slam is unconfigured"):
        lifecycle_state("slam", "inactive").wait(context, timeout_s=0.5)
    clock.at(clock.now() + 1.0, lambda: change_state(link, "slam", "configure"))
    assert lifecycle_state("slam", "inactive").wait(context, timeout_s=2.0).value == "inactive"
    assert [each.is_error for each in lifecycle_state("slam").check(None)] == [True]
    with pytest.raises(ConditionError, match="'activ' is not a state"):
        lifecycle_state("slam", "activ")


def test_a_mission_ends_when_the_robot_has_come_so_far(simulated: RobotRunnerContext) -> None:
    began, clock = time.monotonic(), simulated.clock.now()
    connect_robot(simulated).publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
    look = topic_above("odom", ODOMETRY, "pose.pose.position.x", 1.0).wait(simulated, timeout_s=60.0)
    assert look.value == pytest.approx(1.0, abs=0.02)
    assert 4.5 < simulated.clock.now() - clock < 7.0
    message_on("odom", ODOMETRY, lambda odom: odom["pose"]["pose"]["position"]["x"] > 1.5).wait(
        simulated, timeout_s=60.0
    )
    assert 2.0 < simulated.clock.now() - clock - 4.5 < 5.0
    assert time.monotonic() - began < 60.0


def test_a_topic_that_a_simulated_robot_never_has_is_not_awaited(simulated: RobotRunnerContext) -> None:
    with pytest.raises(LinkError, match="'/odmo' is not a topic") as error:
        topic_above("odmo", ODOMETRY, "pose.pose.position.x", 1.0).wait(simulated, timeout_s=60.0)
    assert "'/odom'" in error.value.fix


class Robot:
    """A fake robot whose messages a test sends."""

    def __init__(self, folder: Path) -> None:
        self.clock = FakeClock()
        self.link = FakeRobotLink(self.clock)
        self.context = make_context(folder, links=FakeLinks(robot=self.link), clock=self.clock)

    def sends(self, topic: str, message: dict, *, at: float) -> None:
        self.clock.at(at, lambda: self.link.deliver(topic, message))

    def waits(self, condition: Condition, timeout_s: float = 30.0) -> float:
        condition.wait(self.context, timeout_s=timeout_s)
        return self.clock.now()


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def test_the_newest_message_counts_and_an_old_one_does_not(robot: Robot) -> None:
    robot.sends("battery_state", {"percentage": 0.7, "voltage": 12.1}, at=1.0)
    robot.sends("battery_state", {"percentage": 0.3, "voltage": 11.1}, at=2.0)
    assert robot.waits(battery_below(50)) == pytest.approx(2.0, abs=0.06)
    with ExitStack() as opened:
        look = battery_below(50).watch(robot.context, opened)
        robot.sends("battery_state", {"percentage": 0.3}, at=3.0)
        robot.clock.sleep(2.0)
        assert look().holds
        robot.clock.sleep(10.0)
        assert not look().holds
        assert "the newest message on /battery_state is 1" in look().seen


@pytest.mark.parametrize(("period", "count", "is_known"), [(0.1, 30, False), (4.0, 30, True), (0.1, 5, True)])
def test_of_a_topic_that_has_fallen_silent_nothing_is_known_unless_that_is_its_way(
    robot: Robot, period: float, count: int, is_known: bool
) -> None:
    with ExitStack() as opened:
        look = topic_below("volts", "std_msgs/Float32", "data", 11).watch(robot.context, opened)
        for number in range(count):
            robot.sends("volts", {"data": 10.0}, at=(number + 1) * period)
        robot.clock.sleep(count * period + 9.0)
        assert look().holds
        robot.clock.sleep(6.0)
        assert (look().is_known, look().holds) == (is_known, is_known)
        assert ("is 15.0 s old" in look().seen) is not is_known


@pytest.mark.parametrize("condition", [battery_above(10), battery_below(10)], ids=str)
@pytest.mark.parametrize("unknown", [float("nan"), -0.01])  # as some pass on the -1 % of an autopilot
def test_a_robot_that_does_not_tell_its_charge_is_neither_charged_nor_flat(
    robot: Robot, condition: Condition, unknown: float
) -> None:
    robot.sends("battery_state", {"percentage": unknown, "voltage": 12.1}, at=0.1)
    with pytest.raises(ConditionError, match="the robot does not report its charge"):
        robot.waits(condition, timeout_s=1.0)


@pytest.mark.parametrize(("seen", "is_near", "is_far"), [(math.inf, False, True), (-math.inf, True, False)])
def test_nothing_within_reach_is_far_and_something_too_near_to_measure_is_near(
    robot: Robot, seen: float, is_near: bool, is_far: bool
) -> None:
    near = topic_below("scan", "sensor_msgs/LaserScan", "ranges.0", 0.2)
    far = topic_above("scan", "sensor_msgs/LaserScan", "ranges.0", 0.2)
    with ExitStack() as opened:
        looks = [each.watch(robot.context, opened) for each in (near, far)]
        robot.link.deliver("scan", {"ranges": [seen]})
        found = [look() for look in looks]
        assert [each.holds for each in found] == [is_near, is_far]
        assert all(each.is_known for each in found)
        robot.link.deliver("scan", {"ranges": [math.nan]})
        assert [(each.holds, each.is_known) for each in (look() for look in looks)] == [(False, False)] * 2


def test_a_charge_in_percent_is_not_taken_for_a_share(robot: Robot) -> None:
    robot.sends("battery_state", {"percentage": 12.0}, at=0.1)
    with pytest.raises(ConditionError, match="the robot reports a percentage of 12, and ROS has it from 0 to 1"):
        robot.waits(battery_above(50), timeout_s=1.0)


def test_nothing_is_known_of_messages_that_cannot_be_subscribed(tmp_path: Path) -> None:
    class Unreachable(FakeRobotLink):
        def subscribe(self, *_: object, **__: object) -> NoReturn:
            raise LinkError("the graph cannot be reached", where="robot", fix="Look at it.")

    clock = FakeClock()
    context = make_context(tmp_path, robot="ros2", links=FakeLinks(robot=Unreachable(clock)), clock=clock)
    silent = not_(message_on("heartbeat", "std_msgs/Bool"))
    with pytest.raises(ConditionError, match="the graph cannot be reached"):
        silent.wait(context, timeout_s=1.0)


def test_of_a_topic_whose_type_nobody_tells_it_is_not_known_whether_it_has_that_type(robot: Robot) -> None:
    robot.link.topics = lambda: {"/scan": "*"}
    look = not_(topic_present("scan", "sensor_msgs/LaserScan")).watch(robot.context, ExitStack())()
    assert (look.holds, look.is_known) == (False, False)
    assert look.seen == "/scan is there and nothing tells what it carries"


def test_a_message_between_two_looks_is_not_overlooked(robot: Robot) -> None:
    with ExitStack() as opened:
        look = message_on("bumper", "std_msgs/Bool", lambda message: message["data"]).watch(robot.context, opened)
        assert not look().holds
        for at, pressed in ((0.1, False), (0.2, True), (0.3, False)):
            robot.sends("bumper", {"data": pressed}, at=at)
        robot.clock.sleep(1.0)
        assert look().holds  # it was pressed since the look before
        assert not look().holds  # and is not any more


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: topic_above("scan", "sensor_msgs/LaserScan", "rangse.0", 1), "the message has no field 'rangse.0'"),
        (lambda: topic_above("scan", "sensor_msgs/LaserScan", "ranges.7", 1), "the message has no field 'ranges.7'"),
        (lambda: topic_above("scan", "sensor_msgs/LaserScan", "ranges", 1), "is not a number"),
        (lambda: message_on("scan", "sensor_msgs/LaserScan", lambda scan: scan["nothing"]), "'nothing'"),
    ],
)
def test_a_field_that_no_message_has_ends_the_wait(robot: Robot, make: Callable[[], Condition], problem: str) -> None:
    robot.sends("scan", {"ranges": [1.0, 2.0]}, at=0.5)
    with pytest.raises((ConditionError, KeyError), match=problem):
        robot.waits(make())
    assert robot.clock.now() < 2.0


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: topic_above(5, ODOMETRY, "x", 1), "5 is not a name"),
        (lambda: message_on("odom", ODOMETRY, namespace=None), "None is not a name"),
        (lambda: node_present(None), "None is not a name"),
        (lambda: battery_below(15, namespace=7), "7 is not a name"),
        (lambda: topic_below("odom", ODOMETRY, 5, 1), "5 is not a field"),
        (lambda: topic_below("odom", ODOMETRY, "", 1), "'' is not a field"),
        (lambda: topic_above("odom", "Odometry", "x", 1), "'Odometry' is not the type of a message"),
        (lambda: message_on("odom", 5), "5 is not the type of a message"),
        (lambda: topic_present("scan", "LaserScan"), "'LaserScan' is not the type of a message"),
    ],
)
def test_what_cannot_be_a_name_a_type_or_a_field_is_refused_in_the_config(
    make: Callable[[], Condition], problem: str
) -> None:
    with pytest.raises((ConditionError, LinkError), match=problem):
        make()


def test_both_spellings_of_a_type_are_taken() -> None:
    assert str(message_on("odom", "nav_msgs/msg/Odometry")) == str(message_on("odom", ODOMETRY))
    assert str(topic_present("scan", "sensor_msgs/msg/LaserScan")).endswith("is there")


def test_what_needs_a_robot_is_refused_where_there_is_none(tmp_path: Path) -> None:
    context = make_context(tmp_path, robot=None)
    for condition in (battery_above(50), node_present("move_base"), message_on("odom", ODOMETRY)):
        assert [finding.is_error for finding in condition.check(None)] == [True]
        with pytest.raises((ConditionError, LinkError), match="names no robot"):
            condition.wait(context, timeout_s=0.1)
