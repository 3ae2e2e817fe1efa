"""Writes CBOR as a rosbridge server does, for the server that tests speak to.

Source: RFC 8949, and RFC 8746 for the tags of typed arrays.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.links.shapes import BYTE_KINDS, Field, Shape

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["TypedArray", "as_cbor", "with_typed_arrays"]

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
_LARGEST_INLINE = 23
_SIZES = ((24, "!B", 2**8), (25, "!H", 2**16), (26, "!I", 2**32), (27, "!Q", 2**64))


class TypedArray:
    """Numbers of one kind.

    Example:
        >>> as_cbor(TypedArray("int8", [1, -1])).hex()
        'd8484201ff'
    """

    def __init__(self, kind: str, numbers: Sequence[Any]) -> None:
        self.tag, layout = _TYPED[kind]
        self.data = struct.pack(f"<{len(numbers)}{layout}", *numbers)


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
    return TypedArray(field.kind, ours) if field.kind in _TYPED else value


def as_cbor(value: object) -> bytes:  # noqa: PLR0911 - one line a kind
    """Return a value as CBOR.

    Example:
        >>> as_cbor({"a": [True, None, 1.5, -1, b"x", "y"]}).hex()
        'a1616186f5f6fb3ff80000000000002041786179'
    """
    match value:
        case None:
            return b"\xf6"
        case bool():
            return b"\xf5" if value else b"\xf4"
        case int():
            return _head(0, value) if value >= 0 else _head(1, -1 - value)
        case float():
            return b"\xfb" + struct.pack("!d", value)
        case bytes():
            return _head(2, len(value)) + value
        case str():
            return _head(3, len(value.encode())) + value.encode()
        case TypedArray():
            return _head(6, value.tag) + as_cbor(value.data)
        case Mapping():
            return _head(5, len(value)) + b"".join(as_cbor(part) for item in value.items() for part in item)
        case list() | tuple():
            return _head(4, len(value)) + b"".join(map(as_cbor, value))
    raise TypeError(f"{value!r} has no CBOR")


def _head(major: int, number: int) -> bytes:
    if number <= _LARGEST_INLINE:
        return bytes([major << 5 | number])
    low, layout = next((low, layout) for low, layout, limit in _SIZES if number < limit)
    return bytes([major << 5 | low]) + struct.pack(layout, number)
