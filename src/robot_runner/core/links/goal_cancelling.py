"""Cancelling all goals of an action server, for a process that has sent none of them."""

from __future__ import annotations

import time
from collections.abc import Collection

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Message, RobotLink

#: action_msgs/srv/CancelGoal: the server refuses to cancel.
_REFUSED = 1
_NOW = {"sec": 0, "nanosec": 0}
_FIX = "Look at the log of its server, and stop the robot by hand."
#: A goal that is not over, by actionlib_msgs/GoalStatus (pending, active, preempting, recalling) and by
#: action_msgs/GoalStatus (accepted, executing, canceling): many servers take a cancel request and do not look at it.
_GOES_ON, _GOES_ON_IN_ROS2 = {0, 1, 6, 7}, {1, 2, 3}
#: How often, s, a server of ROS 1 is asked again where its states, published five times a second, show such a goal.
_TOLD_SECONDS = 1.0
#: The timeout for a server's answer, s.
_ANSWER_SECONDS = 5.0
#: A goal that was sent just before its client was killed may reach the server after the cancel request. So the request
#: is repeated: the period, and for how long, s.
_ASK_AGAIN, _LATE_SECONDS = 0.2, 2.0


def cancel_all_goals(link: RobotLink, action: str, *, timeout: float = _ANSWER_SECONDS) -> None:
    """Request the cancelling of all goals of an action server, also those of others; do nothing without a server.

    The request has no time stamp, up to which actionlib would cancel later goals as well: where clocks differ, or the
    graph's time is simulated, it would go on cancelling the goals of others. The link's graph is known: a server that
    it lacks has ended, and is not waited for. `timeout` is for the server's answer, and then for the end of its goals,
    s.

    Raises:
        LinkError: the server refuses, does not answer, or goes on.
    """
    if _request(link, action, timeout, min(_TOLD_SECONDS, timeout)):
        _see_ended(link, action, timeout)


def keep_cancelling_goals(link: RobotLink, action: str) -> None:
    """Do the same for some seconds, as goals of a dead process may still be on their way; await the server, too.

    Raises:
        LinkError: as `cancel_all_goals`.
    """
    begun = time.monotonic()
    while is_there := _request(link, action, _ANSWER_SECONDS, _ANSWER_SECONDS):
        if time.monotonic() >= begun + _LATE_SECONDS:
            break
        time.sleep(_ASK_AGAIN)
    if is_there:
        _see_ended(link, action, _ANSWER_SECONDS)


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
        raise LinkError("the action server refuses to cancel its goals", where=action, fix=_FIX)
    return True


def _see_ended(link: RobotLink, action: str, timeout: float) -> None:
    """Raise a `LinkError` if a server of ROS 2 tells that a goal goes on.

    That of rclpy refuses every cancel request unless its author allows it, and answers that there was no error.
    """
    if link.encoding is Encoding.ROS1:  # such a server was asked until it told that none does
        return
    told: list[Message] = []

    def is_none_left(states: Message) -> bool:
        told.append(states)
        return _is_none_left(states, _GOES_ON_IN_ROS2)

    topic, message_type = f"{action}/_action/status", "action_msgs/GoalStatusArray"
    try:
        link.wait_for(topic, message_type, is_none_left, timeout=timeout)
    except LinkError as error:
        if told and action in link.actions():  # one that has had no goal tells nothing
            raise _going_on(action, timeout) from error


def _going_on(action: str, timeout: float) -> LinkError:
    problem = f"the action server's goals do not end within {timeout:g} s after it was asked to cancel them"
    return LinkError(problem, where=action, fix=_FIX)


def _request_in_ros1(link: RobotLink, action: str, timeout: float) -> bool:
    """Repeat the request until the server's states show no goal that goes on, as ROS 1 does not answer a request."""
    deadline = time.monotonic() + timeout
    while True:
        link.publish(f"{action}/cancel", "actionlib_msgs/GoalID", {"stamp": _NOW, "id": ""})
        try:
            link.wait_for(f"{action}/status", "actionlib_msgs/GoalStatusArray", _is_none_left, timeout=_TOLD_SECONDS)
        except LinkError as error:
            if action not in link.actions():
                return False
            if time.monotonic() >= deadline:
                raise _going_on(action, timeout) from error
        else:
            return True


def _is_none_left(states: Message, goes_on: Collection[int] = _GOES_ON) -> bool:
    return not any(each["status"] in goes_on for each in states["status_list"])
