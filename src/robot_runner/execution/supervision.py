"""Watching over the process of a run: its records, its deadlines, its death."""

from __future__ import annotations

import os
import select
import signal
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.execution.records import RecordReader

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.execution.interruption import Interruption
    from robot_runner.execution.outcome import OutcomeBuilder
    from robot_runner.execution.task import Report, RunOutcome

__all__ = ["Limits", "RunProcessHandle", "Watch", "supervise"]

#: Without pidfd (not Linux) the death of the process is looked for this often, in seconds.
_POLL_WITHOUT_PIDFD = 0.02
#: How long a run is left alone at first, in milliseconds; its records wait in the pipe.
_SOON = 20
_READABLE = select.POLLIN | select.POLLHUP | select.POLLERR


@dataclass(frozen=True, slots=True)
class Limits:
    """How long things may take, in seconds of real time; None for no limit."""

    run: float | None
    event: float | None
    grace: float


@dataclass(frozen=True, slots=True)
class Watch:
    """What the orchestrator wants to know and do while a run is executed.

    Attributes:
        report: takes each record as it arrives.
        refresh: called every `refresh_interval` seconds; never where that is None.
        noticed_interruption: called once the user's wish to end has reached the run.
    """

    interruption: Interruption
    report: Report
    refresh: Callable[[], None]
    refresh_interval: float | None
    noticed_interruption: Callable[[], None]


