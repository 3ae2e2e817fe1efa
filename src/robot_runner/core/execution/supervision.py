"""Watching over the process of a run: its records, its deadlines, its death."""

from __future__ import annotations

import select
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.execution.task import RecordReader

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.execution.guardian import GuardedRun
    from robot_runner.core.execution.interruption import Interruption
    from robot_runner.core.execution.task import OutcomeBuilder, Report, RunOutcome

__all__ = ["Limits", "Watch", "supervise"]

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


def supervise(
    run: GuardedRun,
    builder: OutcomeBuilder,
    *,
    limits: Limits,
    watch: Watch,
) -> RunOutcome:
    """Follow a run's process until it is dead, whatever becomes of it, and return how the run went.

    A deadline that passes and an interruption have the same consequence: the run is told to end, and is killed with
    everything it started when it has not ended after the grace period.
    """
    return _Supervision(run, builder, limits, watch).follow()


class _Supervision:
    def __init__(
        self,
        run: GuardedRun,
        builder: OutcomeBuilder,
        limits: Limits,
        watch: Watch,
    ) -> None:
        self._run = run
        self._builder = builder
        self._limits = limits
        self._interruption = watch.interruption
        self._report = watch.report
        self._noticed_interruption = watch.noticed_interruption
        self._refresh = watch.refresh
        self._refresh_interval = watch.refresh_interval
        self._reader = RecordReader(run.records)
        self._started = self._event_started = time.monotonic()
        self._kill_at: float | None = None
        self._because = ""
        self._interrupted = False
        self._poll = select.poll()
        for descriptor in (run.records, run.ended, watch.interruption.descriptor):
            self._poll.register(descriptor, _READABLE)

    def follow(self) -> RunOutcome:
        self._wait_a_little()
        while not self._run.has_ended():
            for descriptor, _ in self._poll.poll(self._milliseconds()):
                if descriptor == self._run.records:
                    self._take_records()
                elif descriptor == self._interruption.descriptor:
                    self._interruption.forget_wakeups()
            self._enforce()
            if self._refresh_interval is not None:
                self._refresh()
        self._take_records()  # what it said before it died
        return self._builder.outcome(ended_because=self._end(), interrupted=self._interrupted)

    def _wait_a_little(self) -> None:
        """Give a short run the time to end undisturbed: to be woken for each of its records would cost more."""
        soon = select.poll()
        for descriptor in (self._run.ended, self._interruption.descriptor):
            soon.register(descriptor, _READABLE)
        soon.poll(_SOON)

    def _take_records(self) -> None:
        records, is_open = self._reader.read()
        for kind, fields in records:
            if kind == "event":
                self._event_started = time.monotonic()
            self._builder.take(kind, fields)
            self._report(kind, fields)
        if not is_open:
            with suppress(KeyError):
                self._poll.unregister(self._run.records)

    def _milliseconds(self) -> float | None:
        now = time.monotonic()
        waits = [deadline - now for deadline in self._deadlines() if deadline is not None]
        if self._refresh_interval is not None:
            waits.append(self._refresh_interval)
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
            self._run.kill_group()
        elif self._kill_at is not None:
            if now >= self._kill_at:
                self._run.kill_group()
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
        self._run.tell_to_end()

    def _end(self) -> str:
        if self._because:
            return self._because
        if self._run.guardian_was_killed or not self._builder.is_finished:
            return self._run.death() or "its process exited with code 0 before the run had ended"
        return ""
