"""Turns what comes over the WebSocket into operations of the protocol: JSON or CBOR, whole or in fragments.

Source: rosbridge v2.0 protocol specification, 3.1.
"""

from __future__ import annotations

import json
from typing import Any

from robot_runner.links.rosbridge import cbor

__all__ = ["FrameReader", "as_json"]

_MOST_FRAGMENTS = 100_000
_MOST_UNFINISHED = 100


def as_json(operation: dict[str, Any]) -> str:
    """Return an operation as it is sent. Numbers that are none are sent as Python writes them, which servers read."""
    return json.dumps(operation, separators=(",", ":"), ensure_ascii=False)


class FrameReader:
    r"""Reads frames, and keeps the fragments of operations that are not whole yet.

    Example:
        >>> reader = FrameReader()
        >>> reader.read('{"op": "fragment", "id": "a", "num": 1, "total": 2, "data": "status\\"}"}')
        >>> reader.read('{"op": "fragment", "id": "a", "num": 0, "total": 2, "data": "{\\"op\\": \\""}')
        {'op': 'status'}
    """

    def __init__(self) -> None:
        self._parts: dict[str, dict[int, str]] = {}

    def read(self, frame: str | bytes) -> dict[str, Any] | None:
        """Return the operation that the frame is, or completes; None if more fragments are to come.

        Raises:
            ValueError: it is no operation of the protocol.
        """
        operation = cbor.read(frame) if isinstance(frame, bytes) else json.loads(frame)
        if not isinstance(operation, dict) or not isinstance(operation.get("op"), str):
            raise ValueError(f"{str(frame)[:80]!r} has no field 'op'")  # noqa: TRY004 - data, not an argument
        return self._whole(operation) if operation["op"] == "fragment" else operation

    def _whole(self, fragment: dict[str, Any]) -> dict[str, Any] | None:
        number, total = fragment.get("num"), fragment.get("total")
        text, name = fragment.get("data"), str(fragment.get("id"))
        if not isinstance(number, int) or not isinstance(total, int) or not isinstance(text, str):
            raise ValueError("a fragment lacks 'num', 'total' or 'data'")  # noqa: TRY004 - data, not an argument
        if not 0 <= number < total <= _MOST_FRAGMENTS:
            raise ValueError(f"fragment {number} of {total}")
        parts = self._parts.setdefault(name, {})
        parts[number] = text
        if len(parts) < total:
            while len(self._parts) > _MOST_UNFINISHED:  # of a server that drops some, the oldest will not be completed
                del self._parts[next(iter(self._parts))]
            return None
        del self._parts[name]
        return self.read("".join(parts[index] for index in range(total)))
