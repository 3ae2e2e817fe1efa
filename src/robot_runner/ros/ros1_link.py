"""Opens a link over ROS 1, and checks whether it can be opened; nothing of ROS is imported before."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from functools import partial

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_addresses import check_options
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_transport import receive_clock
from robot_runner.ros.ros1_master import Master
from robot_runner.ros.ros1_node import rospy_missing
from robot_runner.ros.ros1_transport import Ros1Transport

_OPTIONS = ("master",)
#: How long a check waits for the master, s.
_CHECKING_SECONDS = 2.0


def findings(name: RobotName) -> list[Finding]:
    """Return findings that prevent a link to a robot of this name over ROS 1; nothing is opened."""
    if importlib.util.find_spec("rospy") is None:
        return [rospy_missing("rospy").as_finding()]
    try:
        master_of(name.options, timeout=_CHECKING_SECONDS).check()
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_ros1_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph of a `master`, or of ROS_MASTER_URI, and return the link to the robot of this namespace.

    Raises:
        LinkError: there is no such option, no master, or no rospy.
    """
    connect = partial(Ros1Transport, master_of(options), receive_clock(clock))
    return GraphLink(connect, namespace)


def follows_graph_clock(options: Mapping[str, str]) -> bool:
    """Whether the nodes of the graph follow the time on `/clock`: its parameter `/use_sim_time`.

    Raises:
        LinkError: there is no such option, or no master.
    """
    return bool(master_of(options).parameter("/use_sim_time"))


def master_of(options: Mapping[str, str], *, timeout: float = 3.0) -> Master:
    """Return the master that the options name.

    Raises:
        LinkError: there is no such option, or its value is not a valid address.
    """
    check_options("ros1", options, _OPTIONS)
    return Master(options.get("master"), timeout=timeout)
