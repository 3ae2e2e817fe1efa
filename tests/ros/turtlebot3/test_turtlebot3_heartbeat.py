"""While a run operates a robot it gives signs of life; it says farewell only to a robot that stands still."""

from __future__ import annotations

import time

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.ros.turtlebot3.odometry import Odometer
from robot_runner.ros.turtlebot3.steered_robot import Heartbeat, Robot
from robot_runner.testing import FakeClock, FakeRobotLink, FakeTurtlebot3Link


def beats(link):
    return [each.message["data"] for each in link.publications if each.topic == "robot_runner/heartbeat"]


def until(holds):
    deadline = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def robot_on(link, clock):
    return Robot(link, Odometer(clock, timeout=1.0, where="robot"), clock)


def test_the_heart_beats_several_times_a_second_until_it_is_ended():
    link = FakeRobotLink(FakeClock())
    began, heartbeat = time.monotonic(), Heartbeat(link)  # it beats from now on, whenever this thread goes on
    until(lambda: len(beats(link)) >= 4)
    assert time.monotonic() - began > 0.25  # not faster than needed
    heartbeat.end()
    heartbeat.end()
    count = len(beats(link))
    assert beats(link) == list(range(1, count + 1))


def test_the_embedded_robot_needs_none():
    link = FakeRobotLink(FakeClock(), is_simulated=True)
    heartbeat = Heartbeat(link)
    heartbeat.end()
    heartbeat.say_farewell()
    assert link.publications == []


def test_a_robot_that_was_made_safe_hears_a_farewell_last():
    clock = FakeClock()
    link = FakeTurtlebot3Link(clock)
    robot_on(link, clock).close()
    assert link.stands_still
    assert link.publications[-1].message == {"data": 0}


def test_a_robot_that_cannot_be_made_safe_hears_none():
    clock = FakeClock()
    link = FakeTurtlebot3Link(clock)
    robot = robot_on(link, clock)
    until(lambda: beats(link))
    link.fault = LinkError("the cable came off", where="robot", fix="Plug it in.")
    with pytest.raises(LinkError, match="the cable came off"):
        robot.close()
    assert 0 not in beats(link)


def test_a_robot_is_made_safe_where_who_else_commands_it_can_no_longer_be_watched():
    clock = FakeClock()
    link = FakeTurtlebot3Link(clock)
    robot = robot_on(link, clock)
    link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})

    def fail():
        raise LinkError("leaving the topic took longer than 5 s", where="/cmd_vel", fix="Look at the master.")

    robot.control.end = fail
    with pytest.raises(LinkError, match="leaving the topic"):
        robot.close()
    assert link.stands_still


def test_a_link_that_is_lost_ends_the_beats_and_nothing_else():
    link = FakeRobotLink(FakeClock())
    link.fault = LinkError("the cable came off", where="robot", fix="Plug it in.")
    heartbeat = Heartbeat(link)
    until(lambda: not heartbeat._thread.is_alive())
    heartbeat.end()
