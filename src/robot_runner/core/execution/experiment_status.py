"""How far an experiment has come, from its folder alone; and `continue`, for one that waits for a person."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robot_runner.core.config.operator_steps import Question
from robot_runner.core.design.asking import HOW_OFTEN, WHICH_RUNS
from robot_runner.core.design.precision import rule_in_words, rules_of_mapping
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.durations import Durations, TimeLeft
from robot_runner.core.execution.experiment_history import ExperimentHistory, Session
from robot_runner.core.execution.left_systems import may_be_moving
from robot_runner.core.execution.places import InFlight
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import moved_in_words, moved_runs, unrecorded_findings
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import Holder, holder_of, is_requested, send_continue, take_request
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.words import enumerated


@dataclass(frozen=True, slots=True)
class ExperimentStatus:
    """How far an experiment has come.

    Attributes:
        holder: who executes it at this moment, or None.
        is_waiting_for_user: whether it waits for `robot-runner continue`.
        waiting_for: what it waits for then: `next_run`, `place` (empty where there is no other), `step` (empty where
            it only asks whether the run may start), and `questions` as plain data; None while it does not wait.
        current_run, current_event: what is being executed, or None; of several runs the one that began last.
        in_flight: each run that is being executed, with its place where there are several.
        failures: why each failed run failed, one line each.
        todo: how many runs are left to be executed; those that are excluded do not count, neither here nor in `failed`.
        started_at: when its last session began (UTC).
        finished_at: when it ended last (UTC), or None while it is executed or if it was killed.
        seconds_left: how long the runs take that are still to be executed, as it was estimated last; None where that is
            not known, or nothing is left.
        left_is_least: whether something comes on top of that whose duration is not known.
        gates: each gate that is awaited at this moment: its run, condition, what was `seen` of it at the time `at` (at
            most a minute ago), and for how many `seconds` it had been awaited then.
        gate_seconds: how long gates were awaited in all, s of their clocks.
        bad_values: the runs that are done whose values are not good, by measure and quality.
        warm_ups_done: how many of these are done.
        batches: how many runs each batch has, in order, where the experiment was extended; warm-up runs left out.
        is_paused: whether somebody paused it; `robot-runner continue` goes on.
        pause_is_requested: whether it is to pause before the next run.
        is_imported: whether the results were executed elsewhere and imported: nothing can be executed here.
        is_of_older_tool: whether another tool executed what is there.
        repeated: until when combinations are repeated, and how often at least and at most; empty where they are not.
        precision: how precise the experiment was when it was looked at last, for each rule, in words.
        decided: what its design decided last and why, or what it will decide; empty where it decides nothing.
        follows: what is decided once the planned runs are done, in words; empty where nothing is, or no runs follow.
        lacks_plan: whether nothing on disk tells how many runs are planned: then `todo` has those that are known of.
        order: how many runs were executed out of the order of the run table; empty where none was.
    """

    experiment_name: str
    folder: Path
    holder: Holder | None
    is_waiting_for_user: bool
    run_count: int
    done: int
    failed: int
    todo: int
    current_run: str | None = None
    current_event: str | None = None
    failures: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    started_at: str | None = None
    finished_at: str | None = None
    seconds_left: float | None = None
    left_is_least: bool = False
    bad_values: Mapping[str, Mapping[str, Sequence[str]]] = field(default_factory=lambda: MappingProxyType({}))
    warm_ups: int = 0
    warm_ups_done: int = 0
    batches: tuple[int, ...] = ()
    sessions: tuple[Session, ...] = ()
    excluded: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    is_paused: bool = False
    pause_is_requested: bool = False
    is_imported: bool = False
    is_of_older_tool: bool = False
    lacks_plan: bool = False
    order: str = ""
    repeated: str = ""
    precision: tuple[str, ...] = ()
    decided: str = ""
    follows: str = ""
    gates: tuple[Mapping[str, Any], ...] = ()
    gate_seconds: float = 0.0
    waiting_for: Mapping[str, Any] | None = None
    in_flight: tuple[InFlight, ...] = ()

    @property
    def moment_of_pause(self) -> str:
        """When a pause that is requested now begins, in words."""
        return f"after {self.runs_now}" if self.in_flight else "before the next run"

    @property
    def closed_first(self) -> str:
        """The effect of a stop now on the runs that are being executed, in words; empty where there are none."""
        verb = "are" if len(self.in_flight) > 1 else "is"
        return f"{self.runs_now} {verb} closed first, and {verb} to be done again" if self.in_flight else ""

    @property
    def runs_now(self) -> str:
        """The runs that are being executed, in words; empty for none."""
        return enumerated([each.run for each in self.in_flight])


def read_status(folder: Path) -> ExperimentStatus:
    """Read how far an experiment has come; nothing is changed by asking.

    Raises:
        StorageError: there is no experiment in this folder, or it cannot be read.
    """
    files = ExperimentFolder.found_at(folder)
    if not files.manifest.exists() and files.run_table.exists():
        return _older_status(files)
    history = ExperimentHistory()
    history.read(files)
    return status_of(files, history)


def status_of(files: ExperimentFolder, history: ExperimentHistory) -> ExperimentStatus:
    """Return the present progress of an experiment, by its journal and its run table as they were read.

    Raises:
        StorageError: the manifest cannot be read.
    """
    manifest = read_manifest(files.manifest)
    statuses, out = history.statuses, history.excluded
    counting = {run: status for run, status in statuses.items() if run not in out}
    holder = holder_of(files.lock)
    # Of one that has only just taken the lock, the journal still tells what was going on when the one before it died.
    goes_on = holder is not None and (not holder.pid or history.pid in {None, holder.pid})
    repeated = rule_in_words(*rules_of_mapping(manifest.get("repeat_until")))
    decides = str((manifest.get("design", {}).get("facts") or {}).get("decides", ""))
    is_settled = history.is_decided or manifest.get("design", {}).get("source", "config") != "config"
    follows = "" if is_settled else HOW_OFTEN if repeated else WHICH_RUNS if decides else ""
    is_imported = manifest.get("origin") == "imported"
    left = history.left if holder is not None or is_imported else _time_left(files, history, follows)
    done = [run for run, status in statuses.items() if status is RunStatus.DONE]
    # While it is executed, the end of a run may have been recorded since the journal was read.
    lost = () if holder is not None else unrecorded_findings(files.journal, done, history.ended, manifest)
    return ExperimentStatus(
        experiment_name=manifest.get("experiment_name", files.root.name),
        folder=files.root,
        holder=holder,
        is_waiting_for_user=goes_on and history.waiting_for is not None,
        run_count=len(statuses) + history.unlisted,
        done=_count(statuses, RunStatus.DONE),
        failed=_count(counting, RunStatus.FAILED),
        todo=_count(counting, RunStatus.TODO, RunStatus.RUNNING) + history.unlisted,
        current_run=history.in_flight[-1].run if goes_on and history.in_flight else None,
        current_event=history.in_flight[-1].event if goes_on and history.in_flight else None,
        in_flight=history.in_flight if goes_on else (),
        failures=tuple(
            f"{run}: {reason}" for run, reason in history.failures.items() if counting.get(run) is RunStatus.FAILED
        ),
        findings=(*history.findings, *lost, *(() if holder else history.left_after), *may_be_moving(files)),
        started_at=history.started_at,
        finished_at=history.finished_at,
        seconds_left=left.after(history.since_left if holder else 0.0) if left is not None else None,
        left_is_least=left is not None and left.is_least,
        bad_values=history.bad_values,
        waiting_for=history.waiting_for if goes_on else None,
        warm_ups=len(history.warm_ups),
        warm_ups_done=sum(statuses.get(run) is RunStatus.DONE for run in history.warm_ups),
        batches=tuple(each.get("runs", 0) for each in manifest.get("design", {}).get("batches", ())),
        sessions=tuple(history.sessions),
        excluded=out,
        is_paused=goes_on and history.is_paused,
        pause_is_requested=holder is not None and is_requested(files.pause),
        is_imported=is_imported,
        lacks_plan=history.lacks_plan,
        order=moved_in_words(moved_runs(list(statuses), history.executed), history.executed),
        repeated=repeated,
        precision=history.precision,
        decided=history.decided or decides,
        follows=follows,
        gates=tuple(history.gates.values()) if goes_on else (),
        gate_seconds=history.gate_seconds,
    )


def _older_status(files: ExperimentFolder) -> ExperimentStatus:
    """Return how far an earlier tool came, by its run table, which is all there is.

    Raises:
        StorageError: the run table cannot be read.
    """
    rows = read_run_table(files.run_table, TableLayout((), stamps=()))
    return ExperimentStatus(
        experiment_name=files.root.name,
        folder=files.root,
        holder=None,
        is_waiting_for_user=False,
        run_count=len(rows),
        done=rows.count(RunStatus.DONE),
        failed=rows.count(RunStatus.FAILED),
        todo=rows.count(RunStatus.TODO) + rows.count(RunStatus.RUNNING),
        is_of_older_tool=True,
    )


def _count(statuses: Mapping[str, RunStatus], *wanted: RunStatus) -> int:
    return sum(status in wanted for status in statuses.values())


def _time_left(files: ExperimentFolder, history: ExperimentHistory, follows: str) -> TimeLeft | None:
    """Return how long the runs take that are not done; a lower bound where `follows` says that others may follow."""
    out = history.excluded
    unfinished = [run for run, status in history.statuses.items() if not (status is RunStatus.DONE or run in out)]
    if not unfinished:
        return None
    durations = Durations()
    durations.learn_from(files.journal)
    durations.plan((history.combinations[run] for run in unfinished if run in history.combinations), follows=follows)
    return durations.left()


#: How long the experiment may take the request, in seconds; it looks several times a second.
_PATIENCE = 5.0
_LOOK = 0.05


def questions_of(status: ExperimentStatus) -> list[Question]:
    """Return the questions that an experiment waits on at this moment."""
    asked = status.waiting_for["questions"] if status.waiting_for else ()
    return [Question.from_mapping(facts) for facts in asked]


def _left(status: ExperimentStatus) -> int:
    return status.todo + status.failed


def require_executed(status: ExperimentStatus, where: str, what: str) -> None:
    """Raise an `ExecutionError` if the experiment is not being executed."""
    if status.holder is None:
        fix = f"{what}; {'`robot-runner run` with its config goes on' if _left(status) else 'all its runs are done'}."
        raise ExecutionError("the experiment is not being executed", where=where, fix=fix)


def require_waiting(status: ExperimentStatus, where: str) -> None:
    """Require that the experiment waits for a person.

    Raises:
        ExecutionError: it does not; the problem says what it does.
    """
    if status.holder is None:
        can_go_on = "Start it with `robot-runner run` and its config: it resumes."
        fix = can_go_on if _left(status) else "All its runs are done."
        raise ExecutionError("the experiment is not being executed", where=where, fix=fix)
    if not status.is_waiting_for_user:
        doing = f"executes {status.runs_now}" if status.in_flight else "is between two runs"
        problem = f"the experiment does not wait: process {status.holder.pid} on {status.holder.host} {doing}"
        fix = "Wait until it asks; without steps for the operator, and in AUTO mode, it never does."
        raise ExecutionError(problem, where=where, fix=fix)


def continue_and_see(
    files: ExperimentFolder, waiting_for: Mapping[str, Any] | None, answers: Mapping[str, str], where: str
) -> None:
    """Send `continue` to a waiting experiment, and wait until it has taken the request.

    `waiting_for` is what the person was asked: the request is for that question alone. The answers are by name; `where`
    names the experiment in the error.

    Raises:
        StorageError: the folder cannot be written.
        ExecutionError: the request was not taken within five seconds; it was taken back.
    """
    asked = None if waiting_for is None else (str(waiting_for["next_run"]), str(waiting_for["step"]))
    send_continue(files.control, answers, asked)
    end = time.monotonic() + _PATIENCE
    try:
        while files.control.exists() and time.monotonic() <= end:
            time.sleep(_LOOK)
    finally:  # a request that was reported as not taken must not move the robot later
        was_left = take_request(files.control, asked) is not None
    if was_left or files.control.exists():
        raise ExecutionError(
            f"the experiment has not taken the request within {_PATIENCE:g} s; it was taken back",
            where=where,
            fix="Look at what it waits for now (robot-runner status): somebody else may have answered. If it is "
            "still the same, press ENTER in its own terminal.",
        )
