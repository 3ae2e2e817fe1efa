"""A second process that outlives the orchestrator for as long as it takes to end the run that it left behind.

Whatever kills an orchestrator (SIGKILL, out of memory) must not leave a robot driving. The run cannot watch for that
itself in all states that it may be in: a callback that hangs in C runs no Python, so neither a signal handler nor a
thread of ours would come to its turn. The guardian is a process of its own, forked once an experiment.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from typing import Self

__all__ = ["Guardian", "register_with_guardian"]

_PID_BYTES = 8
_NO_RUN = 0
_LOOK = 0.02


class Guardian:
    """The orchestrator's end: a context manager that forks the guardian, and ends it when the orchestrator leaves.

    Attributes:
        line: the descriptor on which a run says its process id, and the orchestrator that it has ended.
    """

    def __init__(self, grace: float) -> None:
        """Take the time, in seconds, that an abandoned run has to close what it opened before it is killed."""
        self._grace = grace
        self.line = -1

    def __enter__(self) -> Self:
        reader, self.line = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            os.close(self.line)
            _guard(reader, self._grace)
        os.close(reader)
        return self

    def __exit__(self, *raised: object) -> None:
        os.close(self.line)
        os.waitpid(self._pid, 0)

    def run_has_ended(self) -> None:
        """Say that there is no run to guard. A guardian that was killed is replaced: the next run is guarded again."""
        try:
            os.write(self.line, _NO_RUN.to_bytes(_PID_BYTES, "big"))
        except BrokenPipeError:
            self.__exit__()
            self.__enter__()


def register_with_guardian(line: int) -> None:
    """Say, from the run's own process, whom to guard; the line is closed: it breaks when the orchestrator dies."""
    with suppress(BrokenPipeError):  # it was killed: the orchestrator replaces it once this run has ended
        os.write(line, os.getpid().to_bytes(_PID_BYTES, "big"))
    os.close(line)


def _guard(reader: int, grace: float) -> None:
    try:
        os.setsid()  # what happens to the orchestrator's terminal and group does not reach us
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
            signal.signal(number, signal.SIG_IGN)
        signal.set_wakeup_fd(-1)
        _close_all_but(reader)
        run = _NO_RUN
        while said := os.read(reader, _PID_BYTES):
            run = int.from_bytes(said, "big")
        if run != _NO_RUN:
            _end(run, grace)
    finally:
        os._exit(0)


def _close_all_but(reader: int) -> None:
    # The journal, the lock and the terminal are the orchestrator's: held open here they would outlive it.
    os.closerange(0, reader)
    os.closerange(reader + 1, min(1 << 16, os.sysconf("SC_OPEN_MAX")))


def _end(run: int, grace: float) -> None:
    with suppress(ProcessLookupError):
        os.kill(run, signal.SIGTERM)
        deadline = time.monotonic() + grace
        while time.monotonic() < deadline:
            os.kill(run, 0)  # raises once it is gone
            time.sleep(_LOOK)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(run, signal.SIGKILL)
