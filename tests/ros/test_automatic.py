"""`robot = "auto"` takes the first that is there, says why, and never the simulation."""

from __future__ import annotations

import pytest
from tests.loopback_port import claim_port
from tests.ros.ros1_master import needs_ros1, ros1_master

from robot_runner.core.errors import LinkError
from robot_runner.core.links import connect
from robot_runner.ros import ros_environment
from robot_runner.ros.ros_environment import found_robot


@pytest.fixture(autouse=True)
def _nothing_is_there(monkeypatch):
    for name in ("ROS_VERSION", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{claim_port()}")
    monkeypatch.setattr(ros_environment, "_BRIDGE", ("127.0.0.1", claim_port()))
    monkeypatch.setattr(ros_environment, "_LOOK_AT_GRAPH", "raise SystemExit(1)")
    found_robot.cache_clear()
    yield
    found_robot.cache_clear()


def installed(monkeypatch, *packages):
    monkeypatch.setattr(ros_environment, "_is_installed", lambda package: package in packages)


def test_where_nothing_is_found_it_says_what_was_looked_for():
    with pytest.raises(LinkError, match="no ROS is sourced") as caught:
        found_robot()
    assert "rosbridge" in caught.value.problem
    assert "DDS" in caught.value.problem
    assert "--set robot=simulated" in caught.value.fix


@pytest.mark.parametrize(("version", "package", "name"), [("1", "rospy", "ros1"), ("2", "rclpy", "ros2")])
def test_a_sourced_ros_goes_first(monkeypatch, version, package, name):
    monkeypatch.setenv("ROS_VERSION", version)
    installed(monkeypatch, package)
    found = found_robot()
    assert found.name == name
    assert f"ROS {version} is sourced" in found.reason


@pytest.mark.parametrize("robot", ["auto:namespace=/alice", "auto://alice", "auto:clock=graph"])
def test_what_would_be_lost_by_looking_is_refused(monkeypatch, robot):
    monkeypatch.setenv("ROS_VERSION", "1")
    installed(monkeypatch, "rospy")
    assert connect.found_robot("auto").name == "ros1"
    for ask in (connect.found_robot, connect.resolved_robot):
        with pytest.raises(LinkError, match=f"robot is {robot!r}, and what is looked for takes no options"):
            ask(robot)


def test_a_sourced_ros_without_its_client_library_does_not_count(monkeypatch):
    monkeypatch.setenv("ROS_VERSION", "2")
    installed(monkeypatch)
    with pytest.raises(LinkError):
        found_robot()


@needs_ros1
def test_a_master_that_answers_is_found(monkeypatch, tmp_path):
    with ros1_master(tmp_path) as uri:
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        assert found_robot().name == "ros1"
        assert uri in found_robot().reason


def test_a_rosbridge_on_this_machine_is_found(monkeypatch):
    import socket

    installed(monkeypatch, "websockets")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        monkeypatch.setattr(ros_environment, "_BRIDGE", ("127.0.0.1", port))
        assert found_robot().name == f"rosbridge://127.0.0.1:{port}"


def test_a_graph_of_dds_is_found_last(monkeypatch):
    installed(monkeypatch, "cyclonedds", "rosbags")
    monkeypatch.setattr(ros_environment, "_LOOK_AT_GRAPH", "raise SystemExit(0)")
    assert found_robot().name == "dds"


def test_where_python_may_not_be_started_no_graph_is_found(monkeypatch):
    installed(monkeypatch, "cyclonedds", "rosbags")
    monkeypatch.setattr(ros_environment.sys, "executable", "/nonexistent/python")
    with pytest.raises(LinkError, match="no ROS is sourced"):
        found_robot()
