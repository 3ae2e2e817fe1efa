"""Which ROS there is: on this machine, on a graph of ROS 1, on a robot's computer. Each says where it was read."""

from __future__ import annotations

import os
import re
import subprocess
from dataclasses import dataclass
from importlib import metadata
from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.links.ssh_command import complaint, execute, ssh_command

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.links.ros1.master import Master

__all__ = ["RosEnvironment", "find_ros", "installed_ros", "ros_of_host", "ros_of_master"]

#: The series of ros_comm, by its first two numbers, and the distribution that each was made for (index.ros.org).
#: 1.16 is noetic's; Debian and Ubuntu ship 1.15 and 1.16 of it without a name of their own.
_SERIES = MappingProxyType({"1.12": "kinetic", "1.14": "melodic", "1.15": "noetic", "1.16": "noetic"})
_ROS1_NAMES = ("kinetic", "lunar", "melodic", "noetic")
_VERSION = re.compile(r"\s*(\d+\.\d+)\.")
_HOST_SECONDS = 5.0


@dataclass(frozen=True, slots=True)
class RosEnvironment:
    """A ROS that was found.

    Attributes:
        version: the generation: 1 or 2.
        distro: the distribution, such as `noetic`, or None where it is not told.
        source: where this was read.
    """

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
    """Return the ROS of a graph of ROS 1, as its launch file's start has set it: `/rosdistro` and `/rosversion`.

    Raises:
        LinkError: there is no such master.
    """
    distro = str(master.parameter("/rosdistro") or "").strip()
    version = str(master.parameter("/rosversion") or "").strip()
    if distro.casefold() in _ROS1_NAMES:  # Debian's says "Debian"
        return RosEnvironment(1, distro.casefold(), f"/rosdistro of the master {master.uri}")
    if version:
        return RosEnvironment(1, _series(version), f"/rosversion {version} of the master {master.uri}")
    return RosEnvironment(1, None, f"the master {master.uri}, which was started without roslaunch")


def ros_of_host(host: str, *, config: Path | None = None) -> list[RosEnvironment]:
    """Return the distributions of ROS that are installed on a robot's computer, below /opt/ros.

    Args:
        host: as ssh takes it.
        config: a file to take the place of the user's ssh config.

    Raises:
        LinkError: it cannot be reached.
    """
    command = ssh_command(host, "for each in /opt/ros/*/setup.sh; do echo $each; done", config=config)
    try:
        done = execute(command, timeout=_HOST_SECONDS)
    except (subprocess.TimeoutExpired, OSError) as error:
        raise _unreached(host, f"it does not answer within {_HOST_SECONDS:g} s") from error
    problem = complaint(done)
    if problem is not None:
        raise _unreached(host, problem)
    names = (line.split("/")[3] for line in done.stdout.decode(errors="replace").split() if line.count("/") > 3)  # noqa: PLR2004 - /opt/ros/name/
    return [
        RosEnvironment(1 if name in _ROS1_NAMES else 2, name, f"/opt/ros of {host}") for name in names if name != "*"
    ]


def _unreached(host: str, why: str) -> LinkError:
    fix = f"See that this works without a password: ssh {host} true."
    return LinkError(f"which ROS is on {host} cannot be found out: {why}", where="required_ros_distro", fix=fix)


def _series(version: str) -> str | None:
    found = _VERSION.match(version + ".")
    return _SERIES.get(found[1]) if found else None
