"""Opens a link over rclpy, and checks whether it can be opened; nothing of ROS is imported before."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping
from functools import partial

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_addresses import check_options, domain_id
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_transport import is_simulated_time, receive_clock
from robot_runner.ros.ros_environment import RosEnvironment, find_ros, other_python_of_rclpy

_OPTIONS = ("domain",)
_WITHOUT_ROS = "or reach the robot without a ROS: robot = 'dds'"
_HUMBLE = "humble"


def findings(name: RobotName) -> list[Finding]:
    """Return findings that prevent a link to a robot of this name over ROS 2; nothing is opened."""
    try:
        _domain(name.options)
        _check_installed()
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_ros2_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph of a `domain`, or of ROS_DOMAIN_ID, and return the link to the robot of this namespace.

    Where the run's clock is a simulation's, the node follows the time on `/clock`.

    Raises:
        LinkError: an option is not valid, no ROS 2 is sourced, or the graph cannot be joined.
    """
    domain = _domain(options)
    _check_installed()
    from robot_runner.ros.ros2_transport import Ros2Transport  # noqa: PLC0415  # rclpy, which comes with a sourced ROS 2

    is_simulated = is_simulated_time(clock)
    connect = partial(Ros2Transport, domain, receive_clock(clock), use_sim_time=is_simulated)
    return GraphLink(connect, namespace, is_simulated=is_simulated)


def _domain(options: Mapping[str, str]) -> int | None:
    check_options("ros2", options, _OPTIONS)
    domain = domain_id(options, os.environ)
    return domain if "domain" in options else None  # rclpy reads ROS_DOMAIN_ID itself


def _unfitting(ros: RosEnvironment | None, other: str) -> LinkError:
    """Return the error that the sourced ROS 2 is for another Python; it names the link that needs no rclpy."""
    distro = "" if ros is None or ros.distro is None else f" {ros.distro}"
    domain = os.environ.get("ROS_DOMAIN_ID")
    options = [f"distro={distro.strip()}"] if distro else []
    name = "dds" + (":" + ",".join([*([f"domain={domain}"] if domain else []), *options]) if domain or options else "")
    ours = ".".join(map(str, sys.version_info[:2]))
    return LinkError(
        f"the ROS 2{distro} that is sourced is for Python {other}, and this is {ours}",
        where="robot",
        fix=f"Reach the robot without a ROS on this machine: --set robot={name}. Its services need one line on the "
        "robot, or a rosbridge: docs/your-humble-robot.md.",
    )


def _check_installed() -> None:
    ros = find_ros()
    other = other_python_of_rclpy()
    if ros is not None and ros.version == 1:
        raise LinkError(
            f"robot is reached over ROS 2, but ROS 1 {ros.distro or ''} is sourced, whose messages hide those of ROS 2",
            where=ros.source,
            fix=f"Start again in a shell where a ROS 2 is sourced, {_WITHOUT_ROS}.",
        )
    if other is not None:
        raise _unfitting(ros, other)
    if importlib.util.find_spec("rclpy") is None and ros is not None and ros.distro == _HUMBLE:
        raise _unfitting(ros, "3.10")
    if importlib.util.find_spec("rclpy") is None:
        raise LinkError(
            "robot is reached over ROS 2, but rclpy cannot be imported",
            where="robot",
            fix=f"Source a ROS 2 whose Python is ours (source /opt/ros/jazzy/setup.bash), {_WITHOUT_ROS}.",
        )
