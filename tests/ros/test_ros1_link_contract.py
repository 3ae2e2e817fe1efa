"""The link over rospy keeps to the contract of links, on a real master."""

from __future__ import annotations

import pytest
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_ros1_link
from robot_runner.testing import GraphLinkContract


@quiet_about_rospy
class TestRos1Link(GraphLinkContract):
    @pytest.fixture(autouse=True)
    def _graph(self, master_uri):
        self.master_uri = master_uri

    def make_link(self, namespace=""):
        return open_ros1_link({"master": self.master_uri}, SystemClock(), namespace)
