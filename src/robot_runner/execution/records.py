"""What a run reports while it is executed, on its way to the orchestrator: one JSON record a line through a pipe."""

from __future__ import annotations

import json
import os
import threading
from typing import Any

__all__ = ["FINISHED", "RecordReader", "RecordWriter"]

#: The last record of a run that ended by itself.
FINISHED = "finished"

_encode = json.JSONEncoder(ensure_ascii=True, separators=(",", ":"), default=str).encode


class RecordWriter:
    """The run's end of the pipe. Plugins may report from threads of their own."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._lock = threading.Lock()

    def __call__(self, kind: str, fields: dict[str, Any]) -> None:
        """Send one record. An orchestrator that is gone is no reason for the run not to close what it opened."""
        data = memoryview(f"{_encode([kind, fields])}\n".encode())
        with self._lock:
            try:
                while data:
                    data = data[os.write(self._descriptor, data) :]
            except BrokenPipeError:
                return


class RecordReader:
    """The orchestrator's end of the pipe."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._pending = b""
        os.set_blocking(descriptor, False)

    def read(self) -> tuple[list[tuple[str, dict[str, Any]]], bool]:
        """Return the records that have arrived, and whether the pipe is still open; never waits."""
        is_open = True
        while True:
            try:
                data = os.read(self._descriptor, 65536)
            except BlockingIOError:
                break
            if not data:
                is_open = False
                break
            self._pending += data
            if len(data) < 65536:  # noqa: PLR2004 - the size asked for: there is no more for now
                break
        *lines, self._pending = self._pending.split(b"\n")
        return [record for line in lines if (record := _decoded(line))], is_open


def _decoded(line: bytes) -> tuple[str, dict[str, Any]] | None:
    try:
        kind, fields = json.loads(line.decode())
    except (ValueError, TypeError):  # somebody else wrote into the pipe
        return None
    return (kind, fields) if isinstance(kind, str) and isinstance(fields, dict) else None