class RunProcessHandle:
    """The process of a run, the leader of a process group of its own."""

    def __init__(self, pid: int, records: int) -> None:
        self.pid = pid
        self.records = records
        self._status: int | None = None
        self._pidfd = os.pidfd_open(pid) if hasattr(os, "pidfd_open") else None

    @property
    def pidfd(self) -> int | None:
        """Readable once the process is dead, where the system has such a thing."""
        return self._pidfd

    def has_ended(self) -> bool:
        """Look, without waiting, whether the process is dead."""
        if self._status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._status = status
        return self._status is not None

    def death(self) -> str:
        """Return how the process died, or nothing if it exited with 0."""
        code = os.waitstatus_to_exitcode(self._status or 0)
        if code < 0:
            return f"its process was killed by {signal.Signals(-code).name}"
        return f"its process exited with code {code}" if code else ""

    def tell_to_end(self) -> None:
        """Ask the run to close what it opened, and to end."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)

    def kill_group(self) -> None:
        """Kill the process and everything that it started and left in its group."""
        for _ in range(2):  # the process may not yet have become the leader of its group
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, signal.SIGKILL)
                return
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def end(self, grace: float) -> None:
        """Let go of the process: whatever it started and left behind is killed.

        Where it is still alive it is told to end first, and has `grace` seconds to close what it opened.
        """
        if not self.has_ended():
            self.tell_to_end()
            deadline = time.monotonic() + grace
            while not self.has_ended() and time.monotonic() < deadline:
                time.sleep(_POLL_WITHOUT_PIDFD)
        while not self.has_ended():
            self.kill_group()
            time.sleep(_POLL_WITHOUT_PIDFD)
        with suppress(ProcessLookupError, PermissionError):  # the usual case: nobody is left
            os.killpg(self.pid, signal.SIGKILL)
        os.close(self.records)
        if self._pidfd is not None:
            os.close(self._pidfd)


def supervise(
    process: RunProcessHandle,
    builder: OutcomeBuilder,
    *,
    limits: Limits,
    watch: Watch,
) -> RunOutcome:
    """Follow a run's process until it is dead, whatever becomes of it, and return how the run went.

    A deadline that passes and an interruption have the same consequence: the run is told to end, and is killed with
    everything it started when it has not ended after the grace period.
    """
    return _Supervision(process, builder, limits, watch).follow()


class _Supervision:
    def __init__(
        self,
        process: RunProcessHandle,
        builder: OutcomeBuilder,
        limits: Limits,
        watch: Watch,
    ) -> None:
        self._process = process
        self._builder = builder
        self._limits = limits
        self._interruption = watch.interruption
        self._report = watch.report
        self._noticed_interruption = watch.noticed_interruption
        self._refresh = watch.refresh
        self._refresh_interval = watch.refresh_interval
        self._reader = RecordReader(process.records)
        self._started = self._event_started = time.monotonic()
        self._kill_at: float | None = None
        self._because = ""
        self._interrupted = False
        self._poll = select.poll()
        for descriptor in (process.records, process.pidfd, watch.interruption.descriptor):
            if descriptor is not None:
                self._poll.register(descriptor, _READABLE)

    def follow(self) -> RunOutcome:
        has_pidfd = self._process.pidfd is not None
        may_have_ended = not has_pidfd or self._ends_soon()
        while not (may_have_ended and self._process.has_ended()):
            may_have_ended = not has_pidfd
            for descriptor, _ in self._poll.poll(self._milliseconds()):
                if descriptor == self._process.records:
                    self._take_records()
                elif descriptor == self._process.pidfd:
                    may_have_ended = True
                else:
                    self._interruption.forget_wakeups()
            self._enforce()
            if self._refresh_interval is not None:
                self._refresh()
        self._take_records()  # what it said before it died
        return self._builder.outcome(ended_because=self._end(), interrupted=self._interrupted)

    def _ends_soon(self) -> bool:
        """Give a short run the time to end undisturbed: while it lives, each page that we touch has to be copied."""
        soon = select.poll()
        for descriptor in (self._process.pidfd, self._interruption.descriptor):
            if descriptor is not None:
                soon.register(descriptor, _READABLE)
        return any(descriptor == self._process.pidfd for descriptor, _ in soon.poll(_SOON))

    def _take_records(self) -> None:
        records, is_open = self._reader.read()
        for kind, fields in records:
            if kind == "event":
                self._event_started = time.monotonic()
            self._builder.take(kind, fields)
            self._report(kind, fields)
        if not is_open:
            with suppress(KeyError):
                self._poll.unregister(self._process.records)

    def _milliseconds(self) -> float | None:
        now = time.monotonic()
        waits = [deadline - now for deadline in self._deadlines() if deadline is not None]
        if self._refresh_interval is not None:
            waits.append(self._refresh_interval)
        if self._process.pidfd is None:
            waits.append(_POLL_WITHOUT_PIDFD)
        return max(0.0, min(waits)) * 1000 + 1 if waits else None

    def _deadlines(self) -> tuple[float | None, ...]:
        if self._kill_at is not None:
            return (self._kill_at,)
        run, event = self._limits.run, self._limits.event
        return (
            None if run is None else self._started + run,
            None if event is None else self._event_started + event,
        )

    def _enforce(self) -> None:
        now = time.monotonic()
        if self._interruption.is_urgent:
            self._interrupted = True
            self._process.kill_group()
        elif self._kill_at is not None:
            if now >= self._kill_at:
                self._process.kill_group()
                self._kill_at = now + self._limits.grace
        elif self._interruption.is_requested:
            self._interrupted = True
            self._noticed_interruption()
            self._end_run("the user interrupted the experiment")
        else:
            self._enforce_deadlines(now)

    def _enforce_deadlines(self, now: float) -> None:
        run_deadline, event_deadline = self._deadlines()
        if run_deadline is not None and now >= run_deadline:
            self._end_run(f"the run took longer than run_deadline_in_s = {self._limits.run:g} s")
        elif event_deadline is not None and now >= event_deadline:
            self._end_run(f"the event took longer than event_deadline_in_s = {self._limits.event:g} s")

    def _end_run(self, because: str) -> None:
        self._because = because
        self._kill_at = time.monotonic() + self._limits.grace
        self._process.tell_to_end()

    def _end(self) -> str:
        if self._because:
            return self._because
        if not self._builder.is_finished:
            return self._process.death() or "its process exited with code 0 before the run had ended"
        return ""
