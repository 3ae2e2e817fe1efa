"""The link over rclpy keeps what every link to a graph promises; executed where a ROS 2 is sourced."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_ros2_link
from robot_runner.testing.graph_link_contract import GraphLinkContract

if TYPE_CHECKING:
    from robot_runner.core.links.robot import RobotLink

pytestmark = pytest.mark.ros2

#: Of its own for each process of tests, among the domains whose ports no other program is given.
DOMAIN = str(1 + os.getpid() % 100)


@pytest.fixture(autouse=True)
def on_loopback(monkeypatch):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


class TestRos2Link(GraphLinkContract):
    # ROS' own; neither example_interfaces nor nav2_msgs is on the package index.
    action_type = "test_msgs/Fibonacci"
    other_action_type = "test_msgs/NestedMessage"

    def make_link(self, namespace: str = "") -> RobotLink:
        return open_ros2_link({"domain": DOMAIN}, SystemClock(), namespace)
