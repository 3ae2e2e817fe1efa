"""Reads CBOR, in which a rosbridge sends what JSON cannot: bytes, arrays of numbers, and numbers that are none.

Source: RFC 8746 for the tags of typed arrays; all else is the library's.
"""

from __future__ import annotations

import struct
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cbor2 import CBORTag

__all__ = ["read"]

#: The elements of a typed array by its tag; 4 more is little endian. Those of octets (64, 68) stay bytes.
_TYPED = MappingProxyType(
    dict(zip((65, 66, 67, 69, 70, 71), (">H", ">I", ">Q", "<H", "<I", "<Q"), strict=True))
    | dict(zip((72, 73, 74, 75, 77, 78, 79), (">b", ">h", ">i", ">q", "<h", "<i", "<q"), strict=True))
    | dict(zip((80, 81, 82, 84, 85, 86), (">e", ">f", ">d", "<e", "<f", "<d"), strict=True))
)


def read(data: bytes) -> Any:
    """Return what the bytes say; typed arrays are lists, those of octets `bytes`.

    Raises:
        ValueError: they are no CBOR.

    Example:
        >>> read(bytes.fromhex("a16161d84d4401000200"))
        {'a': [1, 2]}
    """
    from cbor2 import CBORDecodeError, loads  # noqa: PLC0415  # an extra, only where it is asked for

    try:
        return loads(data, tag_hook=_untagged)
    except CBORDecodeError as error:
        raise ValueError(f"{len(data)} bytes are no CBOR: {error}") from error


def _untagged(tagged: CBORTag, _is_immutable: bool) -> Any:
    layout = _TYPED.get(tagged.tag)
    return tagged.value if layout is None else _numbers(layout, tagged.value)


def _numbers(layout: str, data: bytes) -> list[Any]:
    count = len(data) // struct.calcsize(layout)
    return list(struct.unpack(f"{layout[0]}{count}{layout[1]}", data))
