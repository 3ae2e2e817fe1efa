"""How far an experiment has come, from its folder alone, also while it is executed."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.precision import rule_in_words, rules_of_mapping
from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import Quality, quality_of_value
from robot_runner.core.execution.durations import Durations, TimeLeft
from robot_runner.core.execution.places import InFlight
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.excluded_runs import ExcludedRuns
from robot_runner.core.storage.executed_runs import moved_in_words, moved_runs
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import Holder, holder_of, pause_is_requested
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

__all__ = ["ExperimentStatus", "Session", "read_status"]


@dataclass(frozen=True, slots=True)
class Session:
    """One execution of the experiment, from its start to its end.

    Attributes:
        started_at: UTC.
        ended_at: when it ended, or, where it was killed or goes on, when something was last recorded of it (UTC).
        is_whole: whether it came to its end.
        selection: the runs that were chosen for it, by option.
    """

    started_at: str
    ended_at: str
    is_whole: bool = False
    selection: Mapping[str, Sequence[str]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def seconds(self) -> float:
        """How long it took, in seconds."""
        return max(0.0, (_moment(self.ended_at) - _moment(self.started_at)).total_seconds())


def _moment(stamp: str) -> datetime:
    return datetime.fromisoformat(stamp).astimezone(UTC)


@dataclass(frozen=True, slots=True)
class ExperimentStatus:
    """How far an experiment has come.

    Attributes:
        holder: who executes it at this moment, or None.
        is_waiting_for_user: whether it waits for `robot-runner continue`.
        waiting_for: what it waits for then: `next_run`, `step` (empty where it only asks whether the run may start),
            and `questions` as plain data; None while it does not wait.
        current_run, current_event: what is being executed, or None; of several runs the one that began last.
        in_flight: each run that is being executed, with its place where there are several.
        failures: why each failed run failed, one line each.
        findings: what looked odd.
        todo: how many runs are left to be executed; those that are excluded do not count, neither here nor in `failed`.
        started_at: when its last session began (UTC).
        finished_at: when it ended last (UTC), or None while it is executed or if it was killed.
        seconds_left: how long the runs take that are still to be executed, as it was estimated last; None where that is
            not known, or nothing is left.
        left_is_least: whether something comes on top of that of which nobody knew how long it takes.
        gate: the gate that is awaited at this moment, or None: its run, condition, what was `seen` of it at the time
            `at` (at most a minute ago), and for how many `seconds` it had been awaited then.
        gate_seconds: how long gates were awaited in all, s of their clocks.
        bad_values: the runs that are done whose values are not good, by measure and quality.
        warm_ups: how many of the runs only warm up.
        warm_ups_done: how many of these are done.
        batches: how many runs each batch has, in order, where the experiment was extended; warm-up runs left out.
        sessions: all its executions, the first one first.
        excluded: why runs are left out, by id.
        is_paused: whether somebody paused it; `robot-runner continue` goes on.
        pause_is_requested: whether it is to pause before the next run.
        is_of_older_tool: whether another tool executed what is there.
        repeated: until when combinations are repeated, and how often at least and at most; empty where they are not.
        precision: how precise the experiment was when it was looked at last, for each rule, in words.
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
    current_run: str | None
    current_event: str | None
    failures: tuple[str, ...]
    findings: tuple[Finding, ...]
    started_at: str | None
    finished_at: str | None
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
    is_of_older_tool: bool = False
    order: str = ""
    repeated: str = ""
    precision: tuple[str, ...] = ()
    gate: Mapping[str, Any] | None = None
    gate_seconds: float = 0.0
    waiting_for: Mapping[str, Any] | None = None
    in_flight: tuple[InFlight, ...] = ()


def read_status(folder: Path) -> ExperimentStatus:
    """Read how far an experiment has come; nothing is changed by asking.

    Raises:
        StorageError: there is no experiment in this folder, or it cannot be read.
    """
    files = ExperimentFolder.found_at(folder)
    if not files.manifest.exists() and files.run_table.exists():
        return _older_status(files)
    manifest = read_manifest(files.manifest)
    history = _History()
    history.read(files)
    statuses, out = history.statuses, history.excluded
    counting = {run: status for run, status in statuses.items() if run not in out}
    holder = holder_of(files.lock)
    left = _time_left(files, history, is_executed=holder is not None)
    return ExperimentStatus(
        experiment_name=manifest.get("experiment_name", files.root.name),
        folder=folder,
        holder=holder,
        is_waiting_for_user=holder is not None and history.waiting_for is not None,
        run_count=len(statuses) + history.unlisted,
        done=_count(statuses, RunStatus.DONE),
        failed=_count(counting, RunStatus.FAILED),
        todo=_count(counting, RunStatus.TODO, RunStatus.RUNNING) + history.unlisted,
        current_run=history.in_flight[-1].run if holder and history.in_flight else None,
        current_event=history.in_flight[-1].event if holder and history.in_flight else None,
        in_flight=history.in_flight if holder else (),
        failures=tuple(
            f"{run}: {reason}" for run, reason in history.failures.items() if counting.get(run) is RunStatus.FAILED
        ),
        findings=tuple(history.findings),
        started_at=history.started_at,
        finished_at=history.finished_at,
        seconds_left=left.after(history.since_left if holder else 0.0) if left is not None else None,
        left_is_least=left is not None and left.is_least,
        bad_values=history.bad_values,
        waiting_for=history.waiting_for if holder else None,
        warm_ups=len(history.warm_ups),
        warm_ups_done=sum(statuses.get(run) is RunStatus.DONE for run in history.warm_ups),
        batches=tuple(int(each["runs"]) for each in manifest.get("design", {}).get("batches", ())),
        sessions=tuple(history.sessions),
        excluded=out,
        is_paused=holder is not None and history.is_paused,
        pause_is_requested=holder is not None and pause_is_requested(files.pause),
        order=moved_in_words(moved_runs(list(statuses), history.executed), history.executed),
        repeated=rule_in_words(*rules_of_mapping(manifest.get("repeat_until"))),
        precision=history.precision,
        gate=history.gate if holder else None,
        gate_seconds=history.gate_seconds,
    )


