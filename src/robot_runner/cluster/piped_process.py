"""Child processes that execute modules of ours, such as the one that executes runs for a worker (`run_host.py`).

Requests and replies are records, each over a pipe of its own; the gateway replies from its event loop.
"""

from __future__ import annotations

import asyncio
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from robot_runner.core.execution.run_records import RecordReader, RecordWriter


class PipedProcess:
    """A fresh interpreter that executes a module of ours, and ends when its pipe of requests is closed.

    The first arguments of the `module` are the descriptors of requests and replies; `words` follow.

    Attributes:
        descriptor: readable when there are replies, or the process has ended.
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
        """Send a request; that the process is gone shows in the end of its replies."""
        with suppress(OSError):
            self._writer(kind, dict(fields))

    def replies(self) -> tuple[list[tuple[str, dict[str, Any]]], bool]:
        """Return the replies that have arrived, and whether there may be more."""
        return self._reader.read()

    def let_go(self) -> None:
        """Have it end: there will be no more requests."""
        with suppress(OSError):
            self._writer.close()

    def wait(self, seconds: float | None = None) -> int:
        """Wait for its end, kill it after that many seconds, and return its exit code."""
        try:
            return self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def close(self) -> None:
        """Close the pipe of replies, once the process has ended."""
        os.close(self.descriptor)


#: How often the records of a run are sent while it is executed, s, and how many of them at a time.
_SENDING, _MOST_RECORDS = 0.5, 200


class HostProcess(PipedProcess):
    """A process that executes runs; its run is stopped after `let_go`, and ends with the process if that is killed.

    Attributes:
        folder: its own, within that of the worker's session.
        is_alive: whether it runs, as far as is known.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        super().__init__("robot_runner.cluster.run_host", str(folder))
        self.folder = folder
        self._refused: list[str] = []
        self.is_alive = True

    def unfitness(self) -> str | None:
        """Return why it executes no runs; empty where it is ready, None where that is not known yet."""
        replies, is_open = self.replies()
        for kind, fields in replies:
            if kind == "ready":
                return ""
            self._refused = fields["problems"]
        return None if is_open else self._ended()

    def _ended(self) -> str:
        """Return why the process has ended unexpectedly."""
        self.is_alive = False
        code = self.wait()
        self.close()
        return "; ".join(self._refused) or f"the process that executes runs ended with code {code}"

    def followed(self, outgoing: Outgoing) -> dict[str, Any]:
        """Pass on what the process reports about a run, and return what it reports about the end."""
        poll = select.poll()
        poll.register(self.descriptor, select.POLLIN)
        while True:
            poll.poll(_SENDING * 1000)
            replies, is_open = self.replies()
            for kind, fields in replies:
                if kind == "records":
                    outgoing.add(fields["records"])
                elif kind == "ended":
                    return fields
                elif kind == "refused":
                    self._refused = fields["problems"]
            if not is_open:
                because = self._ended()
                return {"lost": because} | ({"is_certain": True, "is_unfit": True} if self._refused else {})
            outgoing.send_if_due()


class Outgoing:
    """The messages about one attempt: its records, some at a time, and its end.

    They are numbered, so that the receiver notices if one is missing.
    """

    def __init__(self, session: str, token: str, tell: Any) -> None:
        self._of = {"session": session, "token": token}
        self._tell = tell
        self._records: list[list[Any]] = []
        self._sent = 0
        self._due = time.monotonic() + _SENDING

    def add(self, records: list[list[Any]]) -> None:
        """Take records."""
        self._records += records
        if len(self._records) >= _MOST_RECORDS:
            self._send()

    def send_if_due(self) -> None:
        """Send the records, unless some were sent a moment ago."""
        if self._records and time.monotonic() >= self._due:
            self._send()

    def end(self, ended: Mapping[str, Any]) -> None:
        """Send the rest, and how the attempt ended."""
        self._send(ended)

    def _send(self, ended: Mapping[str, Any] | None = None) -> None:
        # As text: Dask's own encoding fails for some integers of records, and some characters of file names.
        told = json.dumps([self._records, ended])
        self._tell({**self._of, "first": self._sent, "told": told})
        self._sent += len(self._records)
        self._records = []
        self._due = time.monotonic() + _SENDING


#: How long the last replies may take, s.
_FLUSHED = 5.0


class Replies:
    """The replies to the orchestrator; sending never blocks, as the orchestrator may be busy with a user's callback."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._pending = bytearray()
        self._is_sent = asyncio.Event()
        self._is_sent.set()

    def tell(self, kind: str, fields: dict[str, Any]) -> None:
        """Send a reply as soon as the pipe has room for it."""
        was_empty = not self._pending
        self._pending += json.dumps([kind, fields]).encode() + b"\n"
        if was_empty:
            self._write()

    async def flushed(self) -> None:
        """Wait until everything is sent, within limits."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._is_sent.wait(), _FLUSHED)

    def _write(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            sent = os.write(self._descriptor, self._pending)
        except BlockingIOError:
            sent = 0
        except OSError:  # nobody reads any more
            sent = len(self._pending)
        del self._pending[:sent]
        if self._pending:
            self._is_sent.clear()
            loop.add_writer(self._descriptor, self._write)
        else:
            self._is_sent.set()
            loop.remove_writer(self._descriptor)
