"""Finds out how a robot can be reached from here, for `robot = "auto"`; it never finds the simulation."""

from __future__ import annotations

import importlib.util
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.kinds import FoundRobot
from robot_runner.core.links.ssh_command import execute, failure, gist, remedy, ssh_command

if TYPE_CHECKING:
    from robot_runner.ros.ros1_master import Master

# Which ROS is there: on this machine, on a graph of ROS 1, on a robot's computer.

#: The distribution of each series of ros_comm, by the first two numbers of its version (index.ros.org). 1.16 is
#: noetic's; Debian and Ubuntu ship 1.15 and 1.16 without the name of a distribution.
_SERIES = MappingProxyType({"1.12": "kinetic", "1.14": "melodic", "1.15": "noetic", "1.16": "noetic"})
_ROS1_NAMES = ("kinetic", "lunar", "melodic", "noetic")
_VERSION = re.compile(r"\s*(\d+\.\d+)\.")
_HOST_SECONDS = 5.0


@dataclass(frozen=True, slots=True)
class RosEnvironment:
    """A ROS that was found: generation, distribution (None where that is not known), and where this was read."""

    version: int
    distro: str | None
    source: str


def find_ros(environment: Mapping[str, str] | None = None) -> RosEnvironment | None:
    """Return the ROS that is sourced, or None. Every setup file of ROS sets ROS_VERSION and ROS_DISTRO."""
    variables = os.environ if environment is None else environment
    version = variables.get("ROS_VERSION", "")
    if version not in {"1", "2"}:
        return None
    return RosEnvironment(int(version), variables.get("ROS_DISTRO") or None, "ROS_VERSION and ROS_DISTRO")


#: The part of rclpy that is compiled, and so for one Python only.
_COMPILED = "_rclpy_pybind11.*"
_FOR_PYTHON = re.compile(r"\.cpython-3(\d+)")


def other_python_of_rclpy() -> str | None:
    """Return the Python version for which the rclpy on the path was built, such as `3.10`, if it is not this one.

    A setup file puts its rclpy on the path of every Python. It is not imported.
    """
    found = importlib.util.find_spec("rclpy")
    folders = [] if found is None else list(found.submodule_search_locations or ())
    compiled = [path.name for folder in folders for path in Path(folder).glob(_COMPILED)]
    if not compiled or any(name[name.index(".") :] in EXTENSION_SUFFIXES for name in compiled):
        return None
    told = _FOR_PYTHON.search(compiled[0])
    return f"3.{told[1]}" if told else "another version"


def installed_ros() -> RosEnvironment | None:
    """Return the ROS 1 whose rospy this Python imports, as Debian ships it without a setup file, or None.

    Its version tells the distribution: 1.15 and 1.16 are the noetic series.
    """
    try:
        version = metadata.version("rospy")
    except metadata.PackageNotFoundError:
        return None
    return RosEnvironment(1, _series(version), f"rospy {version}, which this Python imports")


def ros_of_master(master: Master) -> RosEnvironment:
    """Return the ROS of a graph of ROS 1, from the parameters that roslaunch sets: `/rosdistro` and `/rosversion`."""
    distro = str(master.parameter("/rosdistro") or "").strip()
    version = str(master.parameter("/rosversion") or "").strip()
    if distro.casefold() in _ROS1_NAMES:  # Debian's says "Debian"
        return RosEnvironment(1, distro.casefold(), f"/rosdistro of the master {master.uri}")
    if version:
        return RosEnvironment(1, _series(version), f"/rosversion {version} of the master {master.uri}")
    return RosEnvironment(1, None, f"the master {master.uri}, which was started without roslaunch")


def ros_of_host(host: str, *, config: Path | None = None) -> list[RosEnvironment]:
    """Return the distributions of ROS that are installed on a robot's computer, below /opt/ros.

    The host is given as for ssh, with a file in place of the user's ssh config.

    Raises:
        LinkError: it cannot be reached.
    """
    command = ssh_command(host, "for each in /opt/ros/*/setup.sh; do echo $each; done", config=config)
    try:
        done = execute(command, timeout=_HOST_SECONDS)
    except (subprocess.TimeoutExpired, OSError) as error:
        raise _unreached(host, f"the host does not answer within {_HOST_SECONDS:g} s") from error
    if (answer := failure(done)) is not None:
        raise _unreached(host, gist(answer), fix=remedy(host, answer))
    names = (line.split("/")[3] for line in done.stdout.decode(errors="replace").split() if line.count("/") > 3)  # noqa: PLR2004 - /opt/ros/name/
    return [
        RosEnvironment(1 if name in _ROS1_NAMES else 2, name, f"/opt/ros of {host}") for name in names if name != "*"
    ]


