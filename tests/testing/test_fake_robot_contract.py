"""The fake link of a robot is of the protocol, so that what is tested with it works with a real one."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Qos, RobotLink, Subscription
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.testing import FakeAction, FakeClock, FakeRobotLink, FakeTurtlebot3Link

STRING = "std_msgs/String"


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def link(clock):
    return FakeRobotLink(clock)


def test_it_is_a_robot_link(link, clock):
    assert isinstance(link, RobotLink)
    assert isinstance(FakeTurtlebot3Link(clock), RobotLink)
    assert isinstance(link.subscribe("door", STRING, print), Subscription)
    assert isinstance(link.offer("bell", "std_srvs/Trigger", lambda _: {}), Subscription)


def test_what_is_published_keeps_how(link):
    link.publish("map", STRING, {"data": "a"}, qos=Qos.TRANSIENT_LOCAL)
    assert link.publications[0].qos is Qos.TRANSIENT_LOCAL


@pytest.mark.parametrize(
    ("message_type", "moving"),
    [
        ("geometry_msgs/Twist", {"linear": {"x": 0.2}}),
        ("geometry_msgs/msg/Twist", {"angular": {"z": 0.2}}),
        ("geometry_msgs/msg/TwistStamped", {"twist": {"linear": {"x": 0.2}}}),
    ],
)
def test_a_robot_moves_until_it_is_told_to_stand_still_however_topic_and_type_are_spelt(link, message_type, moving):
    link.publish("cmd_vel", message_type, moving)
    assert not link.stands_still
    link.publish("/cmd_vel", message_type, {})
    assert link.stands_still


def test_an_ideal_robot_drives_however_topic_and_type_are_spelt(clock):
    robot = FakeTurtlebot3Link(clock)
    robot.publish("/cmd_vel", "geometry_msgs/msg/TwistStamped", {"twist": {"linear": {"x": 0.2}}})
    clock.sleep(1.0)
    assert robot.wait_for("odom", "nav_msgs/Odometry")["pose"]["pose"]["position"]["x"] == pytest.approx(0.2, abs=0.02)


def test_types_are_known_in_either_spelling_as_on_a_graph(clock):
    link = FakeRobotLink(clock, actions={"dock": FakeAction(action_type="nav2_msgs/NavigateToPose")})
    link.publish("door", "std_msgs/msg/String", {"data": "a"})
    assert link.topics() == {"/door": STRING}
    assert [each.message_type for each in link.publishers("door")] == [STRING]
    assert link.send_goal("dock", "nav2_msgs/action/NavigateToPose").result(timeout=60.0).has_succeeded


def test_what_is_delivered_is_heard_as_bytes_too(link, clock):
    raw = []
    link.subscribe_raw("door", STRING, raw.append)
    clock.sleep(1.5)
    link.deliver("door", {"data": "open"})
    assert TypeCatalogue.of(2).deserialise(STRING, raw[0].data, Encoding.CDR) == {"data": "open"}
    assert raw[0].received_ns == 1_500_000_000


def test_a_wait_lets_the_clock_go_on_until_its_deadline(link, clock):
    clock.at(2.0, lambda: link.deliver("door", {"data": "open"}))
    clock.at(1.0, lambda: link.deliver("door", {"data": "ajar"}))
    assert link.wait_for("door", STRING, lambda message: message["data"] == "open") == {"data": "open"}
    assert clock.now() == pytest.approx(2.0, abs=0.02)
    with pytest.raises(LinkError, match="within 3 s"):
        link.wait_for("door", STRING, timeout=3.0)
    assert clock.now() == pytest.approx(5.0, abs=0.05)


def test_an_offer_answers_until_it_is_closed(link):
    offer = link.offer("bell", "std_srvs/Trigger", lambda _: {"success": True})
    assert link.call("bell", "std_srvs/Trigger") == {"success": True}
    assert link.services() == {"/bell": "std_srvs/Trigger"}
    with pytest.raises(LinkError, match="already"):
        link.offer("bell", "std_srvs/Trigger", lambda _: {})
    offer.close()
    with pytest.raises(LinkError, match="no service"):
        link.call("bell", "std_srvs/Trigger")


def test_it_lists_what_is_there(link):
    link.known_topics["scan"] = "sensor_msgs/LaserScan"
    link.publish("lamp", STRING, {})
    link.subscribe("/door", STRING, print)
    assert link.topics() == {"/scan": "sensor_msgs/LaserScan", "/lamp": STRING, "/door": STRING}
    assert link.nodes() == ["/fake_robot"]
    assert "float64 x" in link.definition("geometry_msgs/Twist")
