"""Fields of messages by their names with dots: `pose.pose.position.x`, `ranges.0`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Message


def field_of(message: Message, field: str, *, where: str) -> Any:
    """Return the field of a message, whatever it is.

    Args:
        message: a mapping by field.
        field: the way to it; a number names an element of an array, and a negative one counts from its end.
        where: for the error.

    Raises:
        LinkError: there is no such field.

    Example:
        >>> field_of({"poses": [{"x": 1.0}, {"x": 2.0}]}, "poses.-1.x", where="goal")
        2.0
    """
    found: Any = message
    for name in field.split("."):
        if isinstance(found, Mapping):
            if name not in found:
                fix = did_you_mean(name, map(str, found))
                raise LinkError(f"the message has no field {field!r}", where=where, fix=fix)
            found = found[name]
        else:
            found = _element(found, name, field, where)
    return found


def _element(found: Any, name: str, field: str, where: str) -> Any:
    if isinstance(found, Sequence) and re.fullmatch(r"-?\d{1,9}", name) and -len(found) <= int(name) < len(found):
        return found[int(name)]
    fix = "Name a field with its numbers, as in 'ranges.0'."
    raise LinkError(f"the message has no field {field!r}", where=where, fix=fix)


def is_time(value: object) -> bool:
    """Return whether a field is a time or a duration of ROS.

    Example:
        >>> is_time({"sec": 1, "nanosec": 500_000_000})
        True
    """
    return isinstance(value, Mapping) and value.keys() == {"sec", "nanosec"}
