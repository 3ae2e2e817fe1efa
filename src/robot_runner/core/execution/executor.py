"""Carries out a run on this machine: in a process of its own, supervised, or in the orchestrator itself."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing, redirect_stderr, redirect_stdout
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
    from collections.abc import Callable, Collection, Iterator

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.places import RunInFlight, Watch
    from robot_runner.core.execution.standby import Standby
    from robot_runner.core.execution.systems_state import SystemsState
    from robot_runner.core.execution.task import OutcomeBuilder, RecordWriter, RunOutcome, RunTask

__all__ = ["EndedRun", "Executor", "executor_for"]

#: How long after the grace a keeper that should have ended its run is waited for, s.
_KEEPER_MARGIN = 10.0


class Executor(Protocol):
    """Executes runs; as many at a time as there are slots, each with files of its own."""

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
        """Begin one attempt.

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

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
        parameters = self._experiment.parameters
        limits = _Limits(parameters.run_deadline_in_s, parameters.event_deadline_in_s, parameters.grace_in_s)
        with ExitStack() as opened:
            standby = standby_of(self._experiment, task)
            state = None if standby is None else opened.enter_context(closing(standby.state))
            start = partial(self._start, self._experiment, task, state)
            keeper = opened.enter_context(Keeper(start, limits.grace, self._experiment.folder, standby))
            return _Supervision(keeper, builder, limits, watch, standby, opened.pop_all())


class _InProcessExecutor:
    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
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
        return EndedRun(builder.outcome(interrupted=watch.interruption.is_requested))


class EndedRun:
    """A run that is over when it is returned.

    Args:
        outcome: how it went.
    """

    descriptors: Collection[int] = ()
    due: float | None = 0.0

    def __init__(self, outcome: RunOutcome) -> None:
        self._outcome = outcome

    def advance(self) -> bool:
        """Say that it is over."""
        return True

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """Do nothing: it has ended."""

    def kill(self) -> None:
        """Do nothing: it has ended."""

    def outcome(self) -> RunOutcome:
        """Return how it went."""
        return self._outcome

    def close(self) -> None:
        """Do nothing: there is nothing left of it."""


@dataclass(frozen=True, slots=True)
class _Limits:
    """How long things may take, in seconds of real time; None for no limit."""

    run: float | None
    event: float | None
    grace: float


class _Supervision:
    """Watches over the process of a run: its records, its deadlines, its end.

    A deadline that passes and an interruption have the same consequence: the keeper asks the run to stop, and kills
    it with everything that it started when it has not ended after the grace period.
    """

    def __init__(
        self,
        keeper: Keeper,
        builder: OutcomeBuilder,
        limits: _Limits,
        watch: Watch,
        standby: Standby | None,
        opened: ExitStack,
    ) -> None:
        self._keeper = keeper
        self._standby = standby
        self._builder = builder
        self._limits = limits
        self._watch = watch
        self._opened = opened
        self._reader = RecordReader(keeper.records)
        self._started = self._event_started = time.monotonic()
        self._give_up_at: float | None = None
        self._leave_by: tuple[float, str] | None = None
        self._is_interrupted = False
        self._is_killed = False
        self._because = ""
        self._awaits_records = True
        self._end: Iterator[float] | None = None
        self._look_at = 0.0
        self._outcome: RunOutcome | None = None

    @property
    def descriptors(self) -> Collection[int]:
        """Its records, and what its keeper tells; a keeper that was killed tells nothing more."""
        records = (self._keeper.records,) if self._awaits_records else ()
        return (*records, self._keeper.told) if self._end is None else records

    @property
    def due(self) -> float | None:
        """The next deadline, or the next look at what a dead keeper has left behind."""
        if self._end is not None:
            return self._look_at
        leave_by = None if self._leave_by is None or self._because else self._leave_by[0]
        deadlines = (self._give_up_at, leave_by, *self._deadlines())
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def advance(self) -> bool:
        """Take its records, enforce its deadlines, and see to its end."""
        if self._awaits_records:
            self._take_records()
        if self._end is None:
            self._enforce()
            if not self._keeper.look():
                return False
            self._end = self._ending()
        wait = next(self._end, None)
        if wait is None:
            return True
        self._look_at = time.monotonic() + wait
        return False

    def outcome(self) -> RunOutcome:
        """Return how the run went, once its process is dead."""
        if self._outcome is None:
            raise AssertionError("the run is not over")
        return self._outcome

    def close(self) -> None:
        """Let go of the keeper, which ends a run that is still alive."""
        self._opened.close()

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """Have the keeper ask the run to stop."""
        if self._because or self._end is not None:
            return
        if is_interruption:
            self._is_interrupted = True
            self._watch.noticed_interruption()
        self._because = because
        self._give_up_at = time.monotonic() + self._limits.grace + _KEEPER_MARGIN
        self._keeper.stop()

    def kill(self) -> None:
        """Have the keeper kill the run."""
        if not self._is_killed:
            self._is_killed = self._is_interrupted = True
            self._keeper.kill()

    def _ending(self) -> Iterator[float]:
        """See to what is left to do once the keeper has told, or was killed; yield how long to wait each time, s."""
        if self._keeper.was_killed:
            yield from self._keeper.abandoned_run_ended(self._limits.grace)
        self._take_records()  # the last ones before it ended
        if self._standby is not None and self._keeper.run is not None:
            yield from self._standby.looked_after(self._keeper.run)
            if (finding := self._standby.finding()) is not None:
                self._take("finding", finding)
        self._outcome = self._builder.outcome(ended_because=self._reason(), interrupted=self._is_interrupted)

    def _take_records(self) -> None:
        records, self._awaits_records = self._reader.read()
        for kind, fields in records:
            if kind == "event":
                self._event_started = time.monotonic()
                self._leave_by = None
            elif kind == "mission_stopped" or fields.get("ends_event"):
                reason = fields.get("reason") or fields["problem"]
                self._leave_by = self._leave_by or (time.monotonic() + self._limits.grace, reason)
            self._take(kind, fields)

    def _take(self, kind: str, fields: dict[str, Any]) -> None:
        self._builder.take(kind, fields)
        self._watch.report(kind, fields)

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
        if run_deadline is not None and now >= run_deadline:
            self.stop(f"the run took longer than run_deadline_in_s = {self._limits.run:g} s")
        elif event_deadline is not None and now >= event_deadline:
            self.stop(f"the event took longer than event_deadline_in_s = {self._limits.event:g} s")
        elif self._leave_by is not None and now >= self._leave_by[0] and not self._because:
            self.stop(
                f"{self._leave_by[1]}; {self._builder.event} had not ended grace_in_s = {self._limits.grace:g} s later"
            )
        if self._give_up_at is not None and now >= self._give_up_at:
            self._give_up_at = None
            self._keeper.give_up()

    def _reason(self) -> str:
        """Return why the run ended where it did not end by itself."""
        if self._because:
            return self._because
        if self._keeper.has_failed and self._builder.has_failed:
            return ""  # it has said itself why it could not go on
        if self._keeper.was_killed or not self._builder.is_finished:
            return self._keeper.death() or "the run's process exited with code 0 before the run had ended"
        return ""
