"""What stands in the way of ROS 2 is told before anything is opened, on a machine without ROS too."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros import link_opening, ros_environment
from robot_runner.ros.graph_links import ROS2
from robot_runner.ros.link_opening import open_ros2_link
from robot_runner.ros.missions.joint_missions import SharedClock


@pytest.fixture(autouse=True)
def unsourced(monkeypatch):
    for name in ("ROS_VERSION", "ROS_DISTRO", "ROS_DOMAIN_ID"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("name", ["ros2:domain=233", "ros2:domain=-1", "ros2:domain=one"])
def test_a_domain_that_cannot_be_is_a_finding(name):
    (finding,) = ROS2.findings(RobotName.parse(name))
    assert "domain id" in finding.problem
    assert "232" in finding.fix


def test_a_wrong_domain_of_the_environment_is_named(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "robot")
    (finding,) = ROS2.findings(RobotName.parse("ros2"))
    assert finding.where == "ROS_DOMAIN_ID"


def test_a_misspelt_option_is_a_finding():
    (finding,) = ROS2.findings(RobotName.parse("ros2:domian=3"))
    assert finding.fix == "Did you mean 'domain'?"


def test_a_sourced_ros_1_is_a_finding(monkeypatch):
    monkeypatch.setenv("ROS_VERSION", "1")
    monkeypatch.setenv("ROS_DISTRO", "noetic")
    (finding,) = ROS2.findings(RobotName.parse("ros2"))
    assert "noetic" in finding.problem


def test_a_robot_that_moves_together_with_another_is_no_simulated_one(monkeypatch):
    # Such a one would have no heartbeat for its watchdog, and nobody would look who else commands it.
    opened = []
    transport = MagicMock(side_effect=lambda *_, **options: opened.append(options) or MagicMock())
    monkeypatch.setitem(sys.modules, "robot_runner.ros.ros2_transport", SimpleNamespace(Ros2Transport=transport))
    monkeypatch.setattr(link_opening, "_check_rclpy", lambda: None)
    simulated = SimpleNamespace(now=lambda: 0.0, sleep=lambda _: None, is_simulated=True)
    links = [open_ros2_link({}, SharedClock(clock), "/alice") for clock in (SystemClock(), simulated)]
    assert [link.is_simulated for link in links] == [False, True]
    assert [options["use_sim_time"] for options in opened] == [False, True]


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="a ROS 2 is sourced")
def test_without_rclpy_the_way_without_a_ros_is_named():
    (finding,) = ROS2.findings(RobotName.parse("ros2"))
    assert "rclpy cannot be imported" in finding.problem
    with pytest.raises(LinkError, match="rclpy cannot be imported") as caught:
        open_ros2_link({}, SystemClock())
    assert "robot = 'dds'" in caught.value.fix


def test_a_humble_that_is_sourced_for_another_python_leads_to_the_link_that_needs_none(monkeypatch, tmp_path):
    package = tmp_path / "rclpy"
    package.mkdir()
    (package / "__init__.py").write_text("from rclpy import _rclpy_pybind11\n")
    (package / "_rclpy_pybind11.cpython-310-x86_64-linux-gnu.so").write_bytes(b"")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)  # where a test has used that of this Python before
    for name, value in {"ROS_VERSION": "2", "ROS_DISTRO": "humble", "ROS_DOMAIN_ID": "30"}.items():
        monkeypatch.setenv(name, value)
    (finding,) = ROS2.findings(RobotName.parse("ros2"))
    assert "the ROS 2 humble that is sourced is for Python 3.10" in finding.problem
    assert "--set robot=dds:domain=30,distro=humble" in finding.fix
    assert "docs/your-humble-robot.md" in finding.fix
    assert ros_environment._sourced() is None  # what `auto` finds
    suffix = importlib.machinery.EXTENSION_SUFFIXES[0]
    (package / f"_rclpy_pybind11{suffix}").write_bytes(b"")
    assert ROS2.findings(RobotName.parse("ros2")) == []
