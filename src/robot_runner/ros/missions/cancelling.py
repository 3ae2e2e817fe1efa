"""Cancelling all goals of an action from a process that has sent none of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding

if TYPE_CHECKING:
    from robot_runner.core.links.robot import RobotLink

#: action_msgs/srv/CancelGoal: the server does not cancel any of them.
_REFUSED = 1
_NOW = {"sec": 0, "nanosec": 0}


def cancel_all_goals(link: RobotLink, action: str, full_name: str, *, timeout: float) -> None:
    """Ask an action server to cancel whatever it executes, whoever sent it; without a server nothing is executed.

    Both generations have it so: an empty goal id with a stamp of zero means all goals (action_msgs/srv/CancelGoal, and
    actionlib's "cancel policy": http://wiki.ros.org/actionlib/DetailedDescription).

    Args:
        link: to the robot.
        action: the name of the action.
        full_name: the same with the robot's namespace.
        timeout: how long the server may take to answer, s.

    Raises:
        LinkError: the server refuses, or does not answer in time.
    """
    if link.encoding is Encoding.ROS1:
        link.publish(f"{action}/cancel", "actionlib_msgs/GoalID", {"stamp": _NOW, "id": ""})
        return
    try:
        answer = link.call(f"{action}/_action/cancel_goal", "action_msgs/CancelGoal", {}, timeout=timeout)
    except LinkError:
        if full_name in link.actions():
            raise
        return
    if answer["return_code"] == _REFUSED:
        fix = "Look at the log of its server, and stop the robot by hand."
        raise LinkError("the action server refuses to cancel its goals", where=full_name, fix=fix)
