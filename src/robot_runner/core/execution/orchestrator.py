"""The experiment orchestrator: executes each run of the run table and returns how it went (paper, II.C)."""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from robot_runner.core.config.claims import Claims, held_claims
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.operator_steps import asked_after
from robot_runner.core.errors import ExecutionError, Finding, RobotRunnerError, StorageError
from robot_runner.core.events.context import ExperimentEnd
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.events.measure import OPERATOR_OWNER
from robot_runner.core.events.resources import closing_left_open
from robot_runner.core.execution.before_first_run import prepared_treatments
from robot_runner.core.execution.callback_claims import callback_claims
from robot_runner.core.execution.clock_jumps import NotedSettings
from robot_runner.core.execution.going_on import goes_on
from robot_runner.core.execution.inherited_state import note_open_files
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.left_systems import see_to_what_others_left, told_if_refused
from robot_runner.core.execution.local_places import places_of
from robot_runner.core.execution.notices import (
    ExperimentFinished,
    ExperimentStarted,
    Notice,
    Observer,
    PreparationStarted,
    ProbeStarted,
)
from robot_runner.core.execution.notifications import Notifications
from robot_runner.core.execution.orchestrator_events import OngoingExperiment, OrchestratorEvents
from robot_runner.core.execution.poll_loop import PollLoop
from robot_runner.core.execution.probe import Probe, probe_profilers, probed_profilers
from robot_runner.core.execution.progress_manager import ProgressManager
from robot_runner.core.execution.resumption import Resumption, edited_meanwhile
from robot_runner.core.execution.side_by_side import SideBySide
from robot_runner.core.execution.task import RunTask
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.lock import forget_requests, is_requested

_log = logging.getLogger(__name__)
#: How often it is checked whether there is a request to stop, s: it is a file, which cannot be polled.
_LISTEN = 0.5

#: How often it is checked whether another experiment has released its claims, s.
_LOOK_AT_CLAIMS = 0.5


