"""The experiment orchestrator: executes each run of the run table and says how it went (paper, II.C)."""

from __future__ import annotations

import gc
import logging
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from robot_runner.core.config.gate_parameters import GuardAction
from robot_runner.core.config.parameters import FailurePolicy
from robot_runner.core.errors import ExecutionError, Finding, RobotRunnerError, StorageError
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.events.measure import OPERATOR_OWNER
from robot_runner.core.events.outlook import ExperimentEnd
from robot_runner.core.execution.between_runs import BetweenRuns
from robot_runner.core.execution.executor import Watch, executor_for
from robot_runner.core.execution.gates import Gates, Passage
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.notices import (
    AttemptFinished,
    AttemptStarted,
    ExperimentFinished,
    ExperimentStarted,
    FindingsNoticed,
    InterruptionNoticed,
    Notice,
    Observer,
    PreparationStarted,
    ProbeStarted,
    RunRecord,
)
from robot_runner.core.execution.notifications import Notifications
from robot_runner.core.execution.operator import Operator
from robot_runner.core.execution.orchestrator_events import OrchestratorEvents
from robot_runner.core.execution.patience import Patience
from robot_runner.core.execution.prepared_treatments import prepared_treatments
from robot_runner.core.execution.probe import Probe, probe_profilers, probed_profilers
from robot_runner.core.execution.progress_manager import ProgressManager
from robot_runner.core.execution.recovery import Resumption
from robot_runner.core.execution.run_ending import failure_fields
from robot_runner.core.execution.task import AttemptStatus, OutcomeBuilder, PendingRun, RunOutcome, RunTask
from robot_runner.core.treatments import bind, factors_of, values_of
from robot_runner.core.words import plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Any

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.task import Report

__all__ = ["execute_experiment"]


#: How often the run table is looked after between two runs, in seconds.
_LOOK_AT_TABLE = 1.0

_log = logging.getLogger(__name__)


def execute_experiment(
    experiment: Experiment,
    observer: Observer,
    *,
    findings: Sequence[Finding] = (),
    resumption: Resumption | None = None,
) -> ExperimentFinished:
    """Execute every run that is not done, and return how the experiment ended.

    Call it in the main thread: while it lasts, SIGINT, SIGTERM and SIGHUP end the experiment cleanly.

    Args:
        experiment: a config that was found to be well formed.
        observer: gets a notice of everything that happens.
        findings: of validation; they are shown again at the end.
        resumption: what to execute again, and whether to go on though something changed.

    Raises:
        RobotRunnerError: the experiment cannot start (it is being executed by somebody else, its folder cannot be
            written, the config or the run table on disk changed, a profiler does not measure) or cannot go on (the
            disk is full).
    """
    resumption = resumption or Resumption()

    def probe(task: RunTask) -> Probe:
        _tell(observer, ProbeStarted(probed))
        seen = probe_profilers(experiment, task, interruption)
        seen.refuse_silent()
        return seen

    def prepare(known: Mapping[str, Any]) -> dict[str, Any]:
        return prepared_treatments(
            experiment, known, interruption, lambda what: _tell(observer, PreparationStarted(what))
        )

    is_probed = resumption.probe and experiment.parameters.probe
    probed = [profiler.name for profiler in probed_profilers(experiment)] if is_probed else []
    with (
        Interruption() as interruption,
        ProgressManager(experiment, resumption, probe if probed else None, prepare) as progress,
    ):
        return _Orchestrator(experiment, progress, interruption, observer).execute(findings)


def _findings_of(error: BaseException) -> Sequence[Finding]:
    if isinstance(error, RobotRunnerError):
        return error.findings
    return (Finding.error("", f"{type(error).__name__}: {error}", ""),)


def _tell(observer: Observer, notice: Notice) -> None:
    try:
        observer.notice(notice)
    except Exception:  # noqa: BLE001 - a screen may fail in any way
        _log.exception("The screen failed; the experiment goes on.")


