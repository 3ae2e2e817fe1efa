"""Goals of actions: their states, their results, and the exceptions by which an execution ends otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class GoalStatus(StrEnum):
    """The states of a goal, by the names of ROS 2's `action_msgs/GoalStatus`; those of ROS 1 are mapped to them.

    Example:
        >>> GoalStatus.CANCELING.is_over, GoalStatus.ABORTED.is_over
        (False, True)
    """

    #: The server has not said anything of it yet.
    UNKNOWN = "unknown"
    #: Taken, and not begun.
    ACCEPTED = "accepted"
    EXECUTING = "executing"
    #: It was asked to end, and has not ended yet.
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    #: It ended because it was asked to.
    CANCELED = "canceled"
    #: The server gave it up.
    ABORTED = "aborted"
    #: The server did not take it.
    REJECTED = "rejected"

    @property
    def is_over(self) -> bool:
        """Whether nothing comes after it."""
        return self in {GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED, GoalStatus.REJECTED}


@dataclass(frozen=True, slots=True)
class ActionResult:
    """The result of a goal.

    Attributes:
        result: the message of the action's result; without success, as far as the server filled it in.
        text: of an actionlib server of ROS 1; empty elsewhere.

    Example:
        >>> ActionResult(GoalStatus.SUCCEEDED, {"sequence": [0, 1, 1]}).has_succeeded
        True
    """

    status: GoalStatus
    result: Mapping[str, Any]
    text: str = ""

    @property
    def has_succeeded(self) -> bool:
        """Whether the goal was reached."""
        return self.status is GoalStatus.SUCCEEDED


@dataclass(eq=False)
class _Ending(Exception):  # noqa: N818 - how an execution ends is nobody's error
    """An execution of a goal that ends without success."""

    text: str = ""
    result: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.text


class ActionAborted(_Ending):
    """Raised by the execution of a goal that it gives up.

    Args:
        text: why; an actionlib client of ROS 1 is told.
        result: fields of the result that the client gets nevertheless.

    Example:
        >>> str(ActionAborted("no path", {"error_code": 208}))
        'no path'
    """


class ActionCanceled(_Ending):
    """Raised by the execution of a goal that ends because it was asked to; arguments as of `ActionAborted`."""