def _older_status(files: ExperimentFolder) -> ExperimentStatus:
    """Return how far another tool came: its run table says so, and nothing else does.

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
        current_run=None,
        current_event=None,
        failures=(),
        findings=(),
        started_at=None,
        finished_at=None,
        is_of_older_tool=True,
    )


def _count(statuses: Mapping[str, RunStatus], *wanted: RunStatus) -> int:
    return sum(status in wanted for status in statuses.values())


def _time_left(files: ExperimentFolder, history: _History, *, is_executed: bool) -> TimeLeft | None:
    """Return what is left: as the orchestrator estimated it last, or of all runs that are not done."""
    if is_executed:
        return history.left
    out = history.excluded
    unfinished = [run for run, status in history.statuses.items() if not (status is RunStatus.DONE or run in out)]
    if not unfinished:
        return None
    durations = Durations()
    durations.learn_from(files.journal)
    durations.plan(history.combinations[run] for run in unfinished if run in history.combinations)
    return durations.left()


class _History:
    """What the run table and then the journal tell."""

    def __init__(self) -> None:
        self.statuses: dict[str, RunStatus] = {}
        self.failures: dict[str, str] = {}
        self.findings: list[Finding] = []
        self.waiting_for: dict[str, Any] | None = None
        self.warm_ups: set[str] = set()
        self.precision: tuple[str, ...] = ()
        self.is_paused = False
        self.sessions: list[Session] = []
        self._begun: dict[str, None] = {}
        self._excluded = ExcludedRuns()
        self.gate: dict[str, Any] | None = None
        self.gate_seconds = 0.0
        self._in_flight: dict[str, InFlight] = {}
        self.started_at: str | None = None
        self.finished_at: str | None = None
        self.combinations: dict[str, Mapping[str, Any]] = {}
        self.left: TimeLeft | None = None
        self._left_at = ""
        self._since_table: dict[str, RunStatus] = {}
        self._ends: dict[str, RunStatus] = {}
        self._planned = 0
        #: How many runs were never begun and are listed nowhere, as the run table is missing.
        self.unlisted = 0
        self._measures: Collection[str] = ()
        self._qualities: dict[str, dict[str, Quality]] = {}

    def read(self, files: ExperimentFolder) -> None:
        # The journal comes first: a table written meanwhile is newer than what the journal adds to it, never older.
        for record in read_journal(files.journal):
            if self.sessions:
                self.sessions[-1] = replace(self.sessions[-1], ended_at=record.get("at", self.sessions[-1].ended_at))
            self._excluded.take(record)
            take = getattr(self, f"_take_{record['kind']}", None)
            if take is not None:
                take(record)
        if files.run_table.exists() and files.schema.exists():
            layout = TableLayout.of_schema(read_schema(files.schema))
            self._measures = layout.measures
            rows = read_run_table(files.run_table, layout)
            self.statuses = {rows.run_id(place): rows.status(place) for place in range(len(rows))}
            self.warm_ups = {run.run_id for run in rows.planned if run.is_warm_up}
            self.combinations = {run.run_id: run.combination for run in rows.planned}
            if not layout.spelling.tells_apart(RunStatus.TODO, RunStatus.FAILED):
                todo = {run for run, status in self.statuses.items() if status is RunStatus.TODO}
                failed = {run for run, end in self._ends.items() if end is RunStatus.FAILED}
                self.statuses |= dict.fromkeys(todo & failed, RunStatus.FAILED)
        elif self._ends and not files.run_table.exists():
            self.statuses = dict(self._ends)
            self.unlisted = max(0, self._planned - len(self._ends))
            problem = "the run table is missing; the journal has what was executed"
            fix = "It is made anew when the experiment is executed next."
            self.findings.append(Finding.warning(str(files.run_table), problem, fix))
        self.statuses |= self._since_table

    @property
    def since_left(self) -> float:
        """How long ago the time left was estimated, s."""
        return max(0.0, time.time() - datetime.fromisoformat(self._left_at).timestamp())

    @property
    def in_flight(self) -> tuple[InFlight, ...]:
        return tuple(self._in_flight.values())

    @property
    def executed(self) -> list[str]:
        return list(self._begun)

    @property
    def excluded(self) -> dict[str, str]:
        return {run: each.reason for run, each in self._excluded.present.items() if run in self.statuses}

    @property
    def bad_values(self) -> dict[str, dict[str, list[str]]]:
        bad: dict[str, dict[str, list[str]]] = {}
        for run, qualities in self._qualities.items():
            for name, quality in qualities.items() if self.statuses.get(run) is RunStatus.DONE else ():
                if name in self._measures:
                    bad.setdefault(name, {}).setdefault(quality.value, []).append(run)
        return bad

    def _take_experiment_started(self, record: Mapping[str, Any]) -> None:
        self.started_at = record["at"]
        self.finished_at = None
        self._planned = int(record.get("runs", 0))
        self.gate = self.waiting_for = None
        self.is_paused = False
        self._in_flight.clear()
        self.sessions.append(Session(record["at"], record["at"], selection=record.get("selection", {})))

    def _take_experiment_finished(self, record: Mapping[str, Any]) -> None:
        self.finished_at = record["at"]
        self.sessions[-1] = replace(self.sessions[-1], is_whole=True)

    def _take_repeated(self, record: Mapping[str, Any]) -> None:
        self._planned += len(record["runs"])
        self._take_judged(record)

    def _take_judged(self, record: Mapping[str, Any]) -> None:
        self.precision = tuple(str(each["in_words"]) for each in record.get("precision", ()))

    def _take_attempt_started(self, record: Mapping[str, Any]) -> None:
        self._in_flight[record["run"]] = InFlight(record["run"], record.get("place", ""))
        self._take_left(record)
        if record.get("repetition") != 0:  # a warm-up run comes before each session, whatever the table's order
            self._begun.pop(record["run"], None)
            self._begun[record["run"]] = None

    def _take_event(self, record: Mapping[str, Any]) -> None:
        run = self._in_flight.get(record.get("run", ""))
        if run is not None:
            self._in_flight[run.run] = replace(run, event=record["event"])

    def _take_attempt_finished(self, record: Mapping[str, Any]) -> None:
        ends = {"done": RunStatus.DONE, "failed": RunStatus.FAILED}
        self.waiting_for = None
        self._ends[record["run"]] = self._since_table[record["run"]] = ends.get(record["status"], RunStatus.TODO)
        self.failures[record["run"]] = record["failure"] or ""
        told = {
            name: quality_of_value(each["value"], each.get("doubts", ())) for name, each in record["measures"].items()
        }
        self._qualities[record["run"]] = {name: each for name, each in told.items() if each is not Quality.GOOD}
        self._in_flight.pop(record["run"], None)
        self._take_left(record)

    def _take_left(self, record: Mapping[str, Any]) -> None:
        if record.get("status") != "interrupted":  # then the run is to do again, and what was left at its beginning is
            self.left = TimeLeft.of_facts(record.get("left"))
            self._left_at = record["at"]

    def _take_table_written(self, record: Mapping[str, Any]) -> None:
        del record
        self._since_table.clear()

    def _take_deviation(self, record: Mapping[str, Any]) -> None:
        problem = f"{record['column']} was changed by hand from {record['was']!r} to {record['is']!r}"
        self.findings.append(Finding.warning(record["run"] or "run_table.csv", problem))

    def _take_finding(self, record: Mapping[str, Any]) -> None:
        where = f"{record['run']}, {record['owner']}"
        self.findings.append(Finding.warning(where, record["problem"], record["fix"]))

    def _take_gate(self, record: Mapping[str, Any]) -> None:
        self.gate = None
        if record["state"] == "waiting":
            self.gate = {name: record[name] for name in ("run", "condition", "seen", "seconds", "at")}
        else:
            self.gate_seconds += record["seconds"]

    def _take_waiting(self, record: Mapping[str, Any]) -> None:
        if "next_run" in record:
            asked = record.get("questions", ())
            self.waiting_for = {"next_run": record["next_run"], "step": record.get("step", ""), "questions": asked}

    def _take_asked(self, record: Mapping[str, Any]) -> None:
        self.waiting_for = {"next_run": record["run"], "step": record["step"], "questions": ()}

    def _take_answered(self, record: Mapping[str, Any]) -> None:
        del record
        self.waiting_for = None

    def _take_continued(self, record: Mapping[str, Any]) -> None:
        del record
        self.waiting_for = None
        self.is_paused = False

    def _take_paused(self, record: Mapping[str, Any]) -> None:
        del record
        self.is_paused = True