class _Orchestrator:
    def __init__(
        self,
        experiment: Experiment,
        progress: ProgressManager,
        interruption: Interruption,
        observer: Observer,
    ) -> None:
        self._experiment = experiment
        self._parameters = experiment.parameters
        self._progress = progress
        self._interruption = interruption
        self._observer = observer
        self._executor = executor_for(experiment)
        patience = Patience(interruption, self._while_waiting, observer.refresh_interval or _LOOK_AT_TABLE)
        self._events = OrchestratorEvents(experiment, progress, patience)
        self._operator = Operator(experiment, progress, observer.user_input, self._notice, patience)
        self._between_runs = BetweenRuns(
            experiment, progress, self._events, self._operator, observer, self._notice, patience
        )
        self._gates = Gates(experiment, progress, self._notice, patience)
        self._notifications = Notifications(experiment, progress.note)
        self._started = time.monotonic()
        self._stopped_by = ""

    def execute(self, findings: Sequence[Finding]) -> ExperimentFinished:
        """Execute the runs between `before_experiment` and `after_experiment`; the latter comes whatever happens."""
        self._notice(self._start_notice(findings))
        try:
            self._execute_between_events(findings)
        except BaseException as error:
            self._notifications.tell_failure(_findings_of(error)[0])
            self._notifications.findings(self._interruption)
            raise
        finished = self._finish_notice(findings)
        self._progress.finish(interrupted=finished.interrupted)
        self._notifications.take(finished)
        untold = self._notifications.findings(self._interruption)
        finished = replace(finished, findings=(*finished.findings, *untold))
        self._notice(finished)
        return finished

    def _execute_between_events(self, findings: Sequence[Finding]) -> None:
        try:
            returned = self._events.emit_to_experiment(RobotRunnerEvents.BEFORE_EXPERIMENT)
            self._execute_runs(is_cleared=any(value is True for value in returned))
        except BaseException as error:
            self._end_after(error, findings)
            raise
        self._end_events(findings)

    def _end_after(self, error: BaseException, findings: Sequence[Finding]) -> None:
        """Emit `after_experiment` after what ended the experiment; where that raises as well, both are told.

        Raises:
            ExecutionError: both raised.
        """
        found = _findings_of(error)
        try:
            self._end_events(findings, failure=str(found[0]))
        except ExecutionError as later:
            raise ExecutionError.of_findings([*found, *later.findings]) from error

    def _end_events(self, findings: Sequence[Finding], *, failure: str = "") -> None:
        with suppress(StorageError):  # said again when everything is brought up to date
            self._progress.bring_table_up_to_date()
        finished = self._finish_notice(findings)
        ended = ExperimentEnd(
            done=finished.done_count,
            failed=finished.failed_count,
            todo=finished.todo_count,
            is_interrupted=finished.interrupted,
            is_stopped_by_policy=finished.stopped_by_policy,
            failure=failure,
            failures=finished.failures,
            findings=finished.findings,
        )
        self._events.emit_to_experiment(RobotRunnerEvents.AFTER_EXPERIMENT, ended)

    def _execute_runs(self, *, is_cleared: bool) -> None:
        gc.collect()
        gc.freeze()  # what a forked run does not collect it does not have to copy
        try:
            finished = None
            for run in self._runs():
                self._between_runs.prepare(run, finished, is_cleared=is_cleared and finished is None)
                if self._interruption.is_requested or not self._execute_run(run):
                    return
                finished = run
        finally:
            gc.unfreeze()

    def _runs(self) -> Iterator[PendingRun]:
        """Yield the runs to execute: those that are left, then a repetition at a time until all is precise."""
        begun = 0
        while True:
            for run in self._progress.pending(begun):
                begun += 1
                yield run
            judged = self._progress.repeat()
            if judged is not None:
                self._notice(judged)
            if judged is None or not judged.added:
                return

    def _execute_run(self, run: PendingRun) -> bool:
        """Try to execute a run as often as the config allows; return whether the experiment goes on."""
        for attempts_left in reversed(range(self._parameters.attempts)):
            if attempts_left < self._parameters.attempts - 1:
                self._between_runs.prepare_again(run)
            passage = Passage() if self._interruption.is_requested else self._gates.pass_before(run)
            if self._interruption.is_requested or self._is_stopped_by(passage.stop, run):
                return False
            entered = self._operator.answers(run.run_id)
            task = replace(self._progress.begin(run), attempts_left=attempts_left, entered=entered)
            self._notice(AttemptStarted(task, self._progress.time_left))
            outcome = self._attempt(task, passage, has_attempts_left=attempts_left > 0)
            is_last = attempts_left == 0 or outcome.status is not AttemptStatus.FAILED or bool(self._stopped_by)
            noticed = self._progress.record_outcome(task, outcome, is_last=is_last)
            self._notice(AttemptFinished(task, outcome, is_last, self._progress.time_left))
            if noticed:
                self._notice(FindingsNoticed(noticed))
            if is_last:
                break
        if outcome.status is AttemptStatus.FAILED and self._parameters.on_failure is FailurePolicy.STOP:
            self._stopped_by = self._stopped_by or "on_failure"
        return outcome.status is not AttemptStatus.INTERRUPTED and not self._stopped_by

    def _is_stopped_by(self, reason: str, run: PendingRun) -> bool:
        """Stop the experiment where there is a reason to; the run that it was about to execute is still to do."""
        if reason:
            self._stopped_by = "a gate"
            fix = "See to it, and start the experiment again: it resumes."
            self._progress.find(Finding.warning(f"before {run.run_id}", f"stopped, as {reason}", fix))
        return bool(reason)

    def _attempt(self, task: RunTask, passage: Passage, *, has_attempts_left: bool) -> RunOutcome:
        builder = OutcomeBuilder(
            task.run_id,
            self._experiment.columns,
            on_bad_value=self._parameters.on_bad_value,
            has_attempts_left=has_attempts_left,
        )

        def report(kind: str, fields: dict[str, Any]) -> None:
            self._progress.record(task, kind, fields)
            self._notice(RunRecord(task.run_id, kind, fields))
            if kind == "guard" and fields["action"] == GuardAction.STOP.value:
                self._stopped_by = "a guard"

        def report_own(kind: str, fields: dict[str, Any]) -> None:
            builder.take(kind, fields)
            report(kind, fields)

        self._operator.hand_over(task, report_own)
        passage.report_to(report_own, [column.name for column in self._experiment.columns.declared])
        self._bind_plugins(task, report_own)
        if not builder.has_failed:
            self._events.emit_to_run(RobotRunnerEvents.BEFORE_RUN, task, report_own)
        if builder.has_failed or self._interruption.is_requested:
            return builder.outcome(interrupted=self._interruption.is_requested)
        watch = Watch(
            interruption=self._interruption,
            report=report,
            refresh=self._refresh,
            refresh_interval=self._observer.refresh_interval,
            noticed_interruption=lambda: self._notice(InterruptionNoticed(task.run_id)),
            tend=self._progress.tend_table,
        )
        return self._executor.execute(task, builder, watch)

    def _bind_plugins(self, task: RunTask, report: Report) -> None:
        """Build plugins with bound parameters with the treatments of a run; what they raise fails the run."""
        for plugin in self._experiment.plugins:
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

    def _start_notice(self, findings: Sequence[Finding]) -> ExperimentStarted:
        columns = self._experiment.columns.in_table
        return ExperimentStarted(
            experiment_name=self._parameters.experiment_name,
            folder=self._experiment.folder.root,
            run_count=self._progress.run_count,
            done_count=self._progress.done_count,
            seed=self._progress.seed,
            columns={column.name: column.measure.unit for column in columns if not column.tells_of},
            asked_for=[column.name for column in columns if column.owner == OPERATOR_OWNER],
            overrides=self._experiment.overrides,
            findings=(*findings, *self._progress.findings),
            left=self._progress.time_left,
        )

    def _finish_notice(self, findings: Sequence[Finding]) -> ExperimentFinished:
        progress = self._progress
        return ExperimentFinished(
            folder=self._experiment.folder.root,
            run_table=self._experiment.folder.run_table,
            done_count=progress.done_count,
            failed_count=len(progress.failed),
            todo_count=progress.todo_count,
            failed=progress.failed,
            failures=progress.failures,
            interrupted=self._interruption.is_requested,
            stopped_by_policy=bool(self._stopped_by),
            stopped_by=self._stopped_by,
            findings=(*findings, *progress.findings),
            seconds=time.monotonic() - self._started,
            excluded=progress.excluded,
        )

    def _notice(self, notice: Notice) -> None:
        _tell(self._observer, notice)
        if not isinstance(notice, ExperimentFinished):  # which is told once everything is on the disk
            self._notifications.take(notice)

    def _while_waiting(self) -> None:
        if self._observer.refresh_interval is not None:
            self._refresh()
        self._progress.tend_table()

    def _refresh(self) -> None:
        try:
            self._observer.refresh()
        except Exception:  # noqa: BLE001 - a screen may fail in any way
            _log.exception("The screen failed; the experiment goes on.")
