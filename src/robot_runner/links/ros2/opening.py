"""Opens a link over rclpy, and says what stands in its way; nothing of ROS is loaded before."""

from __future__ import annotations

import importlib.util
import os
from typing import TYPE_CHECKING

from robot_runner.errors import Finding, LinkError, did_you_mean
from robot_runner.links.ros_environment import find_ros

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.links.robot_name import RobotName

__all__ = ["findings", "open_ros2_link"]

_OPTIONS = ("domain",)
_WITHOUT_ROS = "or reach the robot without a ROS: robot = 'dds'"
#: Domains above this have UDP ports past 65535 (RTPS 2.2, 9.6.1.1: 7400 + 250 · domain + …).
_MAX_DOMAIN = 232


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name over ROS 2; nothing is opened by asking."""
    try:
        _domain(name.options)
        _check_installed()
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_ros2_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph and return the link to the robot of this namespace.

    Args:
        options: `domain`: DDS domain id; left out, what ROS_DOMAIN_ID says.
        clock: the run's; where it is not this machine's, the node lives by the time on `/clock`.
        namespace: the robot's, such as `/alice`.

    Raises:
        LinkError: an option cannot have its value, no ROS 2 is sourced, or the graph cannot be joined.
    """
    domain = _domain(options)
    _check_installed()
    from robot_runner.links.ros2.link import Ros2RobotLink  # noqa: PLC0415  # it loads rclpy

    return Ros2RobotLink(domain, clock, namespace=namespace)


def _domain(options: Mapping[str, str]) -> int | None:
    for name in options:
        if name not in _OPTIONS:
            raise LinkError(f"ros2 has no option {name!r}", where="robot", fix=did_you_mean(name, _OPTIONS))
    named = "domain" in options
    text = options["domain"] if named else os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= _MAX_DOMAIN):
        raise LinkError(
            f"the domain id is {text!r}",
            where="robot" if named else "ROS_DOMAIN_ID",
            fix=f"Give a whole number from 0 to {_MAX_DOMAIN}, the ROS_DOMAIN_ID of the robot.",
        )
    return int(text) if named else None


def _check_installed() -> None:
    ros = find_ros()
    if ros is not None and ros.version == 1:
        raise LinkError(
            f"robot is reached over ROS 2, but ROS 1 {ros.distro or ''} is sourced, whose messages hide those of ROS 2",
            where=ros.source,
            fix=f"Start anew in a shell where a ROS 2 is sourced, {_WITHOUT_ROS}.",
        )
    if importlib.util.find_spec("rclpy") is None:
        raise LinkError(
            "robot is reached over ROS 2, but rclpy cannot be imported",
            where="robot",
            fix=f"Source a ROS 2 whose Python is ours (source /opt/ros/humble/setup.bash), {_WITHOUT_ROS}.",
        )
