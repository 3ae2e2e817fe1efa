"""The links to robots on a ROS graph: where each is, loaded only when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.errors import Finding, LinkError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.links.robot_name import RobotName

__all__ = ["GRAPH_LINKS", "follows_graph_clock", "graph_findings", "open_graph_link"]

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
        "ros1": _GraphLink("ROS 1 with rospy", "robot_runner.links.ros1.opening", "open_ros1_link"),
        "ros2": _GraphLink("ROS 2 with rclpy", "robot_runner.links.ros2.opening", "open_ros2_link"),
        "dds": _GraphLink("ROS 2 over DDS, with no ROS installed", "robot_runner.links.dds.opening", "open_dds_link"),
        "rosbridge": _GraphLink(
            "ROS 1 or 2 through a rosbridge, with no ROS installed",
            "robot_runner.links.rosbridge.opening",
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
