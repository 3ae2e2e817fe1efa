"""How far an experiment has come, from its folder alone, also while it is executed."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import Quality, quality_of_value
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import Holder, holder_of
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

__all__ = ["ExperimentStatus", "read_status"]


@dataclass(frozen=True, slots=True)
class ExperimentStatus:
    """How far an experiment has come.

    Attributes:
        holder: who executes it at this moment, or None.
        is_waiting_for_user: whether it waits for `robot-runner continue`.
        current_run, current_event: what is being executed, or None.
        failures: why each failed run failed, one line each.
        findings: what looked odd.
        finished_at: when it ended last (UTC), or None while it is executed or if it was killed.
        bad_values: the runs that are done whose values are not good, by measure and quality.
        warm_ups: how many of the runs only warm up.
        warm_ups_done: how many of these are done.
        batches: how many runs each batch has, in order, where the experiment was extended; warm-up runs left out.
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
    bad_values: Mapping[str, Mapping[str, Sequence[str]]] = field(default_factory=lambda: MappingProxyType({}))
    warm_ups: int = 0
    warm_ups_done: int = 0
    batches: tuple[int, ...] = ()


def read_status(folder: Path) -> ExperimentStatus:
    """Read how far an experiment has come; nothing is changed by asking.

    Raises:
        StorageError: there is no experiment in this folder, or it cannot be read.
    """
    files = ExperimentFolder.found_at(folder)
    manifest = read_manifest(files.manifest)
    history = _History()
    history.read(files)
    statuses = history.statuses
    holder = holder_of(files.lock)
    return ExperimentStatus(
        experiment_name=manifest["experiment_name"],
        folder=folder,
        holder=holder,
        is_waiting_for_user=holder is not None and history.is_waiting,
        run_count=len(statuses),
        done=_count(statuses, RunStatus.DONE),
        failed=_count(statuses, RunStatus.FAILED),
        todo=_count(statuses, RunStatus.TODO, RunStatus.RUNNING),
        current_run=history.current_run if holder else None,
        current_event=history.current_event if holder else None,
        failures=tuple(
            f"{run}: {reason}" for run, reason in history.failures.items() if statuses.get(run) is RunStatus.FAILED
        ),
        findings=tuple(history.findings),
        started_at=history.started_at,
        finished_at=history.finished_at,
        bad_values=history.bad_values,
        warm_ups=len(history.warm_ups),
        warm_ups_done=sum(statuses.get(run) is RunStatus.DONE for run in history.warm_ups),
        batches=tuple(int(each["runs"]) for each in manifest.get("design", {}).get("batches", ())),
    )


def _count(statuses: Mapping[str, RunStatus], *wanted: RunStatus) -> int:
    return sum(status in wanted for status in statuses.values())


class _History:
    """What the run table and then the journal tell."""

    def __init__(self) -> None:
        self.statuses: dict[str, RunStatus] = {}
        self.failures: dict[str, str] = {}
        self.findings: list[Finding] = []
        self.warm_ups: set[str] = set()
        self.is_waiting = False
        self.current_run: str | None = None
        self.current_event: str | None = None
        self.started_at: str | None = None
        self.finished_at: str | None = None
        self._since_table: dict[str, RunStatus] = {}
        self._ends: dict[str, RunStatus] = {}
        self._measures: Collection[str] = ()
        self._qualities: dict[str, dict[str, Quality]] = {}

    def read(self, files: ExperimentFolder) -> None:
        # The journal comes first: a table written meanwhile is newer than what the journal adds to it, never older.
        for record in read_journal(files.journal):
            take = getattr(self, f"_take_{record['kind']}", None)
            if take is not None:
                take(record)
        if files.run_table.exists() and files.schema.exists():
            layout = TableLayout.of_schema(read_schema(files.schema))
            self._measures = layout.measures
            rows = read_run_table(files.run_table, layout)
            self.statuses = {rows.run_id(place): rows.status(place) for place in range(len(rows))}
            self.warm_ups = {run.run_id for run in rows.planned if run.is_warm_up}
            if not layout.spelling.tells_apart(RunStatus.TODO, RunStatus.FAILED):
                todo = {run for run, status in self.statuses.items() if status is RunStatus.TODO}
                failed = {run for run, end in self._ends.items() if end is RunStatus.FAILED}
                self.statuses |= dict.fromkeys(todo & failed, RunStatus.FAILED)
        self.statuses |= self._since_table

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
        self.is_waiting = False

    def _take_experiment_finished(self, record: Mapping[str, Any]) -> None:
        self.finished_at = record["at"]

    def _take_attempt_started(self, record: Mapping[str, Any]) -> None:
        self.current_run, self.current_event = record["run"], None

    def _take_event(self, record: Mapping[str, Any]) -> None:
        self.current_event = record["event"]

    def _take_attempt_finished(self, record: Mapping[str, Any]) -> None:
        ends = {"done": RunStatus.DONE, "failed": RunStatus.FAILED}
        self._ends[record["run"]] = self._since_table[record["run"]] = ends.get(record["status"], RunStatus.TODO)
        self.failures[record["run"]] = record["failure"] or ""
        told = {
            name: quality_of_value(each["value"], each.get("doubts", ())) for name, each in record["measures"].items()
        }
        self._qualities[record["run"]] = {name: each for name, each in told.items() if each is not Quality.GOOD}
        self.current_run = self.current_event = None

    def _take_table_written(self, record: Mapping[str, Any]) -> None:
        del record
        self._since_table.clear()

    def _take_deviation(self, record: Mapping[str, Any]) -> None:
        problem = f"{record['column']} was changed by hand from {record['was']!r} to {record['is']!r}"
        self.findings.append(Finding.warning(record["run"] or "run_table.csv", problem))

    def _take_finding(self, record: Mapping[str, Any]) -> None:
        where = f"{record['run']}, {record['owner']}"
        self.findings.append(Finding.warning(where, record["problem"], record["fix"]))

    def _take_waiting(self, record: Mapping[str, Any]) -> None:
        del record
        self.is_waiting = True

    def _take_continued(self, record: Mapping[str, Any]) -> None:
        del record
        self.is_waiting = False
