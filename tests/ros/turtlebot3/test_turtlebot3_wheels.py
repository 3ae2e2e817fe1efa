"""Velocity commands are of the type that the robot hears."""

from __future__ import annotations

import pytest

from robot_runner.ros.turtlebot3.motion import Wheels
from robot_runner.ros.watchdog import TWIST, TWIST_STAMPED
from robot_runner.testing import FakeClock, FakeRobotLink


@pytest.fixture
def link():
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
