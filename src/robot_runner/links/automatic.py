"""Finds out how a robot can be reached from here, for `robot = "auto"`; the simulation is never among what is found."""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.links.ros1.master import Master
from robot_runner.links.ros_environment import find_ros

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["AUTO", "FoundRobot", "found_robot"]

AUTO = "auto"
_MASTER_SECONDS = 1.0
_BRIDGE = ("localhost", 9090)
_BRIDGE_SECONDS = 0.5
#: DDS needs about a second until the participants of a graph know each other.
_GRAPH_SECONDS = 8.0
#: In a process of its own: a participant of DDS starts threads, which the process that forks the runs may not have.
_LOOK_AT_GRAPH = """
import sys, time
from robot_runner.events.clock import SystemClock
from robot_runner.links.dds.opening import open_dds_link
link = open_dds_link({}, SystemClock())
deadline = time.monotonic() + 2.0
while not (found := set(link.topics()) - {"/rosout", "/parameter_events"}) and time.monotonic() < deadline:
    time.sleep(0.1)
link.close()
sys.exit(0 if found else 1)
"""


@dataclass(frozen=True, slots=True)
class FoundRobot:
    """How a robot can be reached from here.

    Attributes:
        name: what to write for `robot`.
        reason: why it was chosen.
    """

    name: str
    reason: str


@lru_cache(maxsize=1)
def found_robot() -> FoundRobot:
    """Return the first that is there, in this order: a sourced ROS, a ROS 1 master, a rosbridge on this machine, DDS.

    Raises:
        LinkError: there is none; it says what was looked for.
    """
    for look in _LOOKS:
        found = look()
        if found is not None:
            return found
    raise LinkError(
        "robot is 'auto', and no robot is found: no ROS is sourced, no ROS 1 master answers, nobody listens at "
        f"{_BRIDGE[0]}:{_BRIDGE[1]} (rosbridge), and nothing is published over DDS (or cyclonedds is not installed)",
        where="robot",
        fix="Say how it is reached, as in --set robot=rosbridge://robot:9090. Or: --set robot=simulated.",
    )


def _sourced() -> FoundRobot | None:
    ros = find_ros()
    if ros is None:
        return None
    name, package = ("ros1", "rospy") if ros.version == 1 else ("ros2", "rclpy")
    if not _is_installed(package):
        return None
    return FoundRobot(name, f"ROS {ros.version} is sourced ({ros.source}), and {package} is there")


def _master() -> FoundRobot | None:
    if not _is_installed("rospy"):
        return None
    try:
        master = Master(timeout=_MASTER_SECONDS)
        master.check()
    except LinkError:
        return None
    return FoundRobot("ros1", f"a ROS 1 master answers at {master.uri}")


def _bridge() -> FoundRobot | None:
    if not _is_installed("websockets"):
        return None
    try:
        socket.create_connection(_BRIDGE, timeout=_BRIDGE_SECONDS).close()
    except OSError:
        return None
    host, port = _BRIDGE
    return FoundRobot(f"rosbridge://{host}:{port}", f"somebody listens at {host}:{port}, where a rosbridge is")


def _dds() -> FoundRobot | None:
    if not (_is_installed("cyclonedds") and _is_installed("rosbags")):
        return None
    try:
        looked = subprocess.run(  # noqa: S603 - our own program, in our own Python
            [sys.executable, "-c", _LOOK_AT_GRAPH],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_GRAPH_SECONDS,
            check=False,
        )
    except (subprocess.TimeoutExpired, OSError):  # an OSError: Python may not be started here
        return None
    if looked.returncode != 0:
        return None
    return FoundRobot("dds", f"topics are published over DDS in domain {os.environ.get('ROS_DOMAIN_ID', '0')}")


_LOOKS: tuple[Callable[[], FoundRobot | None], ...] = (_sourced, _master, _bridge, _dds)


def _is_installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None
