"""One run at its place: its preparation, its attempts, and the record of each, step by step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

from robot_runner.core.config.gate_parameters import GuardAction
from robot_runner.core.config.parameters import FailurePolicy
from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.events.measure import ROBOT, ROBOTS_OWNER, Origin
from robot_runner.core.execution.between_runs import BetweenRuns
from robot_runner.core.execution.gates import Gates, Passage
from robot_runner.core.execution.notices import (
    AttemptFinished,
    AttemptStarted,
    FindingsNoticed,
    InterruptionNoticed,
    RunRecord,
)
from robot_runner.core.execution.operator import Operator
from robot_runner.core.execution.orchestrator_events import OngoingExperiment
from robot_runner.core.execution.places import Place, Watch
from robot_runner.core.execution.poll_loop import Steps
from robot_runner.core.execution.run_records import failure_fields
from robot_runner.core.execution.task import AttemptStatus, OutcomeBuilder, PendingRun, Report, RunOutcome, RunTask
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING, MOVING_ROBOT
from robot_runner.core.treatments import bind, factors_of, values_of
from robot_runner.core.words import plain


class Attempts:
    """Executes runs, each at a place, as often as the config allows."""

    def __init__(self, ongoing: OngoingExperiment) -> None:
        self._ongoing = ongoing
        self._parameters = ongoing.experiment.parameters
        self._progress = ongoing.progress
        self._operator = Operator(ongoing)
        self._between_runs = BetweenRuns(ongoing, self._operator)
        self._gates = Gates(ongoing)
        self._lost: Counter[str] = Counter()
        self._left: dict[str, int] = {}

    def execute(
        self, run: PendingRun, place: Place, finished: PendingRun | None, *, is_cleared: bool
    ) -> Steps[RunOutcome | None]:
        """Try to execute a run as often as the config allows.

        `finished` is the run that was executed there before; None where none was in this session. With `is_cleared`, a
        callback has asked the user already whether the run may start. Return how the last attempt went; None where it
        was not begun, as the experiment ends.
        """
        ongoing = self._ongoing
        name = "" if ongoing.has_one_place else place.name
        to_ask = self._operator.due_after(run)
        yield from self._between_runs.prepare(run, finished, place, name, is_cleared=is_cleared)
        outcome = None
        for attempts_left in range(self._left.pop(run.run_id, self._parameters.attempts - 1), -1, -1):
            if attempts_left < self._parameters.attempts - 1:
                yield from self._between_runs.prepare_again(run, name)
            passage = yield from self._pass_gates(run, place)
            if ongoing.is_ending or self._is_stopped_by(passage.stop, run):
                return outcome
            self._progress.find(*self._ongoing.clock.look(run.run_id))
            task = replace(self._progress.begin(run, name, place.slot), attempts_left=attempts_left)
            ongoing.notify(AttemptStarted(task, self._progress.time_left))
            outcome = yield from self._attempt(task, place, passage)
            if self._keep(task, outcome, to_ask):
                break
        has_failed = outcome is not None and outcome.status is AttemptStatus.FAILED
        if has_failed and not self.is_to_do_elsewhere(run) and self._parameters.on_failure is FailurePolicy.STOP:
            ongoing.stopped_by = ongoing.stopped_by or "on_failure"
        if outcome is not None and outcome.status is AttemptStatus.DONE:
            yield from self._operator.ask_after(run, name, outcome, to_ask)
        return outcome

    def _pass_gates(self, run: PendingRun, place: Place) -> Steps[Passage]:
        """Await the gates; again after a pause that was requested meanwhile, as they are about the run's start."""
        while not self._ongoing.is_ending:
            passage = yield from self._gates.pass_before(run, place.experiment)
            if passage.stop or not (yield from self._between_runs.pause_where_requested(run)):
                return passage
        return Passage()

    def ask_about_earlier(self) -> Steps[None]:
        """Ask for the operator's steps after runs of earlier sessions that ended before these steps were done."""
        return self._operator.ask_about_earlier()

    def _keep(self, task: RunTask, outcome: RunOutcome, to_ask: Sequence[str]) -> bool:
        """Record the outcome of an attempt and the answers after it; return whether it was the last at this place."""
        is_last = outcome.status is not AttemptStatus.FAILED or bool(self._ongoing.stopped_by)
        if outcome.is_lost and not is_last:
            # Once `attempts_if_lost` is used up, a lost attempt counts as one of `attempts`.
            self._lost[task.run_id] += 1
            left = task.attempts_left - (self._lost[task.run_id] > self._parameters.attempts_if_lost)
            if left >= 0:
                self._left[task.run_id] = left
        is_to_do = task.run_id in self._left
        is_last = is_last or (task.attempts_left == 0 and not is_to_do)
        self._progress.find(*self._ongoing.clock.look(task.run_id, outcome.findings))
        to_ask = to_ask if outcome.status is AttemptStatus.DONE else ()
        noticed = self._progress.record_outcome(task, outcome, is_last=is_last, to_ask=to_ask)
        self._ongoing.notify(AttemptFinished(task, outcome, is_last, self._progress.time_left))
        if noticed:
            self._ongoing.notify(FindingsNoticed(noticed))
        return is_last or is_to_do

    def is_to_do_elsewhere(self, run: PendingRun) -> bool:
        """Whether the last attempt at a run was lost with its place, and another one is to be made."""
        return run.run_id in self._left

    def _is_stopped_by(self, reason: str, run: PendingRun) -> bool:
        """Stop the experiment where there is a reason to; the run that it was about to execute is still to do."""
        if reason:
            self._ongoing.stopped_by = "a gate"
            fix = "See to it, and start the experiment again: it resumes."
            self._progress.find(Finding.warning(f"before {run.run_id}", f"stopped, as {reason}", fix))
        return bool(reason)

    def _attempt(self, task: RunTask, place: Place, passage: Passage) -> Steps[RunOutcome]:
        ongoing, columns = self._ongoing, self._ongoing.experiment.columns
        builder = OutcomeBuilder(
            task.run_id, columns, on_bad_value=self._parameters.on_bad_value, has_attempts_left=task.attempts_left > 0
        )

        is_over = False

        def report(kind: str, fields: dict[str, Any]) -> None:
            if is_over:
                raise _told_too_late(task, kind, fields)
            self._progress.record(task, kind, fields)
            ongoing.notify(RunRecord(task.run_id, kind, fields))
            if kind == "guard" and fields["action"] == GuardAction.STOP.value:
                ongoing.stopped_by = "a guard"
            if kind in {"finding", "failure"} and MAY_BE_MOVING in fields["problem"]:
                ongoing.stopped_by = MOVING_ROBOT

        def report_own(kind: str, fields: dict[str, Any]) -> None:
            builder.take(kind, fields)
            report(kind, fields)

        self._operator.hand_over(task, report_own)
        if place.experiment.parameters.robots:
            # Measured, not simulated: which robot it was is known also of simulated robots.
            robot = {"name": ROBOT, "value": place.name, "owner": ROBOTS_OWNER, "origin": Origin.MEASURED.value}
            task.measures[ROBOT] = robot
            report_own("measure", robot)
        passage.report_to(report_own, columns)
        self._bind_plugins(task, report_own)
        if not builder.has_failed:
            ongoing.events.emit_to_run(RobotRunnerEvents.BEFORE_RUN, task, report_own, place.experiment)
        if builder.has_failed or ongoing.is_interrupted:
            is_over = True
            return builder.outcome(interrupted=ongoing.is_interrupted)
        watch = Watch(
            interruption=ongoing.poll_loop.interruption,
            report=report,
            refresh=ongoing.poll_loop.refresh_screen,
            noticed_interruption=lambda: ongoing.notify(InterruptionNoticed(task.run_id)),
        )
        with closing(place.begin(task, builder, watch)) as run:
            yield run
            outcome = run.outcome()  # which may tell something, too
        is_over = True
        return outcome

    def _bind_plugins(self, task: RunTask, report: Report) -> None:
        """Build plugins with the run's treatments for their bound parameters; an exception in one fails the run."""
        for plugin in self._ongoing.experiment.plugins:
            values = values_of(plugin, task.combination)
            if not values:
                continue
            factors = factors_of(plugin)
            parameters = {name: {"factor": factors[name], "value": plain(values[name])} for name in values}
            report("bound", {"owner": plugin.name, "parameters": parameters})
            try:
                bind(plugin, task.combination)
            except Exception as error:  # noqa: BLE001 - a stranger's code
                report("failure", {"event": "", "owner": plugin.name, **failure_fields(error)})


def _told_too_late(task: RunTask, kind: str, fields: Mapping[str, Any]) -> PluginError:
    """Return the error for a thread of this process that publishes after its run has ended."""
    what = f"measure {fields['name']!r}" if kind == "measure" else fields.get("problem") or f"a record of kind {kind!r}"
    problem = f"{task.run_id} has ended, and this is lost: {what}"
    fix = "Publish in populate_run_data at the latest, and end the thread in stop_run, or in after_experiment."
    return PluginError(problem, where=str(fields.get("owner", "")), fix=fix)