def _unreached(host: str, why: str, *, fix: str = "") -> LinkError:
    fix = f"{fix} See that this works without a password: ssh {host} true.".lstrip()
    return LinkError(f"which ROS is on {host} cannot be found out: {why}", where="required_ros_distro", fix=fix)


def _series(version: str) -> str | None:
    found = _VERSION.match(version + ".")
    return _SERIES.get(found[1]) if found else None


# Which ROS packages this machine has, from the folders that a setup file puts on its paths.

_PATHS = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH")
_ROS_PACKAGES_VERSION = re.compile(rb"<version[^>]*>\s*([^<\s]+)\s*</version>")


def describe_ros(environment: Mapping[str, str] | None = None) -> dict[str, Any] | None:
    """Return the ROS that is sourced: generation, distribution, middleware, packages by name; None where none is.

    Packages are those below `share/` of each prefix on AMENT_PREFIX_PATH (ROS 2) and CMAKE_PREFIX_PATH (ROS 1), with
    the version in their package.xml (REP 127, 140 and 149); an overlay hides what lies beneath it.
    """
    variables = os.environ if environment is None else environment
    ros = find_ros(variables)
    if ros is None:
        return None
    return {
        "version": ros.version,
        "distro": ros.distro,
        "middleware": variables.get("RMW_IMPLEMENTATION"),
        "packages": dict(sorted(_packages(variables).items())),
    }


def _packages(variables: Mapping[str, str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for prefix in (entry for name in _PATHS for entry in variables.get(name, "").split(os.pathsep) if entry):
        for path in Path(prefix).glob("share/*/package.xml"):
            found.setdefault(path.parent.name, _version(path))
    return found


def _version(path: Path) -> str:
    try:
        found = _ROS_PACKAGES_VERSION.search(path.read_bytes())
    except OSError:
        return ""
    return found[1].decode("utf-8", "replace") if found else ""


_MASTER_SECONDS = 1.0
_BRIDGE = ("localhost", 9090)
_BRIDGE_SECONDS = 0.5
#: The timeout for looking at the graph over DDS, s; discovery takes about one.
_GRAPH_SECONDS = 8.0
#: In a process of its own: a participant of DDS starts threads, which the process that forks the runs must not have.
_LOOK_AT_GRAPH = """
import sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link
link = open_dds_link({}, SystemClock())
deadline = time.monotonic() + 2.0
while not (found := set(link.topics()) - {"/rosout", "/parameter_events"}) and time.monotonic() < deadline:
    time.sleep(0.1)
link.close()
sys.exit(0 if found else 1)
"""


@lru_cache(maxsize=1)
def found_robot() -> FoundRobot:
    """Return the first robot found over, in this order: a sourced ROS, a ROS 1 master, a rosbridge here, DDS.

    Raises:
        LinkError: there is none; the message says what was looked for.
    """
    for look in _LOOKS:
        if (found := look()) is not None:
            return found
    raise LinkError(
        "robot is 'auto', and no robot is found: no ROS is sourced, no ROS 1 master answers, no server listens at "
        f"{_BRIDGE[0]}:{_BRIDGE[1]} (rosbridge), and nothing is published over DDS (or cyclonedds is not installed)",
        where="robot",
        fix="Say how it is reached, as in --set robot=rosbridge://robot:9090. Or: --set robot=simulated.",
    )


def _sourced() -> FoundRobot | None:
    ros = find_ros()
    if ros is None:
        return None
    name, package = ("ros1", "rospy") if ros.version == 1 else ("ros2", "rclpy")
    if not _is_installed(package) or (package == "rclpy" and other_python_of_rclpy()):
        return None
    return FoundRobot(name, f"ROS {ros.version} is sourced ({ros.source}), and {package} is there")


def _master() -> FoundRobot | None:
    if not _is_installed("rospy"):
        return None
    from robot_runner.ros.ros1_master import Master  # noqa: PLC0415 - loads HTTP and XML-RPC, which only a master needs

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
    return FoundRobot(f"rosbridge://{host}:{port}", f"a server listens at {host}:{port}, where a rosbridge is")


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
