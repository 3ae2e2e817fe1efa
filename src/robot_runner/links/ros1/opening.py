"""Opens a link over ROS 1, and says what stands in its way; nothing of ROS is loaded before."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from robot_runner.errors import Finding, LinkError, did_you_mean
from robot_runner.links.ros1.master import Master
from robot_runner.links.ros1.node import rospy_missing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.links.robot_name import RobotName

__all__ = ["findings", "follows_graph_clock", "master_of", "open_ros1_link"]

_OPTIONS = ("master",)
#: How long a check waits for the master, s.
_CHECKING_SECONDS = 2.0


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name over ROS 1; nothing is opened by asking."""
    if importlib.util.find_spec("rospy") is None:
        return [rospy_missing("rospy").as_finding()]
    try:
        master_of(name.options, timeout=_CHECKING_SECONDS).check()
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_ros1_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph and return the link to the robot of this namespace.

    Args:
        options: `master`: its address; left out, what ROS_MASTER_URI says.
        clock: the run's; rospy itself needs none.
        namespace: the robot's, such as `/alice`.

    Raises:
        LinkError: there is no such option, no master, or no rospy.
    """
    del clock
    from robot_runner.links.ros1.link import Ros1Link  # noqa: PLC0415  # it loads rospy

    return Ros1Link(master_of(options), namespace)


def follows_graph_clock(options: Mapping[str, str]) -> bool:
    """Whether the nodes of the graph live by the time on `/clock`: its parameter `/use_sim_time`.

    Raises:
        LinkError: there is no such option, or no master.
    """
    return bool(master_of(options).parameter("/use_sim_time"))


def master_of(options: Mapping[str, str], *, timeout: float = 3.0) -> Master:
    """Return the master that the options name.

    Raises:
        LinkError: there is no such option, or it cannot be the address of a master.
    """
    for name in options:
        if name not in _OPTIONS:
            raise LinkError(f"ros1 has no option {name!r}", where="robot", fix=did_you_mean(name, _OPTIONS))
    return Master(options.get("master"), timeout=timeout)
