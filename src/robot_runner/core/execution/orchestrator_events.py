"""The events whose callbacks the orchestrating process executes itself: of the experiment, and around each run."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.core.errors import ExecutionError
from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext, SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.events.manager import CallbackFailure, Emission, RobotRunnerEvents
from robot_runner.core.events.outlook import ExperimentEnd, NextRun
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution.event_deadline import DeadlinePassed, EventDeadline
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run_ending import failure_fields
from robot_runner.core.execution.run_events import run_contexts
from robot_runner.core.execution.task import OutcomeBuilder
from robot_runner.core.storage.journal import utc_now

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.patience import Patience
    from robot_runner.core.execution.progress_manager import ProgressManager
    from robot_runner.core.execution.task import PendingRun, Report, RunTask

__all__ = ["OrchestratorEvents"]


#: How often the run table is looked after while a callback of this process sleeps, s.
_LOOK = 1.0


class _AttentiveClock(SystemClock):
    """The clock of callbacks of this process: the screen is kept up to date while they sleep on it."""

    def __init__(self, patience: Patience) -> None:
        self._patience = patience

    def sleep(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(left, self._patience.refresh_interval or _LOOK))
            self._patience.refresh_screen()


class OrchestratorEvents:
    """Emits `before_experiment`, `before_run`, `continue` and `after_experiment`, within `event_deadline_in_s`.

    Args:
        experiment: whose callbacks are called.
        progress: takes down what happens.
        patience: the user's interruption, which ends the callback that is being executed, and the screen.
    """

    def __init__(self, experiment: Experiment, progress: ProgressManager, patience: Patience) -> None:
        self._experiment = experiment
        self._progress = progress
        self._patience = patience
        self._interruption = patience.interruption

    def emit_to_run(
        self,
        event: RobotRunnerEvents,
        task: RunTask,
        report: Report,
        experiment: Experiment | None = None,
        adapt: Callable[[RobotRunnerContext], RobotRunnerContext] = lambda context: context,
    ) -> list[object]:
        """Emit an event of a run in this process; a callback that raises is reported as a failure of the run.

        Args:
            event: the event.
            task: the run.
            report: takes what happens.
            experiment: as the run's place has it, where that differs.
            adapt: makes what a callback is given of the run's context.

        Returns:
            what each callback returned.
        """

        def told(kind: str, fields: dict[str, Any]) -> None:
            report(kind, fields)
            self._patience.refresh_screen()

        told("event", {"event": event.value, "at": utc_now(), "clock": time.monotonic()})
        if not self._experiment.events.subscribers(event):
            return []
        resources = Resources()
        clock = _AttentiveClock(self._patience)
        of_place = experiment or self._experiment
        context_for = run_contexts(of_place, task, clock=clock, resources=resources, report=told)
        try:
            emission = self._emit(event, lambda owner: adapt(context_for(owner)))
            for failure in emission.failures:
                told("failure", {"event": event.value, "owner": failure.owner, **_fields(failure)})
            return [returned for _, returned in emission.returned]
        finally:
            resources.close()

    def emit_to_experiment(self, event: RobotRunnerEvents, ended: ExperimentEnd | None = None) -> list[object]:
        """Emit an event of the whole experiment; returns what each callback returned.

        Raises:
            ExecutionError: a callback raised, or took too long.
        """
        context = ExperimentContext(
            experiment_name=self._experiment.parameters.experiment_name,
            experiment_folder=self._experiment.folder.root,
            robot=self._experiment.parameters.robot,
            seed=self._progress.seed,
            ended=ended,
        )
        self._progress.note("event", event=event.value)
        emission = self._emit(event, lambda _: context)
        for failure in emission.failures:
            if isinstance(failure.error, RunInterrupted):
                break
            fields = _fields(failure)
            self._progress.note("failure", event=event.value, owner=failure.owner, problem=fields["problem"])
            raise ExecutionError(
                fields["problem"],
                where=_place(failure),
                fix="Mend this callback and start the experiment again: it resumes.",
            ) from failure.error
        return [returned for _, returned in emission.returned]

    def user_has_continued(
        self,
        finished: PendingRun,
        following: PendingRun,
        read: Callable[[str, str], None],
        place: str = "",
        experiment: Experiment | None = None,
    ) -> bool:
        """Emit `continue`; a callback that returns True has asked the user itself.

        What is published is a measure of the run that has finished.

        Args:
            finished: the run that is over.
            following: the run that comes next.
            read: called with a factor and an owner when the owner reads its treatment in the run that comes next.
            place: where both are executed; empty where there is one place only.
            experiment: as that place has it, where that differs.

        Raises:
            ExecutionError: a callback raised, or took too long.
        """
        task = self._progress.task_of(finished, place)
        published = OutcomeBuilder(task.run_id, self._experiment.columns)
        published.go_on_from(self._progress.last_outcome(place))

        def report(kind: str, fields: dict[str, Any]) -> None:
            published.take(kind, fields)
            self._progress.record(task, kind, fields)

        def adapt(context: RobotRunnerContext) -> RobotRunnerContext:
            return replace(context, next_run=self._next_run(following, lambda factor: read(factor, context.owner)))

        returned = self.emit_to_run(RobotRunnerEvents.CONTINUE, task, report, experiment, adapt)
        outcome = published.outcome()
        self._progress.amend_outcome(task, outcome)
        if outcome.failure is not None and not self._interruption.is_requested:
            where = " of ".join(filter(None, (outcome.failure.event, outcome.failure.owner)))
            raise ExecutionError(outcome.failure.problem, where=where, fix="Mend this callback, and resume.")
        return any(value is True for value in returned)

    def _next_run(self, run: PendingRun, read: Callable[[str], None]) -> NextRun:
        task = self._progress.task_of(run)
        return NextRun(run.run_id, run.number, WatchedCombination(task.combination, read), task.repetition)

    def _emit(self, event: RobotRunnerEvents, context_for: Callable[[str], object]) -> Emission:
        """Emit an event in this process; Ctrl-C, and the deadline, end the callback that is being executed."""
        gate = InterruptGate()
        subscribers = self._experiment.events.subscribers(event)
        try:
            with self._interruption.passed_on(gate), ExitStack() as guarded:
                if event is not RobotRunnerEvents.AFTER_EXPERIMENT:
                    gate.arm()
                limit = self._experiment.parameters.event_deadline_in_s
                if limit is not None and subscribers:
                    owners = ", ".join(dict.fromkeys(each.owner for each in subscribers))
                    what = f"{event.value} of {owners}"
                    guarded.enter_context(EventDeadline(what, limit, self._experiment.parameters.grace_in_s))
                return self._experiment.events.emit(event, context_for)
        except (RunInterrupted, DeadlinePassed) as error:  # between two callbacks
            return Emission((), (), (CallbackFailure(event, "", error),))


def _place(failure: CallbackFailure) -> str:
    return f"{failure.event.value} of {failure.owner}" if failure.owner else failure.event.value


def _fields(failure: CallbackFailure) -> dict[str, str]:
    fields = failure_fields(failure.error)
    return {**fields, "problem": str(failure.error)} if isinstance(failure.error, DeadlinePassed) else fields
