"""Opens a link over each transport, and checks whether it can be opened; no client library is imported before.

Each check raises a `LinkError` for what prevents the link, and returns further findings; nothing is opened. What opens
one raises a `LinkError` where an option or address is not valid, a package is missing, or the graph cannot be reached.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping
from functools import partial
from ipaddress import ip_address

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.words import enumerated
from robot_runner.ros.graph_addresses import DdsSettings, RosbridgeAddress, check_options, domain_id
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_transport import is_simulated_time, receive_clock
from robot_runner.ros.ros1_master import Master
from robot_runner.ros.ros_environment import RosEnvironment, find_ros, other_python_of_rclpy

#: How long a check waits for the master of ROS 1, s.
_CHECKING_SECONDS = 2.0
_WITHOUT_ROS = "or reach the robot without a ROS: robot = 'dds'"
_HUMBLE = "humble"
#: The packages that a link needs, and how its errors name it, by the extra that installs them.
_EXTRAS = {
    "dds": ("over DDS", ("cyclonedds", "rosbags")),
    "rosbridge": ("through a rosbridge", ("cbor2", "rosbags", "websockets")),
}


def check_ros1(name: RobotName) -> list[Finding]:
    """Check that a link over rospy can be opened: rospy is installed, and the master answers."""
    from robot_runner.ros.ros1_node import rospy_missing  # noqa: PLC0415  # only where it is asked for

    if importlib.util.find_spec("rospy") is None:
        raise rospy_missing("rospy")
    master_of(name.options, timeout=_CHECKING_SECONDS).check()
    return []


def open_ros1_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph of a `master`, or of ROS_MASTER_URI, and return the link to the robot of this namespace."""
    from robot_runner.ros.ros1_transport import Ros1Transport  # noqa: PLC0415  # only where it is asked for

    return GraphLink(partial(Ros1Transport, master_of(options), receive_clock(clock)), namespace)


def master_of(options: Mapping[str, str], *, timeout: float = 3.0) -> Master:
    """Return the master that the options name; raise a `LinkError` if one is unknown, or is not an address."""
    check_options("ros1", options, ("master",))
    return Master(options.get("master"), timeout=timeout)


def check_ros2(name: RobotName) -> list[Finding]:
    """Check that a link over rclpy can be opened: a ROS 2 is sourced, and for this Python."""
    _domain(name.options)
    _check_rclpy()
    return []


def open_ros2_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph of a `domain`, or of ROS_DOMAIN_ID, and return the link to the robot of this namespace.

    Where the run's clock is a simulation's, the node follows the time on `/clock`.
    """
    domain = _domain(options)
    _check_rclpy()
    from robot_runner.ros.ros2_transport import Ros2Transport  # noqa: PLC0415  # rclpy, which comes with a sourced ROS 2

    is_simulated = is_simulated_time(clock)
    connect = partial(Ros2Transport, domain, receive_clock(clock), use_sim_time=is_simulated)
    return GraphLink(connect, namespace, is_simulated=is_simulated)


def _domain(options: Mapping[str, str]) -> int | None:
    check_options("ros2", options, ("domain",))
    domain = domain_id(options, os.environ)
    return domain if "domain" in options else None  # rclpy reads ROS_DOMAIN_ID itself


def _check_rclpy() -> None:
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
        fix = f"Source a ROS 2 whose Python is ours (source /opt/ros/jazzy/setup.bash), {_WITHOUT_ROS}."
        raise LinkError("robot is reached over ROS 2, but rclpy cannot be imported", where="robot", fix=fix)


def _unfitting(ros: RosEnvironment | None, other: str) -> LinkError:
    """Return the error that the sourced ROS 2 is for another Python; it names the link that needs no rclpy."""
    distro = "" if ros is None or ros.distro is None else f" {ros.distro}"
    told = {"domain": os.environ.get("ROS_DOMAIN_ID"), "distro": distro.strip()}
    name = ":".join(filter(None, ["dds", ",".join(f"{option}={value}" for option, value in told.items() if value)]))
    ours = ".".join(map(str, sys.version_info[:2]))
    return LinkError(
        f"the ROS 2{distro} that is sourced is for Python {other}, and this is {ours}",
        where="robot",
        fix=f"Reach the robot without a ROS on this machine: --set robot={name}. Its services need one line on the "
        "robot, or a rosbridge: docs/your-humble-robot.md.",
    )


def check_dds(name: RobotName) -> list[Finding]:
    """Check that a link over DDS can be opened: the packages are installed, and the types are valid."""
    _check_installed("dds")
    settings = DdsSettings.of(name.options, os.environ)
    from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

    TypeCatalogue.of(2, settings.distro, settings.types)
    return []


def open_dds_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph that the options name, as `DdsSettings` reads them, and return the link to the robot there."""
    settings = DdsSettings.of(options, os.environ)
    _check_installed("dds")
    from robot_runner.ros.dds_transport import DdsTransport  # noqa: PLC0415  # cyclonedds, an extra

    return GraphLink(partial(DdsTransport, settings, receive_clock(clock)), namespace)


def check_rosbridge(name: RobotName) -> list[Finding]:
    """Check that a link through a rosbridge can be opened, and warn where others can read and command."""
    _check_installed("rosbridge")
    address = RosbridgeAddress.parse(name.address or name.link)
    from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

    TypeCatalogue.of(address.generation or 2, None, address.types)
    address.security.check()
    return [] if address.security.is_tls or _is_this_machine(address.host) else [_readable_by_others(address)]


def open_rosbridge_link(url: str, clock: Clock, namespace: str = "") -> RobotLink:
    """Connect to a rosbridge, whose address `RosbridgeAddress` reads, and return the link to the robot there."""
    address = RosbridgeAddress.parse(url)
    _check_installed("rosbridge")
    from robot_runner.ros.rosbridge_transport import RosbridgeTransport  # noqa: PLC0415  # cbor2 and rosbags, extras

    return GraphLink(partial(RosbridgeTransport, address, receive_clock(clock)), namespace)


def _is_this_machine(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name; it is not looked up, as asking takes time and tells others
        return host == "localhost" or host.endswith(".localhost")


def _readable_by_others(address: RosbridgeAddress) -> Finding:
    if address.security.sends_secrets:
        problem = f"the password or token for {address.uri} would go over the network for everybody to read"
        return Finding.error("robot", problem, "Reach it by TLS: rosbridge+tls://….")
    problem = (
        f"{address.uri} is neither encrypted nor signed: anyone on the network can read its messages and move the robot"
    )
    fix = "Keep the robot in a network of its own, start its server with TLS (rosbridge+tls://…), or go through SSH: "
    fix += f"ssh -L {address.port}:localhost:{address.port}"
    return Finding.warning("robot", problem, f"{fix} {address.host}, then robot=rosbridge://localhost:{address.port}.")


def _check_installed(extra: str) -> None:
    way, packages = _EXTRAS[extra]
    if missing := [package for package in packages if importlib.util.find_spec(package) is None]:
        problem = f"robot is reached {way}, but {enumerated(missing)} cannot be imported"
        raise LinkError(problem, where="robot", fix=f"Install it: pip install 'robot-runner[{extra}]'.")
