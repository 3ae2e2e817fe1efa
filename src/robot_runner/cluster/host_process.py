"""The process that executes runs (`run_host.py`) as its worker sees it, and what is told of a run."""

from __future__ import annotations

import json
import select
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robot_runner.cluster.piped_process import PipedProcess

#: How often the records of a run are sent while it is executed, s, and how many of them at a time.
_SENDING, _MOST_RECORDS = 0.5, 200


class HostProcess(PipedProcess):
    """A process that executes runs; a run that it executes is stopped once it is let go, and ends when it is killed.

    Attributes:
        folder: its own, in that of the worker's session.
        is_alive: whether it has not ended, as far as is known.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        super().__init__("robot_runner.cluster.run_host", str(folder))
        self.folder = folder
        self._refused: list[str] = []
        self.is_alive = True

    def unfitness(self) -> str | None:
        """Return why it executes no runs; empty where it is ready to, and None where it has not said anything yet."""
        replies, is_open = self.replies()
        for kind, fields in replies:
            if kind == "ready":
                return ""
            self._refused = fields["problems"]
        return None if is_open else self._ended()

    def _ended(self) -> str:
        """Return why the process has ended, which nobody asked for."""
        self.is_alive = False
        code = self.wait()
        self.close()
        return "; ".join(self._refused) or f"the process that executes runs ended with code {code}"

    def followed(self, outgoing: Outgoing) -> dict[str, Any]:
        """Pass on what the process tells of a run, and return what it tells of its end."""
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
    """What is told of one attempt: records as they come, some at a time, and the end.

    They are numbered, so that the other side can tell that none is missing.
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
        # As text: Dask's own encoding does not know each integer of a record, nor each character of a file's name.
        told = json.dumps([self._records, ended])
        self._tell({**self._of, "first": self._sent, "told": told})
        self._sent += len(self._records)
        self._records = []
        self._due = time.monotonic() + _SENDING
