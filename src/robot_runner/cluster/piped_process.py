"""A program of ours in a process beside this one: requests and replies are records, each over a pipe of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from robot_runner.core.execution.run_records import RecordReader, RecordWriter


class PipedProcess:
    """A fresh interpreter that executes a module of ours; it notices the end of its requests, and ends.

    Attributes:
        descriptor: readable when there are replies, or the process has ended.

    Args:
        module: what it executes, with the descriptors of requests and replies as its first words.
        words: what follows them.
    """

    def __init__(self, module: str, *words: str) -> None:
        requests, request = os.pipe()
        self.descriptor, replies = os.pipe()
        self._process = subprocess.Popen(  # noqa: S603 - this interpreter, and our own program
            [sys.executable, "-P", "-m", module, str(requests), str(replies), *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[requests, replies],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        os.close(requests)
        os.close(replies)
        self._writer = RecordWriter(request, waits=True)
        self._reader = RecordReader(self.descriptor)

    def ask(self, kind: str, fields: Mapping[str, Any]) -> None:
        """Send a request; where the process is gone, the end of its replies tells."""
        with suppress(OSError):
            self._writer(kind, dict(fields))

    def replies(self) -> tuple[list[tuple[str, dict[str, Any]]], bool]:
        """Return the replies that have come, and whether there may be more."""
        return self._reader.read()

    def let_go(self) -> None:
        """Have it end: there will be no more requests."""
        with suppress(OSError):
            self._writer.close()

    def wait(self, seconds: float | None = None) -> int:
        """Wait for its end, kill it where that takes longer, and return its exit code."""
        try:
            return self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def close(self) -> None:
        """Leave its replies; it has ended."""
        os.close(self.descriptor)
