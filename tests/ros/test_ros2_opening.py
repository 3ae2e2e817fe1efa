"""What stands in the way of ROS 2 is told before anything is opened, on a machine without ROS too."""

from __future__ import annotations

import importlib.util

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import RobotName
from robot_runner.ros.ros2_link import findings, open_ros2_link


@pytest.fixture(autouse=True)
def unsourced(monkeypatch):
    for name in ("ROS_VERSION", "ROS_DISTRO", "ROS_DOMAIN_ID"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("name", ["ros2:domain=233", "ros2:domain=-1", "ros2:domain=one"])
def test_a_domain_that_cannot_be_is_a_finding(name):
    (finding,) = findings(RobotName.parse(name))
    assert "domain id" in finding.problem
    assert "232" in finding.fix


def test_a_wrong_domain_of_the_environment_is_named(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "robot")
    (finding,) = findings(RobotName.parse("ros2"))
    assert finding.where == "ROS_DOMAIN_ID"


def test_a_misspelt_option_is_a_finding():
    (finding,) = findings(RobotName.parse("ros2:domian=3"))
    assert finding.fix == "Did you mean 'domain'?"


def test_a_sourced_ros_1_is_a_finding(monkeypatch):
    monkeypatch.setenv("ROS_VERSION", "1")
    monkeypatch.setenv("ROS_DISTRO", "noetic")
    (finding,) = findings(RobotName.parse("ros2"))
    assert "noetic" in finding.problem


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="a ROS 2 is sourced")
def test_without_rclpy_the_way_without_a_ros_is_named():
    (finding,) = findings(RobotName.parse("ros2"))
    assert "rclpy cannot be imported" in finding.problem
    with pytest.raises(LinkError, match="rclpy cannot be imported") as caught:
        open_ros2_link({}, SystemClock())
    assert "robot = 'dds'" in caught.value.fix
