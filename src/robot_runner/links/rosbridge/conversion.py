"""Turns messages between our mappings and those of the rosbridge protocol, which differ in times, bytes and floats."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Mapping
from typing import Any

from robot_runner.errors import LinkError
from robot_runner.links.shapes import BYTE_KINDS, Field, Shape

__all__ = ["from_protocol", "to_protocol"]

_STAMPS = frozenset({"time", "duration"})
_FLOATS = frozenset({"float32", "float64"})
#: The protocol has no spelling for them in JSON, and a server writes null for all three.
_NO_NUMBER = math.nan


def to_protocol(shape: Shape, message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a complete message as the protocol has it: bytes in base64, ROS 1 times as `secs` and `nsecs`."""
    return {field.name: _out(field, message[field.name]) for field in shape.fields}


def from_protocol(shape: Shape, message: object, *, where: str) -> dict[str, Any]:
    """Return a message of the protocol as ours.

    Raises:
        LinkError: it is no message of this type.
    """
    if not isinstance(message, Mapping):
        raise _other(shape, where, f"{message!r} is no mapping")
    try:
        return {field.name: _in(field, message[field.name], where) for field in shape.fields}
    except (KeyError, TypeError, ValueError, AttributeError, binascii.Error) as error:
        raise _other(shape, where, f"{type(error).__name__} {error}") from error


def _out(field: Field, value: Any) -> Any:
    if field.count is None:
        return _out_one(field.kind, value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    return value if field.kind in _FLOATS else [_out_one(field.kind, each) for each in value]


def _out_one(kind: str | Shape, value: Any) -> Any:
    if isinstance(kind, Shape):
        return to_protocol(kind, value)
    return {"secs": value["sec"], "nsecs": value["nanosec"]} if kind in _STAMPS else value


def _in(field: Field, value: Any, where: str) -> Any:
    if field.count is None:
        return _in_one(field.kind, value, where)
    if field.kind in BYTE_KINDS:
        return base64.b64decode(value) if isinstance(value, str) else bytes(value)
    return [_in_one(field.kind, each, where) for each in value]


def _in_one(kind: str | Shape, value: Any, where: str) -> Any:
    if isinstance(kind, Shape):
        return from_protocol(kind, value, where=where)
    if kind in _STAMPS:
        seconds = value["secs"] if "secs" in value else value["sec"]
        return {"sec": int(seconds), "nanosec": int(value["nsecs"] if "nsecs" in value else value["nanosec"])}
    if kind in _FLOATS:
        return _NO_NUMBER if value is None else float(value)
    return value


def _other(shape: Shape, where: str, why: str) -> LinkError:
    return LinkError(
        f"what came is no {shape.type_name}: {why}",
        where=where,
        fix="Name the robot's distribution, or give its definition: rosbridge://robot:9090?distro=…&types=….",
    )