def execute_experiment(
    experiment: Experiment,
    observer: Observer,
    *,
    findings: Sequence[Finding] = (),
    resumption: Resumption | None = None,
    waits_for_claims: bool = False,
) -> ExperimentFinished:
    """Execute every run that is not done, and return how the experiment ended.

    Call it in the main thread: while it lasts, SIGINT, SIGTERM and SIGHUP end the experiment cleanly.

    Args:
        experiment: a config without errors.
        observer: gets a notice of everything that happens.
        findings: of validation; they are shown again at the end.
        resumption: what to execute again, and whether to go on though something changed.
        waits_for_claims: whether to wait where another experiment holds a claim; else this one is refused.

    Raises:
        KeyboardInterrupt: the user interrupted while it waited for claims.
        RobotRunnerError: the experiment cannot start (another process executes it, its folder cannot be written, the
            config or the run table on disk changed, a profiler does not measure) or cannot go on (the disk is full).
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

    told_of: set[str] = set()

    def wait(refused: Sequence[Finding]) -> None:
        for finding in refused:
            if finding.problem not in told_of:
                told_of.add(finding.problem)
                _tell(observer, PreparationStarted(f"Waiting for claims: {finding.problem}"))
        time.sleep(_LOOK_AT_CLAIMS)
        if interruption.is_requested:
            raise KeyboardInterrupt

    is_probed = resumption.probe and experiment.parameters.probe
    probed = [profiler.name for profiler in probed_profilers(experiment)] if is_probed else []
    claims = Claims(experiment.parameters, experiment.plugins, experiment.events)
    held = held_claims(claims, experiment.model)
    name = experiment.parameters.experiment_name
    earlier: dict[Path, None] = {}

    def is_at_work(root: Path) -> bool:
        earlier[root] = None
        return goes_on(root, counts_orphans=False)  # those are ended, see below

    with (
        Interruption() as interruption,
        HeldClaims(held, name, experiment.folder.root, wait if waits_for_claims else None, is_at_work) as holding,
        ExitStack() as opened,
    ):
        with told_if_refused() as seen_to:
            seen_to.extend(see_to_what_others_left(experiment, earlier, held))
            holding.forget_earlier()
            progress = ProgressManager(experiment, resumption, probe if probed else None, prepare)
            opened.enter_context(progress)
        opened.enter_context(callback_claims(experiment, lambda: held, progress.find))
        told = (*findings, *holding.findings, *seen_to)
        return _Orchestrator(experiment, progress, interruption, observer, claims).execute(told)


@contextmanager
def _closing_left_open() -> Iterator[None]:
    """Close at the end what callbacks of the experiment left open; what fails there is an error of the experiment.

    Raises:
        RobotRunnerError: something cannot be closed; it has the error that ended the block, too.
    """
    ended_by: BaseException | None = None
    try:
        with closing_left_open():
            try:
                yield
            except BaseException as error:
                ended_by = error
                raise
    except Exception as error:
        if error is ended_by or (ended_by is None and isinstance(error, RobotRunnerError)):
            raise
        found = [*_findings_of(ended_by)] if isinstance(ended_by, Exception) else []
        for each in _findings_of(error):
            problem = f"what a callback of the experiment left open cannot be closed: {each.problem}"
            fix = each.fix or "If it is the link to a robot, see that it stands still. The results are whole."
            found.append(Finding.error(each.where or "experiment", problem, fix))
        raise ExecutionError.of_findings(found) from error


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
        claims: Claims,
    ) -> None:
        self._experiment = experiment
        self._parameters = experiment.parameters
        self._progress = progress
        self._interruption = interruption
        self._observer = observer
        poll_loop = PollLoop(interruption, self._refresh, observer.refresh_interval, self._tend)
        self._notifications = Notifications(experiment, progress.note)
        self._clock = NotedSettings(progress.note)
        self._started = time.monotonic()
        self._stop_request = experiment.folder.stop
        self._places = places_of(experiment, claims, progress.combinations_left)
        has_one_place = len(self._places.all) == 1
        is_alone = has_one_place and self._parameters.cluster is None  # then no two runs can clash
        is_one_at_a_time = self._parameters.robots and claims.common(progress.combinations_left)
        progress.expect_places(1 if is_one_at_a_time else max(1, len(self._places.all)))
        events = OrchestratorEvents(experiment, progress, poll_loop)
        self._ongoing = OngoingExperiment(
            experiment, progress, events, observer, self._notice, poll_loop, self._clock, has_one_place=has_one_place
        )
        self._side_by_side = SideBySide(
            self._ongoing,
            self._places,
            lambda task, robot: frozenset(() if is_alone else claims.of(task.combination, robot)),
        )

    def execute(self, findings: Sequence[Finding]) -> ExperimentFinished:
        """Execute the runs between `before_experiment` and `after_experiment`; the latter comes whatever happens."""
        self._notice(self._start_notice(findings))
        try:
            with _closing_left_open():
                self._execute_between_events(findings)
        except BaseException as error:
            self._notifications.tell_failure(_findings_of(error)[0])
            self._notifications.findings(self._interruption)
            with suppress(OSError):
                if self._experiment.folder.journal.exists():  # what is done is still there
                    self._notice(self._finish_notice(findings))
            raise
        self._progress.find(*self._clock.look())
        # After an interruption the next execution looks, before it goes on; workers of a cluster have copies.
        if not (self._interruption.is_requested or self._parameters.cluster is not None):
            self._progress.find(*edited_meanwhile(self._experiment))
            self._progress.look_at_packages()
        finished = self._finish_notice(findings)
        self._progress.finish(interrupted=finished.interrupted)
        self._notifications.take(finished)
        untold = self._notifications.findings(self._interruption)
        finished = replace(finished, findings=(*finished.findings, *untold))
        self._notice(finished)
        return finished

    def _execute_between_events(self, findings: Sequence[Finding]) -> None:
        try:
            with closing(self._places):
                self._tend()
                if self._interruption.is_requested:  # during preparation: nothing was opened yet
                    return
                returned = self._ongoing.events.emit_to_experiment(RobotRunnerEvents.BEFORE_EXPERIMENT)
                self._execute_runs(is_cleared=any(value is True for value in returned))
        except BaseException as error:
            self._end_after(error, findings)
            raise
        self._end_events(findings)

    def _end_after(self, error: BaseException, findings: Sequence[Finding]) -> None:
        """Emit `after_experiment` after the error that ended the experiment; if that raises, too, both are reported.

        Only the first error is reported where the folder cannot be written any more.

        Raises:
            ExecutionError: both raised.
        """
        found = _findings_of(error)
        try:
            with suppress(StorageError):
                self._end_events(findings, failure=str(found[0]))
        except ExecutionError as later:
            raise ExecutionError.of_findings([*found, *later.findings]) from error

    def _end_events(self, findings: Sequence[Finding], *, failure: str = "") -> None:
        with suppress(StorageError):  # raised again by `ProgressManager.finish`
            self._progress.bring_table_up_to_date()
        finished = self._finish_notice(findings)
        ended = ExperimentEnd(
            done=finished.done_count,
            failed=finished.failed_count,
            todo=finished.todo_count,
            is_interrupted=finished.interrupted,
            is_stopped_by_policy=bool(finished.stopped_by),
            failure=failure,
            failures=finished.failures,
            findings=finished.findings,
        )
        self._ongoing.events.emit_to_experiment(RobotRunnerEvents.AFTER_EXPERIMENT, ended)

    def _execute_runs(self, *, is_cleared: bool) -> None:
        """Execute the runs that are left, then those that follow from the results, until nothing follows."""
        note_open_files()
        gc.collect()
        gc.freeze()  # a forked run does not collect these objects, and so does not copy their pages
        try:
            while self._side_by_side.execute(is_cleared=is_cleared):
                decided = self._progress.decide()
                if decided is not None:
                    self._notice(decided)
                if decided is None or not decided.added:
                    return
        finally:
            gc.unfreeze()

    def _start_notice(self, findings: Sequence[Finding]) -> ExperimentStarted:
        columns = self._experiment.columns.in_table
        told_later = asked_after(self._parameters.operator_steps)
        return ExperimentStarted(
            experiment_name=self._parameters.experiment_name,
            folder=self._experiment.folder.root,
            run_count=self._progress.run_count,
            done_count=self._progress.done_before,
            seed=self._progress.seed,
            columns={
                column.name: column.measure.unit
                for column in columns
                if not (column.tells_of or (column.owner == OPERATOR_OWNER and column.measure.name in told_later))
            },
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
            stopped_by=self._ongoing.stopped_by,
            findings=(*findings, *progress.findings),
            seconds=time.monotonic() - self._started,
            excluded=progress.excluded,
        )

    def _tend(self) -> float:
        """Do the work that is due during a wait; return in how many seconds to call this again."""
        if is_requested(self._stop_request) and not self._interruption.is_requested:
            self._interruption.request()  # first: the robot has to stop even if the record cannot be written
            self._progress.note("stop_requested", flush=True)
            forget_requests(self._stop_request)
        self._clock.take()
        due = self._progress.tend_table()
        return _LISTEN if due is None else min(due, _LISTEN)

    def _notice(self, notice: Notice) -> None:
        _tell(self._observer, notice)
        if not isinstance(notice, ExperimentFinished):  # that one is sent by `execute`, once everything is on the disk
            self._notifications.take(notice)

    def _refresh(self) -> None:
        try:
            self._observer.refresh()
        except Exception:  # noqa: BLE001 - a screen may fail in any way
            _log.exception("The screen failed; the experiment goes on.")
