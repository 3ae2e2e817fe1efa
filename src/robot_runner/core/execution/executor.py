"""Carries out one run: in a process of its own, supervised, or in the orchestrator itself."""

from __future__ import annotations

import select
import time
from contextlib import ExitStack, closing, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.keeper import Keeper
from robot_runner.core.execution.run_events import execute_run
from robot_runner.core.execution.standby import standby_of
from robot_runner.core.execution.task import FINISHED, RecordReader
from robot_runner.core.execution.worker import be_run, become_interpreter
from robot_runner.core.links.connect import preload_simulation
from robot_runner.core.storage.layout import LazyLog

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.interruption import Interruption
    from robot_runner.core.execution.standby import Standby
    from robot_runner.core.execution.systems_state import SystemsState
    from robot_runner.core.execution.task import OutcomeBuilder, RecordWriter, Report, RunOutcome, RunTask

__all__ = ["Executor", "Watch", "executor_for"]

_READABLE = select.POLLIN | select.POLLHUP | select.POLLERR
#: How long after the grace a keeper that should have ended its run is waited for, s.
_KEEPER_MARGIN = 10.0


@dataclass(frozen=True, slots=True)
class Watch:
    """What the orchestrator wants to know and do while a run is executed.

    Attributes:
        report: takes each record as it arrives.
        refresh: called every `refresh_interval` seconds; never where that is None.
        tend: called after each record, and when the time is over that it returned last, in seconds; None where nothing
            is due.
        noticed_interruption: called once the run has been asked to stop because the user interrupted.
    """

    interruption: Interruption
    report: Report = lambda _kind, _fields: None
    refresh: Callable[[], None] = lambda: None
    refresh_interval: float | None = None
    noticed_interruption: Callable[[], None] = lambda: None
    tend: Callable[[], float | None] = lambda: None


class Executor(Protocol):
    """Executes runs, one at a time."""

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        """Execute one attempt and return how it went, whatever becomes of the run.

        Args:
            task: what is executed.
            builder: holds what was known of the attempt before.
            watch: what else goes on meanwhile.
        """
        ...


def executor_for(experiment: Experiment) -> Executor:
    """Return the executor that the config's `run_process` asks for."""
    match experiment.parameters.run_process:
        case RunProcess.FORK:
            preload_simulation(experiment.parameters.robot)
            return _ProcessExecutor(experiment, be_run)
        case RunProcess.SPAWN:
            return _ProcessExecutor(experiment, become_interpreter)
        case RunProcess.IN_PROCESS:
            return _InProcessExecutor(experiment)


class _ProcessExecutor:
    def __init__(
        self, experiment: Experiment, start: Callable[[Experiment, RunTask, SystemsState | None, RecordWriter], None]
    ) -> None:
        self._experiment = experiment
        self._start = start

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        parameters = self._experiment.parameters
        limits = _Limits(parameters.run_deadline_in_s, parameters.event_deadline_in_s, parameters.grace_in_s)
        with ExitStack() as opened:
            standby = standby_of(self._experiment, task)
            state = None if standby is None else opened.enter_context(closing(standby.state))
            start = partial(self._start, self._experiment, task, state)
            keeper = opened.enter_context(Keeper(start, limits.grace, self._experiment.folder, standby))
            return _Supervision(keeper, builder, limits, watch, standby).follow()


class _InProcessExecutor:
    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        def report(kind: str, fields: dict[str, object]) -> None:
            builder.take(kind, fields)
            watch.report(kind, fields)
            if watch.refresh_interval is not None:
                watch.refresh()
            watch.tend()

        with LazyLog(self._experiment.folder) as log, redirect_stdout(log), redirect_stderr(log):
            gate = InterruptGate()
            with watch.interruption.passed_on(gate):
                execute_run(self._experiment, task, report, gate)
        report(FINISHED, {})
        return builder.outcome(interrupted=watch.interruption.is_requested)


@dataclass(frozen=True, slots=True)
class _Limits:
    """How long things may take, in seconds of real time; None for no limit."""

    run: float | None
    event: float | None
    grace: float


