"""Velocity commands are of the type that the robot hears."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.robot import Qos
from robot_runner.ros.turtlebot3.motion import Wheels
from robot_runner.ros.watchdog import TWIST, TWIST_STAMPED
from robot_runner.testing import FakeClock, FakeRobotLink


@pytest.fixture
def link(monkeypatch):
    monkeypatch.setattr(commanded_topics, "_types", {})  # by which other tests have commanded robots
    return FakeRobotLink(FakeClock())


@pytest.mark.parametrize("heard", [TWIST, TWIST_STAMPED])
def test_the_robot_hears_the_type_that_its_topic_carries(link, heard):
    link.known_topics = {"/alice/cmd_vel": heard, "/cmd_vel": "std_msgs/String"}
    wheels = Wheels(link, namespace="/alice")
    wheels.command(0.2, 0.5)
    (said,) = link.publications
    twist = said.message["twist"] if heard == TWIST_STAMPED else said.message
    assert (said.message_type, twist["linear"]["x"], twist["angular"]["z"]) == (heard, 0.2, 0.5)
    assert not link.stands_still
    wheels.command(0.0, 0.0)
    assert link.stands_still


def test_a_stamp_is_left_to_the_robot_whose_clock_may_be_another(link):
    link.known_topics = {"cmd_vel": TWIST_STAMPED}
    Wheels(link).command(0.2, 0.0)
    assert "header" not in link.publications[0].message


@pytest.mark.parametrize("heard", [None, "std_msgs/String"])
def test_a_robot_that_is_not_heard_of_or_hears_something_else_is_commanded_as_of_old(link, heard):
    link.known_topics = {"cmd_vel": heard} if heard else {}
    Wheels(link).command(0.0, 0.0)
    assert link.publications[0].message_type == TWIST


def test_a_robot_that_comes_later_is_asked_again(link):
    wheels = Wheels(link, namespace="/alice")
    wheels.command(0.0, 0.0)
    link.known_topics = {"/alice/cmd_vel": TWIST_STAMPED}
    wheels.command(0.2, 0.0)
    assert [each.message_type for each in link.publications] == [TWIST, TWIST_STAMPED]


class DiscoveredLate(FakeRobotLink):
    """A graph that discovers the robot while a publisher is made, as one that was just joined."""

    def publish(self, topic, message_type, message, *, qos=Qos.DEFAULT):
        self.known_topics = {"cmd_vel": TWIST_STAMPED}
        if message_type == TWIST:
            raise LinkError(f"the topic carries {TWIST_STAMPED}", where=topic)
        super().publish(topic, message_type, message, qos=qos)


def test_a_robot_that_is_discovered_by_the_first_command_gets_it(link):
    link = DiscoveredLate(FakeClock())
    Wheels(link).command(0.0, 0.0)
    assert [each.message_type for each in link.publications] == [TWIST_STAMPED]


def test_what_a_robot_refuses_is_raised(link):
    link.fault = LinkError("the cable came off", where="robot")
    with pytest.raises(LinkError, match="the cable came off"):
        Wheels(link).command(0.0, 0.0)
