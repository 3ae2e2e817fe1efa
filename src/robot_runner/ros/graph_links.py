"""The links to robots on a ROS graph: where each is, loaded only when it is asked for."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import dataclass, replace
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, LinkError, nearest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import RobotLink, RobotName

__all__ = [
    "GRAPH_LINKS",
    "follows_graph_clock",
    "full_name",
    "graph_findings",
    "missing",
    "missing_of",
    "namespace_prefix",
    "not_installed",
    "open_graph_link",
]


# Names of topics and services on a ROS graph: relative to a robot's namespace unless they begin with a slash.

#: A name that ROS 1 and ROS 2 both take (ROS 1: wiki.ros.org/Names; ROS 2: design.ros2.org, topic and service names).
_LEGAL = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


def namespace_prefix(namespace: str) -> str:
    """Return what stands before a relative name: nothing, or `/alice`.

    Raises:
        LinkError: it cannot be the name of a namespace.

    Example:
        >>> namespace_prefix("alice"), namespace_prefix("/"), namespace_prefix("")
        ('/alice', '', '')
    """
    name = namespace.strip("/")
    if name and _LEGAL.fullmatch(name) is None:
        raise _illegal("namespace", namespace)
    return f"/{name}" if name else ""


def full_name(namespace: str, name: str) -> str:
    """Return the name on the graph of what a robot of this namespace calls `name`.

    Raises:
        LinkError: it cannot be a name.

    Example:
        >>> full_name("/alice", "odom"), full_name("/alice", "/map"), full_name("", "odom")
        ('/alice/odom', '/map', '/odom')
    """
    if _LEGAL.fullmatch(name) is None:
        raise _illegal("topic or service", name)
    return name if name.startswith("/") else f"{namespace_prefix(namespace)}/{name}"


def missing(kind: str, name: str, known: Iterable[str], *, where: str, fix: str) -> LinkError:
    """Return the error that there is no topic or service of this name; it names the nearest that there is.

    Args:
        kind: what is missing: `topic`, `service`.
        name: its full name.
        known: the full names that there are.
        where: the link.
        fix: what to do where none comes near.

    Example:
        >>> missing("service", "/task/stpo", ["/task/stop"], where="ros1", fix="Start its node.").fix
        "Did you mean '/task/stop'?"
    """
    near = nearest(name, known)
    return LinkError(f"there is no {kind} {name!r}", where=where, fix=f"Did you mean {near!r}?" if near else fix)


def _illegal(kind: str, name: str) -> LinkError:
    fix = "Use letters, digits and _ between slashes; none may begin with a digit."
    return LinkError(f"{name!r} cannot be the name of a {kind}", where="robot", fix=fix)


# Says which packages a link lacks, and the extra that brings them.


def missing_of(packages: Iterable[str]) -> list[str]:
    """Return those of the packages that cannot be imported; none is imported by asking.

    Example:
        >>> missing_of(["json", "no_such_package"])
        ['no_such_package']
    """
    return [package for package in packages if importlib.util.find_spec(package) is None]


def not_installed(missing: Sequence[str], *, way: str, extra: str) -> LinkError:
    """Return the error that a robot cannot be reached in this way for want of packages.

    Example:
        >>> print(not_installed(["cyclonedds"], way="over DDS", extra="dds").fix)
        Install it: pip install 'robot-runner[dds]'.
    """
    return LinkError(
        f"robot is reached {way}, but {' and '.join(missing)} cannot be imported",
        where="robot",
        fix=f"Install it: pip install 'robot-runner[{extra}]'.",
    )


_CLOCK = "clock"
_SYSTEM = "system"
_GRAPH = "graph"


@dataclass(frozen=True, slots=True)
class _GraphLink:
    """One way to a graph.

    Attributes:
        description: in one line.
        module: where it is opened, and asked what stands in its way (`findings`).
        opener: the function that opens it.
    """

    description: str
    module: str
    opener: str


GRAPH_LINKS: Mapping[str, _GraphLink] = MappingProxyType(
    {
        "ros1": _GraphLink("ROS 1 with rospy", "robot_runner.ros.ros1_link", "open_ros1_link"),
        "ros2": _GraphLink("ROS 2 with rclpy", "robot_runner.ros.ros2_link", "open_ros2_link"),
        "dds": _GraphLink("ROS 2 over DDS, with no ROS installed", "robot_runner.ros.dds_link", "open_dds_link"),
        "rosbridge": _GraphLink(
            "ROS 1 or 2 through a rosbridge, with no ROS installed",
            "robot_runner.ros.rosbridge_link",
            "open_rosbridge_link",
        ),
    }
)


def graph_findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name; nothing is opened by asking."""
    try:
        _clock_of(name)
        findings: list[Finding] = _module(name).findings(_without_clock(name))
    except LinkError as error:
        return [error.as_finding()]
    return findings


def open_graph_link(name: RobotName, clock: Clock, namespace: str = "") -> RobotLink:
    """Open a link to the robot of this namespace.

    Args:
        name: of the robot.
        clock: the run's.
        namespace: the robot's, such as `/alice`.

    Raises:
        LinkError: it cannot be reached.
    """
    bare = _without_clock(name)
    opener = getattr(_module(name), GRAPH_LINKS[name.link].opener)
    link: RobotLink = opener(bare.options if bare.address is None else bare.address, clock, namespace)
    return link


def follows_graph_clock(name: RobotName) -> bool:
    """Whether a run lives by the time on `/clock`: as its option `clock` says, else as the graph of ROS 1 does.

    Raises:
        LinkError: the option cannot have its value, or there is no master to ask.
    """
    chosen = _clock_of(name)
    if chosen is not None or name.link != "ros1":
        return chosen == _GRAPH
    follows: bool = _module(name).follows_graph_clock(name.options)
    return follows


def _module(name: RobotName) -> Any:
    if name.address is None and name.link == "rosbridge":
        fix = "Write it as in rosbridge://robot:9090."
        raise LinkError("a rosbridge has an address, and none is named", where="robot", fix=fix)
    return import_module(GRAPH_LINKS[name.link].module)


def _clock_of(name: RobotName) -> str | None:
    chosen = name.options.get(_CLOCK)
    if chosen not in {None, _SYSTEM, _GRAPH}:
        fix = f"Write {_CLOCK}={_SYSTEM} for this machine's, or {_CLOCK}={_GRAPH} for that on /clock."
        raise LinkError(f"the clock of a run is {chosen!r}", where="robot", fix=fix)
    return chosen


def _without_clock(name: RobotName) -> RobotName:
    return replace(name, options={option: value for option, value in name.options.items() if option != _CLOCK})
