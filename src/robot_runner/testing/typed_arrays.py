"""Writes the arrays of numbers of a message as a rosbridge server does in CBOR, for the server that tests speak to.

Source: RFC 8746.
"""

from __future__ import annotations

import struct
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.links.shapes import BYTE_KINDS, Field, Shape

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cbor2 import CBORTag

__all__ = ["typed_array", "with_typed_arrays"]

#: Tag and layout of an array of numbers, by the kind of its elements.
_TYPED = MappingProxyType(
    {
        "uint16": (69, "H"),
        "uint32": (70, "I"),
        "uint64": (71, "Q"),
        "int8": (72, "b"),
        "int16": (77, "h"),
        "int32": (78, "i"),
        "int64": (79, "q"),
        "float32": (85, "f"),
        "float64": (86, "d"),
    }
)


def typed_array(kind: str, numbers: Sequence[Any]) -> CBORTag:
    """Return numbers of one kind as a typed array, little endian.

    Example:
        >>> from cbor2 import dumps
        >>> dumps(typed_array("int8", [1, -1])).hex()
        'd8484201ff'
    """
    from cbor2 import CBORTag  # noqa: PLC0415  # an extra

    tag, layout = _TYPED[kind]
    return CBORTag(tag, struct.pack(f"<{len(numbers)}{layout}", *numbers))


def with_typed_arrays(shape: Shape, values: Mapping[str, Any], message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a message of the protocol with its arrays of numbers and bytes as CBOR has them.

    Args:
        shape: of its type.
        values: the message as the protocol has it in JSON.
        message: the same message as ours.
    """
    return {field.name: _value(field, values[field.name], message[field.name]) for field in shape.fields}


def _value(field: Field, value: Any, ours: Any) -> Any:
    if isinstance(field.kind, Shape):
        if field.count is None:
            return with_typed_arrays(field.kind, value, ours)
        return [with_typed_arrays(field.kind, *pair) for pair in zip(value, ours, strict=True)]
    if field.count is None:
        return value
    if field.kind in BYTE_KINDS:
        return ours
    return typed_array(field.kind, ours) if field.kind in _TYPED else value
