"""Cancelling all goals of an action server, for a process that has sent none of them."""

from __future__ import annotations

import time

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Message, RobotLink

#: action_msgs/srv/CancelGoal: the server refuses to cancel.
_REFUSED = 1
_NOW = {"sec": 0, "nanosec": 0}
#: actionlib_msgs/GoalStatus: pending and active, without a cancel request.
_EXECUTED = {0, 1}
#: The timeout for a server's states after a cancel request, s: it publishes them five times a second.
_TOLD_SECONDS = 1.0
#: The timeout for a server's answer, s.
_ANSWER_SECONDS = 5.0
#: A goal that was sent just before its client was killed may reach the server after the cancel request. So the request
#: is repeated: the period, and for how long, s.
_ASK_AGAIN, _LATE_SECONDS = 0.2, 2.0


def cancel_all_goals(link: RobotLink, action: str, *, timeout: float = _ANSWER_SECONDS) -> None:
    """Request the cancelling of all goals of an action server, also those of others; do nothing without a server.

    The request has no time stamp, up to which actionlib would cancel later goals as well: where clocks differ, or the
    graph's time is simulated, it would go on cancelling the goals of others.

    Args:
        link: to a robot whose graph is known: a server that it lacks has ended, and is not waited for.
        action: its full name.
        timeout: of the server's answer, s.

    Raises:
        LinkError: the server refuses, or does not answer.
    """
    _request(link, action, timeout, min(_TOLD_SECONDS, timeout))


def keep_cancelling_goals(link: RobotLink, action: str) -> None:
    """Do the same for some seconds, as goals of a dead process may still be on their way; await the server, too.

    Raises:
        LinkError: as `cancel_all_goals`.
    """
    begun = time.monotonic()
    while _request(link, action, _ANSWER_SECONDS, _ANSWER_SECONDS) and time.monotonic() < begun + _LATE_SECONDS:
        time.sleep(_ASK_AGAIN)


def _request(link: RobotLink, action: str, timeout: float, patience: float) -> bool:
    """Request the cancelling of all goals of a server, and return whether it is there.

    In both generations, an empty goal id with a stamp of zero means all goals (action_msgs/srv/CancelGoal, and
    actionlib's "cancel policy": http://wiki.ros.org/actionlib/DetailedDescription).
    """
    if link.encoding is Encoding.ROS1:
        return _request_in_ros1(link, action, timeout)
    service, message_type = f"{action}/_action/cancel_goal", "action_msgs/CancelGoal"
    try:
        answer = link.call(service, message_type, {}, timeout=patience)
    except LinkError:
        if action not in link.actions():
            return False
        if patience >= timeout:
            raise
        answer = link.call(service, message_type, {}, timeout=timeout)
    if answer["return_code"] == _REFUSED:
        fix = "Look at the log of its server, and stop the robot by hand."
        raise LinkError("the action server refuses to cancel its goals", where=action, fix=fix)
    return True


def _request_in_ros1(link: RobotLink, action: str, timeout: float) -> bool:
    """Repeat the request until the server's states show no active goal, as ROS 1 does not answer such a request."""
    deadline = time.monotonic() + timeout
    while True:
        link.publish(f"{action}/cancel", "actionlib_msgs/GoalID", {"stamp": _NOW, "id": ""})
        try:
            link.wait_for(
                f"{action}/status", "actionlib_msgs/GoalStatusArray", _is_none_executed, timeout=_TOLD_SECONDS
            )
        except LinkError as error:
            if action not in link.actions():
                return False
            if time.monotonic() >= deadline:
                problem = f"the action server does not tell within {timeout:g} s that it cancels its goals"
                fix = "Look at the log of its server, and stop the robot by hand."
                raise LinkError(problem, where=action, fix=fix) from error
        else:
            return True


def _is_none_executed(states: Message) -> bool:
    return not any(each["status"] in _EXECUTED for each in states["status_list"])