class _Supervision:
    """Watches over the process of a run: its records, its deadlines, its end, and the user's stop requests.

    A deadline that passes and an interruption have the same consequence: the keeper asks the run to stop, and kills
    it with everything that it started when it has not ended after the grace period.
    """

    def __init__(
        self, keeper: Keeper, builder: OutcomeBuilder, limits: _Limits, watch: Watch, standby: Standby | None
    ) -> None:
        self._keeper = keeper
        self._standby = standby
        self._builder = builder
        self._limits = limits
        self._watch = watch
        self._interruption = watch.interruption
        self._reader = RecordReader(keeper.records)
        self._started = self._event_started = time.monotonic()
        self._give_up_at: float | None = None
        self._leave_by: tuple[float, str] | None = None
        self._tend_in: float | None = watch.tend()
        self._is_interrupted = False
        self._is_killed = False
        self._because = ""
        self._poll = select.poll()
        for descriptor in (keeper.records, keeper.told, watch.interruption.descriptor):
            self._poll.register(descriptor, _READABLE)

    def follow(self) -> RunOutcome:
        """Return how the run went, once its process is dead."""
        while not self._keeper.look():
            for descriptor, _ in self._poll.poll(self._milliseconds()):
                if descriptor == self._keeper.records:
                    self._take_records()
                elif descriptor == self._interruption.descriptor:
                    self._interruption.forget_wakeups()
            self._enforce()
            if self._watch.refresh_interval is not None:
                self._watch.refresh()
            self._tend_in = self._watch.tend()
        if self._keeper.was_killed:
            self._keeper.end_abandoned_run(self._limits.grace, meanwhile=self._take_records)
        self._take_records()  # the last ones before it ended
        if self._standby is not None and self._keeper.run is not None:
            self._standby.look_after(self._keeper.run)
            if (finding := self._standby.finding()) is not None:
                self._take("finding", finding)
        return self._builder.outcome(ended_because=self._reason(), interrupted=self._is_interrupted)

    def _take_records(self) -> None:
        records, is_open = self._reader.read()
        for kind, fields in records:
            if kind == "event":
                self._event_started = time.monotonic()
                self._leave_by = None
            elif kind == "mission_stopped" or fields.get("ends_event"):
                reason = fields.get("reason") or fields["problem"]
                self._leave_by = self._leave_by or (time.monotonic() + self._limits.grace, reason)
            self._take(kind, fields)
        if not is_open:
            with suppress(KeyError):
                self._poll.unregister(self._keeper.records)

    def _take(self, kind: str, fields: dict[str, Any]) -> None:
        self._builder.take(kind, fields)
        self._watch.report(kind, fields)

    def _milliseconds(self) -> float | None:
        now = time.monotonic()
        leave_by = None if self._leave_by is None or self._because else self._leave_by[0]
        deadlines = (self._give_up_at, leave_by, *self._deadlines())
        waits = [deadline - now for deadline in deadlines if deadline is not None]
        if self._watch.refresh_interval is not None:
            waits.append(self._watch.refresh_interval)
        if self._tend_in is not None:
            waits.append(self._tend_in)
        return max(0.0, min(waits)) * 1000 + 1 if waits else None

    def _deadlines(self) -> tuple[float | None, float | None]:
        """Return the moments at which the run, and its present event, have taken too long."""
        if self._because:  # it was asked to stop
            return None, None
        run, event = self._limits.run, self._limits.event
        return (
            None if run is None else self._started + run,
            None if event is None else self._event_started + event,
        )

    def _enforce(self) -> None:
        now = time.monotonic()
        run_deadline, event_deadline = self._deadlines()
        if self._interruption.is_requested and not self._because:
            self._is_interrupted = True
            self._watch.noticed_interruption()
            self._stop("the user interrupted the experiment")
        elif run_deadline is not None and now >= run_deadline:
            self._stop(f"the run took longer than run_deadline_in_s = {self._limits.run:g} s")
        elif event_deadline is not None and now >= event_deadline:
            self._stop(f"the event took longer than event_deadline_in_s = {self._limits.event:g} s")
        elif self._leave_by is not None and now >= self._leave_by[0] and not self._because:
            self._stop(
                f"{self._leave_by[1]}; {self._builder.event} had not ended grace_in_s = {self._limits.grace:g} s later"
            )
        if self._interruption.is_urgent and not self._is_killed:
            self._is_killed = self._is_interrupted = True
            self._keeper.kill()
        if self._give_up_at is not None and now >= self._give_up_at:
            self._give_up_at = None
            self._keeper.give_up()

    def _stop(self, because: str) -> None:
        self._because = because
        self._give_up_at = time.monotonic() + self._limits.grace + _KEEPER_MARGIN
        self._keeper.stop()

    def _reason(self) -> str:
        """Return why the run ended where it did not end by itself."""
        if self._because:
            return self._because
        if self._keeper.was_killed or not self._builder.is_finished:
            return self._keeper.death() or "the run's process exited with code 0 before the run had ended"
        return ""
