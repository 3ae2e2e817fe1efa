"""Reads CBOR, in which a rosbridge sends what JSON cannot: bytes, arrays of numbers, and numbers that are none.

Source: RFC 8949, and RFC 8746 for the tags of typed arrays.
"""

from __future__ import annotations

import struct
from types import MappingProxyType
from typing import Any

__all__ = ["read"]

_NESTED_MOST = 64
#: How many bytes of argument follow the first byte, by its lower five bits.
_ARGUMENTS = MappingProxyType({24: "!B", 25: "!H", 26: "!I", 27: "!Q"})
_INDEFINITE = 31
_BREAK = object()
_SIMPLE = MappingProxyType({20: False, 21: True, 22: None, 23: None})
_FLOATS = MappingProxyType({25: "!e", 26: "!f", 27: "!d"})
#: The elements of a typed array by its tag; 4 more is little endian.
_TYPED = MappingProxyType(
    dict(zip(range(64, 72), ("!B", "!H", "!I", "!Q", "!B", "<H", "<I", "<Q"), strict=True))
    | dict(zip((72, 73, 74, 75, 77, 78, 79), ("!b", "!h", "!i", "!q", "<h", "<i", "<q"), strict=True))
    | dict(zip((80, 81, 82, 84, 85, 86), ("!e", "!f", "!d", "<e", "<f", "<d"), strict=True))
)
_OCTETS = frozenset({64, 68})


def read(data: bytes) -> Any:
    """Return what the bytes say; typed arrays are lists, those of octets `bytes`.

    Raises:
        ValueError: they are no CBOR.

    Example:
        >>> read(bytes.fromhex("a1616182f5fb3ff8000000000000"))
        {'a': [True, 1.5]}
    """
    reader = _Reader(data)
    try:
        value = reader.item(0)
    except (IndexError, struct.error, TypeError) as error:
        raise ValueError(f"{len(data)} bytes are no CBOR") from error
    if value is _BREAK or reader.at != len(data):
        raise ValueError(f"{len(data)} bytes are no CBOR")
    return value


class _Reader:
    """The place up to which bytes were read."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self.at = 0

    def item(self, depth: int) -> Any:
        if depth > _NESTED_MOST:
            raise ValueError(f"it is nested more than {_NESTED_MOST} deep")
        first = self._data[self.at]
        self.at += 1
        major, low = first >> 5, first & 31
        if major == 7:  # noqa: PLR2004 - the major types are numbered in the RFC, 3.1
            return self._other(low)
        count = self._argument(low)
        if major < 2:  # noqa: PLR2004
            return count if major == 0 else -1 - _counted(count)
        if major < 4:  # noqa: PLR2004
            return self._octets(count, depth) if major == 2 else self._text(count, depth)  # noqa: PLR2004
        if major == 4:  # noqa: PLR2004
            return list(self._items(count, depth))
        return self._map(count, depth) if major == 5 else self._tagged(_counted(count), depth)  # noqa: PLR2004

    def _argument(self, low: int) -> int | None:
        if low < min(_ARGUMENTS):
            return low
        if low == _INDEFINITE:
            return None
        return int(self._unpack(_ARGUMENTS.get(low, "")))

    def _unpack(self, layout: str) -> Any:
        (value,) = struct.unpack_from(layout, self._data, self.at)
        self.at += struct.calcsize(layout)
        return value

    def _take(self, count: int) -> bytes:
        taken = bytes(self._data[self.at : self.at + count])
        if len(taken) < count:
            raise ValueError(f"it ends {count - len(taken)} bytes early")
        self.at += count
        return taken

    def _octets(self, count: int | None, depth: int) -> bytes:
        return self._take(count) if count is not None else b"".join(self._items(None, depth))

    def _text(self, count: int | None, depth: int) -> str:
        return self._take(count).decode() if count is not None else "".join(self._items(None, depth))

    def _items(self, count: int | None, depth: int) -> Any:
        while count is None or count > 0:
            value = self.item(depth + 1)
            if value is _BREAK:
                if count is not None:
                    raise ValueError("it breaks off")
                return
            yield value
            count = None if count is None else count - 1

    def _map(self, count: int | None, depth: int) -> dict[Any, Any]:
        flat = list(self._items(None if count is None else 2 * count, depth))
        return dict(zip(flat[::2], flat[1::2], strict=True))

    def _tagged(self, tag: int, depth: int) -> Any:
        value = self.item(depth + 1)
        if tag not in _TYPED or not isinstance(value, bytes):
            return value
        if tag in _OCTETS:
            return value
        return _numbers(_TYPED[tag], value)

    def _other(self, low: int) -> Any:
        if low in _FLOATS:
            return self._unpack(_FLOATS[low])
        if low == _INDEFINITE:
            return _BREAK
        if low in _SIMPLE:
            return _SIMPLE[low]
        raise ValueError(f"it holds the simple value {low}")


def _numbers(layout: str, data: bytes) -> list[Any]:
    count = len(data) // struct.calcsize(layout)
    return list(struct.unpack(f"{layout[0]}{count}{layout[1]}", data))


def _counted(count: int | None) -> int:
    if count is None:
        raise ValueError("a number without an end")
    return count
