"""The process that starts each run, watches over it, and outlives the orchestrator for as long as it takes to end it.

Whatever kills an orchestrator (SIGKILL, out of memory) must not leave a robot driving. The run cannot watch for that
itself in all states that it may be in: a callback that hangs in C runs no Python, so neither a signal handler nor a
thread of ours would come to its turn. The guardian can: it is forked from the orchestrator and does nothing else.

That it also starts the runs is for their speed: it touches next to nothing of the memory that it shares with a run it
forked, so next to nothing has to be copied, and it forks the process of the next run while the orchestrator records
the last one.
"""

from __future__ import annotations

import mmap
import os
import signal
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Self

from robot_runner.core.execution.guarding import (
    END,
    KILL,
    NO_RUN,
    NUMBER_BYTES,
    RUN,
    GuardianProcess,
    end_group,
    forked,
    number_of,
    wait_until,
)

if TYPE_CHECKING:
    from robot_runner.core.execution.guarding import Starter

__all__ = ["GuardedRun", "Guardian"]


class Guardian:
    """The orchestrator's end of it: a context manager, within which runs are started one after the other."""

    def __init__(self, starter: Starter, grace: float) -> None:
        """Take what starts a run, and the seconds that an abandoned run has to close what it opened."""
        self._starter = starter
        self._grace = grace
        self._status: int | None = None

    def __enter__(self) -> Self:
        sys.stdout.flush()  # or a run would print it again
        sys.stderr.flush()
        commands, self._commands = os.pipe()
        self._ends, ends = os.pipe()
        self._records, records = os.pipe()
        self._run = mmap.mmap(-1, NUMBER_BYTES)
        self._pid = forked()
        if self._pid == 0:
            try:
                for descriptor in (self._commands, self._ends, self._records):
                    os.close(descriptor)
                GuardianProcess(commands, ends, records, self._run, self._starter, self._grace).guard()
            finally:
                os._exit(70)  # never back into the orchestrator's code
        for descriptor in (commands, ends, records):
            os.close(descriptor)
        os.set_blocking(self._records, False)
        os.set_blocking(self._ends, False)
        return self

    def __exit__(self, *raised: object) -> None:
        os.close(self._commands)  # the word to leave
        self.wait()
        os.close(self._ends)
        os.close(self._records)
        self._run.close()

    def has_died(self) -> bool:
        """Look, without waiting, whether somebody killed it."""
        if self._status is None:
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            self._status = status if pid else None
        return self._status is not None

    def wait(self) -> int:
        """Wait until the process is gone; return how it went, as `os.waitpid` does."""
        if self._status is None:
            self._status = os.waitpid(self._pid, 0)[1]
        return self._status

    def start(self, task: bytes) -> GuardedRun:
        """Start a run.

        Args:
            task: what the starter's process makes of it.
        """
        self._say(RUN + len(task).to_bytes(NUMBER_BYTES, "big") + task)
        return GuardedRun(self, self._ends, self._records)

    def tell_to_end(self) -> None:
        """Ask the run to close what it opened, and to end."""
        self._say(END)

    def kill_group(self) -> None:
        """Kill the run and everything that it started and left in its group."""
        self._say(KILL)

    def end_orphan(self) -> None:
        """End the run of a guardian that was killed: nobody would guard it."""
        run = number_of(self._run[:])
        if run != NO_RUN:
            end_group(run, self._grace)

    def _say(self, command: bytes) -> None:
        with suppress(BrokenPipeError):  # it was killed: seen by who waits for the run's end
            while command:  # a signal may come in between
                command = command[os.write(self._commands, command) :]


class GuardedRun:
    """The process of a run, the leader of a process group of its own."""

    def __init__(self, guardian: Guardian, ends: int, records: int) -> None:
        self._guardian = guardian
        self._ends = ends
        self._how: int | None = None
        self.records = records
        self.guardian_was_killed = False

    @property
    def ended(self) -> int:
        """A descriptor that is readable once the process is dead."""
        return self._ends

    def has_ended(self) -> bool:
        """Look, without waiting, whether the process is dead; nothing that it started in its group is alive then."""
        if self._how is None:
            with suppress(BlockingIOError):
                said = os.read(self._ends, NUMBER_BYTES)
                self._how = number_of(said) if said else self._lost()
        return self._how is not None

    def death(self) -> str:
        """Return how the process died, or nothing if it exited with 0."""
        code = os.waitstatus_to_exitcode(self._how or 0)
        whose = "its guardian" if self.guardian_was_killed else "its process"
        if code < 0:
            return f"{whose} was killed by {signal.Signals(-code).name}"
        return f"{whose} exited with code {code}" if code else ""

    def tell_to_end(self) -> None:
        """Ask the run to close what it opened, and to end."""
        self._guardian.tell_to_end()

    def kill_group(self) -> None:
        """Kill the run and everything that it started and left in its group."""
        self._guardian.kill_group()

    def end(self, grace: float) -> None:
        """See to it that the process is dead; one that is alive is told to end, and has `grace` seconds to do so."""
        if self.has_ended():
            return
        self.tell_to_end()
        wait_until(self.has_ended, grace)
        while not self.has_ended():
            self.kill_group()
            time.sleep(0.02)

    def _lost(self) -> int:
        self.guardian_was_killed = True
        self._guardian.end_orphan()
        return self._guardian.wait()
