"""The run table in memory: made from the plan, or read from the folder and brought up to date from the journal."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.errors import ExecutionError, Finding
from robot_runner.execution.changes import table_differences
from robot_runner.execution.task import AttemptStatus, RunOutcome
from robot_runner.storage.journal import read_journal
from robot_runner.storage.run_status import RunStatus
from robot_runner.storage.run_table_reading import read_run_table
from robot_runner.storage.run_table_rows import RunTableRows
from robot_runner.storage.table_description import describe_columns
from robot_runner.storage.table_layout import ColumnRole
from robot_runner.storage.table_schema import ColumnDescription, read_schema, write_schema

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from robot_runner.config.experiment import Experiment

__all__ = ["RecoveredTable", "recover_table"]

_MOST_DIFFERENCES = 20
_ENDS = {AttemptStatus.DONE.value: RunStatus.DONE, AttemptStatus.FAILED.value: RunStatus.FAILED}


@dataclass(slots=True)
class RecoveredTable:
    """The run table of an experiment, as far as it has come.

    Attributes:
        rows: the table, kept up to date.
        attempts: how often each run was tried.
        failed: why each failed run failed.
        unfinished: the run whose attempt nobody saw the end of, or None.
        findings: what looked odd in the file.
    """

    experiment: Experiment
    rows: RunTableRows
    attempts: Counter[str] = field(default_factory=Counter)
    failed: dict[str, str] = field(default_factory=dict)
    unfinished: str | None = None
    findings: tuple[Finding, ...] = ()
    origins: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    _kinds: set[tuple[str, type]] = field(default_factory=set)
    doubts: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    def take_outcome(self, run_id: str, outcome: RunOutcome) -> bool:
        """Bring the row of a run up to date with how its attempt ended; returns whether a measure's type is new."""
        for measure in outcome.measures.values():
            self.origins[measure.name].add(measure.origin.value)
        for finding in outcome.findings:
            self.doubts[finding.where.partition(", ")[2]].add(f"{run_id}: {finding.problem}")
        values = {name: measure.value for name, measure in outcome.measures.items()}
        self._record(run_id, outcome.status.value, outcome.stamps, values)
        kinds = {(name, type(value)) for name, value in values.items() if value is not None}
        has_new = not kinds <= self._kinds
        self._kinds |= kinds
        return has_new

    def take_record(self, record: Mapping[str, Any]) -> None:
        """Bring the row of a run up to date with how the journal says that its attempt ended."""
        measures = record["measures"]
        values = {name: measure["value"] for name, measure in measures.items()}
        self._record(record["run"], record["status"], record["stamps"], values)

    def write_schema(self, path: Path) -> None:
        """Write the run table's schema as far as it is known."""
        write_schema(path, describe_columns(self.rows, self._known()))

    def _record(self, run_id: str, status: str, stamps: Mapping[str, str], measures: Mapping[str, Any]) -> None:
        if status == AttemptStatus.INTERRUPTED.value:
            self.rows.clear(run_id)
            return
        self.rows.record(
            run_id,
            status=_ENDS[status],
            stamps={name: stamp for event, stamp in stamps.items() if (name := f"{event}_at") in self.rows.stamps},
            measures={name: value for name, value in measures.items() if name in self.rows.measures},
        )

    def _known(self) -> dict[str, ColumnDescription]:
        return {
            column.name: ColumnDescription(
                name=column.name,
                role=ColumnRole.MEASURE,
                description=column.measure.description,
                unit=column.measure.unit,
                owner=column.owner,
                origin=", ".join(sorted(self.origins[column.name])) or None,
                findings=tuple(sorted(self.doubts[column.owner])),
            )
            for column in self.experiment.columns.in_table
        }


def recover_table(
    experiment: Experiment, manifest: Mapping[str, Any], *, accept_changes: bool = False
) -> RecoveredTable:
    """Return the run table: planned anew, or as it stands in the folder with what the journal knows better.

    The journal is flushed at the end of each run, the file is only brought up to date now and then: runs that ended
    after the file was written last are taken from the journal. What a user changed in the file counts.

    Args:
        experiment: what is to be executed.
        manifest: as written when the experiment was first executed.
        accept_changes: let the table on disk count where it differs from the plan.

    Raises:
        StorageError: the table cannot be read; every problem is named.
        ExecutionError: it differs from the plan; every cell is named.
    """
    folder = experiment.folder
    plan = experiment.model.plan(manifest["seed"])
    types = {column.name: column.type for column in read_schema(folder.schema)} if folder.schema.exists() else None
    layout = experiment.table_layout(types)
    if not folder.run_table.exists():
        recovered = RecoveredTable(experiment, RunTableRows.of_plan(plan, layout))
    else:
        rows = read_run_table(folder.run_table, layout)
        if manifest["design"]["source"] == "config" and not accept_changes:
            _refuse(table_differences(folder.run_table, plan, rows))
        recovered = RecoveredTable(experiment, rows, findings=rows.warnings)
    _replay(recovered, folder.journal)
    return recovered


def _replay(recovered: RecoveredTable, journal: Path) -> None:
    since_table_written: dict[str, dict[str, Any]] = {}
    reasons: dict[str, str] = {}
    for record in read_journal(journal, kinds={"attempt_started", "attempt_finished", "table_written"}):
        if record["kind"] == "attempt_started":
            recovered.attempts[record["run"]] += 1
            recovered.unfinished = record["run"]
        elif record["kind"] == "table_written":
            since_table_written.clear()
        else:
            recovered.unfinished = None
            since_table_written[record["run"]] = record
            reasons[record["run"]] = record["failure"] or ""
            for name, measure in record["measures"].items():
                recovered.origins[name].add(measure["origin"])
    for record in since_table_written.values():
        recovered.take_record(record)
    _settle(recovered, reasons)


def _settle(recovered: RecoveredTable, reasons: Mapping[str, str]) -> None:
    """Runs whose end nobody saw are to do again; failed ones are listed with their reason."""
    rows = recovered.rows
    for place in range(len(rows)) if rows.count(RunStatus.RUNNING) or rows.count(RunStatus.FAILED) else ():
        run_id = rows.run_id(place)
        if rows.status(place) is RunStatus.RUNNING:
            rows.clear(run_id)
        elif rows.status(place) is RunStatus.FAILED:
            recovered.failed[run_id] = reasons.get(run_id, "")


def _refuse(differences: Iterable[Finding]) -> None:
    listed = list(differences)
    more = len(listed) - _MOST_DIFFERENCES
    if more > 0:
        listed[_MOST_DIFFERENCES:] = [
            Finding.error(listed[0].where, f"there are {more:,} more differences", listed[0].fix)
        ]
    if listed:
        raise ExecutionError.of_findings(listed)
