"""Checks what is sent against the ROS definition of its type, and completes it with ROS' defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robot_runner.errors import LinkError, did_you_mean

__all__ = ["DEFAULTS", "completed"]

#: The default value of each message and request type that can be sent, which is also its definition.
DEFAULTS: dict[str, dict[str, Any]] = {
    "geometry_msgs/Twist": {
        "linear": {"x": 0.0, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
    },
    "std_srvs/Trigger": {},
}


def completed(message_type: str, message: Mapping[str, Any], *, where: str) -> dict[str, Any]:
    """Return the message with every field of its type, those that were left out at ROS' default.

    Raises:
        LinkError: a field is not one of the type's, or its value is not of the field's kind or not finite.

    Example:
        >>> completed("geometry_msgs/Twist", {"linear": {"x": 1}}, where="cmd_vel")["linear"]
        {'x': 1.0, 'y': 0.0, 'z': 0.0}
    """
    return _fields(DEFAULTS[message_type], message, (), f"{where} ({message_type})")


def _fields(defaults: Mapping[str, Any], given: object, path: tuple[str, ...], where: str) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise LinkError(
            f"{'.'.join(path) or 'the message'} is {given!r}, which is not a mapping",
            where=where,
            fix=f"Give a mapping with the fields {', '.join(map(repr, defaults)) or 'of the type: none'}.",
        )
    for name in given:
        if name not in defaults:
            unknown = ".".join((*path, str(name)))
            fix = did_you_mean(str(name), defaults) or "Send an empty mapping; the type has no fields."
            raise LinkError(f"the message has no field {unknown!r}", where=where, fix=fix)
    return {name: _value(default, given.get(name, default), (*path, name), where) for name, default in defaults.items()}


def _value(default: object, given: object, path: tuple[str, ...], where: str) -> object:
    if isinstance(default, dict):
        return _fields(default, given, path, where)
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        raise LinkError(f"field {'.'.join(path)!r} is {given!r}", where=where, fix="Give a finite number.")
    return float(given)
