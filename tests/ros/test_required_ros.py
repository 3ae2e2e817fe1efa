"""The ROS that an experiment requires is compared with each that is found, and each finding says where that was."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace

import pytest

from robot_runner.core.config import preparation as robot_check
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.preparation import check_robot, choose_robot
from robot_runner.core.errors import LinkError
from robot_runner.core.links.kinds import FoundRobot
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros import ros_environment
from robot_runner.ros.required_ros import check_required_ros
from robot_runner.ros.ros1_master import Master
from robot_runner.ros.ros_environment import (
    RosEnvironment,
    find_ros,
    installed_ros,
    ros_of_host,
    ros_of_master,
)


@pytest.fixture(autouse=True)
def _no_ros_here(monkeypatch):
    for name in ("ROS_VERSION", "ROS_DISTRO", "ROS_MASTER_URI"):
        monkeypatch.delenv(name, raising=False)
    installed_is(monkeypatch, None)


def installed_is(monkeypatch, version):
    def find(name):
        if version is None:
            raise ros_environment.metadata.PackageNotFoundError(name)
        return version

    monkeypatch.setattr(ros_environment.metadata, "version", find)


def master_says(monkeypatch, **parameters):
    monkeypatch.setattr(Master, "parameter", lambda self, name: parameters.get(name.strip("/")))


def found(version, distro=None, robot=None, hosts=()):
    parameters = SimpleNamespace(required_ros_version=version, required_ros_distro=distro)
    name = None if robot is None else RobotName.parse(robot)
    return list(check_required_ros("Config", parameters, name, hosts))


@pytest.mark.parametrize("robot", [None, "ros1", "dds", "rosbridge://robot:9090"])
def test_none_requires_nothing(robot):
    assert found(None, "noetic", robot) == []


def test_any_version_is_any_that_is_sourced(monkeypatch):
    (finding,) = found("any")
    assert "requires ROS, and no ROS is found on this machine" in finding.problem
    monkeypatch.setenv("ROS_VERSION", "2")
    assert found("any") == []


def test_debian_s_rospy_is_noetic_by_its_version(monkeypatch):
    installed_is(monkeypatch, "1.15.15")
    assert installed_ros() == RosEnvironment(1, "noetic", "rospy 1.15.15, which this Python imports")
    installed_is(monkeypatch, "1.16.0")
    assert installed_ros().distro == "noetic"
    assert found(1, "noetic") == []
    (finding,) = found(1, "melodic")
    assert finding.is_error
    assert "requires 'melodic', and 'noetic' is found (rospy 1.16.0" in finding.problem
    installed_is(monkeypatch, "1.17.0")
    assert installed_ros().distro is None


def test_a_sourced_ros_goes_before_an_installed_package(monkeypatch):
    installed_is(monkeypatch, "1.15.15")
    monkeypatch.setenv("ROS_VERSION", "1")
    monkeypatch.setenv("ROS_DISTRO", "melodic")
    assert found(1, "melodic") == []


@pytest.mark.parametrize(
    ("parameters", "distro", "source"),
    [
        ({"rosdistro": "noetic\n", "rosversion": "1.15.15\n"}, "noetic", "/rosdistro"),
        ({"rosdistro": "Debian\n", "rosversion": "1.15.15\n"}, "noetic", "/rosversion 1.15.15 of"),
        ({"rosversion": "1.14.3"}, "melodic", "/rosversion 1.14.3 of"),
        ({"rosversion": "7"}, None, "/rosversion 7 of"),
        ({}, None, "without roslaunch"),
    ],
)
def test_a_master_says_its_distribution_or_its_version(monkeypatch, parameters, distro, source):
    master_says(monkeypatch, **parameters)
    told = ros_of_master(Master("http://robot:11311"))
    assert (told.version, told.distro) == (1, distro)
    assert source in told.source
    assert "http://robot:11311" in told.source


def test_the_master_s_distribution_must_be_the_one_that_is_required_too(monkeypatch):
    installed_is(monkeypatch, "1.15.15")
    master_says(monkeypatch, rosdistro="melodic\n")
    (finding,) = found(1, "noetic", "ros1:master=http://robot:11311")
    assert "'melodic' is found (/rosdistro of the master http://robot:11311)" in finding.problem
    assert "Reach a robot that has ROS 1 noetic" in finding.fix


def test_a_master_that_is_not_there_is_left_to_the_link_s_finding(monkeypatch):
    installed_is(monkeypatch, "1.15.15")
    assert found(1, "noetic", "ros1:master=http://127.0.0.1:9") == []


@pytest.mark.parametrize(("robot", "version"), [("ros1", 2), ("ros2", 1), ("dds", 1)])
def test_a_link_of_the_other_generation_is_refused(robot, version):
    (finding,) = found(version, None, robot)
    assert finding.is_error
    assert f"requires ROS {version}, and robot = {robot!r} speaks ROS {3 - version}" in finding.problem
    assert "rosbridge" in finding.fix


@pytest.mark.parametrize("robot", ["dds", "dds:domain=7"])
def test_over_dds_this_machine_needs_no_ros_and_the_distribution_must_be_said(robot):
    assert found(2, None, robot) == []
    (finding,) = found(2, "humble", robot)
    assert not finding.is_error
    assert "nothing tells the robot's distribution" in finding.problem
    assert "dds:distro=humble" in finding.fix


def test_over_dds_the_distribution_that_is_said_counts():
    assert found(2, "humble", "dds:distro=humble") == []
    (finding,) = found(2, "humble", "dds:distro=jazzy")
    assert "requires 'humble', and 'jazzy' is found (robot = 'dds:distro=jazzy')" in finding.problem


def test_a_rosbridge_counts_as_what_its_address_says():
    assert found(1, "noetic", "rosbridge://robot:9090?distro=noetic") == []
    (finding,) = found(2, None, "rosbridge://robot:9090?distro=noetic")
    assert "requires ROS 2, and ROS 1 is found" in finding.problem


def answers(monkeypatch, output, code=0, errors=b""):
    monkeypatch.setattr(
        ros_environment.subprocess,
        "run",
        lambda *_, **__: subprocess.CompletedProcess([], code, output, errors),
    )


def test_a_robot_s_computer_is_asked_over_its_host_link(monkeypatch):
    answers(monkeypatch, b"/opt/ros/foxy/setup.sh\n/opt/ros/humble/setup.sh\n")
    assert [each.distro for each in ros_of_host("pi@robot")] == ["foxy", "humble"]
    assert found(2, "humble", "dds", [("pi@robot", None)]) == []
    (finding,) = found(2, "jazzy", "dds", [("pi@robot", None)])
    assert "requires 'jazzy', and 'foxy' and 'humble' is found (/opt/ros of pi@robot)" in finding.problem


def test_a_computer_without_ros_tells_nothing(monkeypatch):
    answers(monkeypatch, b"/opt/ros/*/setup.sh\n")
    assert ros_of_host("pi@robot") == []


def test_a_computer_that_cannot_be_reached_is_a_warning(monkeypatch):
    answers(monkeypatch, b"", 255, b"Permission denied (publickey).\n")
    findings = found(2, "humble", "dds", [("pi@robot", None)])
    assert not any(finding.is_error for finding in findings)
    assert "Permission denied" in findings[0].problem
    assert "ssh pi@robot true" in findings[0].fix


def test_the_other_generation_s_shell_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_VERSION", "2")
    monkeypatch.setattr(robot_check, "link_findings", lambda _: [])
    parameters = Parameters(experiment_name="trial", robot="ros1")
    (finding,) = check_robot(SimpleNamespace(where="Config"), parameters)
    assert "robot is 'ros1', and ROS 2 is sourced" in finding.problem


def config_of(robot):
    return SimpleNamespace(where="Config", config=SimpleNamespace(robot=robot))


def test_auto_is_replaced_by_what_is_found_and_says_so(monkeypatch):
    monkeypatch.setattr(ros_environment, "found_robot", lambda: FoundRobot("ros1", "a ROS 1 master answers"))
    loaded = config_of("auto")
    (finding,) = choose_robot(loaded)
    assert loaded.config.robot == "ros1"
    assert not finding.is_error
    assert "'ros1' was chosen: a ROS 1 master answers" in finding.problem


def test_auto_without_a_robot_is_refused(monkeypatch):
    def nothing():
        raise LinkError("no robot is found", where="robot", fix="Name one.")

    monkeypatch.setattr(ros_environment, "found_robot", nothing)
    (finding,) = choose_robot(config_of("auto"))
    assert finding.is_error
    assert choose_robot(config_of("simulated")) == choose_robot(config_of(None)) == []


def test_what_a_setup_file_says_is_read_from_the_environment():
    assert find_ros({"ROS_VERSION": "2", "ROS_DISTRO": "humble"}).distro == "humble"
    assert find_ros({"ROS_VERSION": "3"}) is None
    assert find_ros({}) is None


@pytest.mark.parametrize(("robot", "more"), [("rosbridge+tls://robot?ros=2", "&"), ("wss://robot", "?")])
def test_over_tls_too_the_distribution_can_be_said(robot, more):
    (finding,) = found(2, "humble", robot)
    assert f"'{robot}{more}distro=humble'" in finding.fix
    assert found(2, "humble", f"{robot}{more}distro=humble") == []
