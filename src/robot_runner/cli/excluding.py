"""Excluding runs from the analysis, and including them again: recorded with the reason; nothing is removed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from robot_runner.core.design.columns import EXCLUDED
from robot_runner.core.design.selection import RunChooser
from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.execution.recovered_table import TableHistory
from robot_runner.core.storage.executed_runs import ExcludedRuns
from robot_runner.core.storage.guarded_files import sha256_of
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import ExperimentLock
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import ColumnDescription, TableLayout
from robot_runner.core.storage.table_schema import EXCLUSION, read_schema, write_schema


def _on_one_line(reason: str) -> str:
    return " ".join(reason.split())


def _reason_findings(reason: str) -> Iterator[Finding]:
    text = _on_one_line(reason)
    if not text:
        fix = 'Say why, for the readers of the results: --reason "the door was open".'
        yield Finding.error("--reason", "the reason is empty", fix)
    elif not text.isprintable():
        yield Finding.error("--reason", f"the reason holds control characters: {text!r}", "Leave them out.")


def refuse_without_journal(folder: ExperimentFolder) -> None:
    """Refuse an experiment whose journal is missing: with a new one it would look as if nothing had been executed.

    Raises:
        StorageError: the journal is missing.
    """
    if not folder.journal.exists():
        fix = "Restore it from a backup; or have the run table count without it: robot-runner run CONFIG --table file"
        raise StorageError("journal.jsonl is missing", where=str(folder.root), fix=fix)


@contextmanager
def told_as_recorded(change: str) -> Iterator[None]:
    """Add to the error on a file that cannot be written: the journal has the change, which counts.

    Raises:
        StorageError: the one of the file, with that.
    """
    try:
        yield
    except StorageError as error:
        problem = f"{error.problem}; {change} counts all the same, as the journal has it"
        fix = f"{error.fix} The next execution of the experiment brings the other files up to date."
        raise StorageError(problem, where=error.where, fix=fix) from error


def exclude_runs(folder: ExperimentFolder, expressions: Sequence[str], reason: str) -> tuple[str, ...]:
    """Exclude runs from the analysis; those that are still to do are not executed either.

    Return the ids of the runs that were not excluded before with the same reason.

    Raises:
        RobotRunnerError: there are no such runs, there is no reason, or the experiment is being executed.
    """
    with _correcting(folder) as table:
        chosen = table.chosen(expressions, _reason_findings(reason))
        reason = _on_one_line(reason)
        new = [run_id for run_id in chosen if table.excluded.reason(run_id) != reason]
        table.record("excluded", new, reason=reason)
        for run_id in chosen:  # also those that the journal has and the table, after a kill, has not
            table.rows.exclude(run_id, reason)
    return tuple(new)


def include_runs(folder: ExperimentFolder, expressions: Sequence[str], reason: str = "") -> tuple[str, ...]:
    """Include runs again that were excluded, and return their ids.

    Raises:
        RobotRunnerError: there are no such runs, none of them is excluded, or the experiment is being executed.
    """
    with _correcting(folder) as table:
        chosen = table.chosen(expressions, _reason_findings(reason) if reason else ())
        out = [run_id for run_id in chosen if table.excludes(run_id)]
        if not out:
            present = ", ".join(table.excluded.present) or "none is"
            fix = f"Name runs that are excluded: {present}."
            raise ExecutionError("none of these runs is excluded", where=str(folder.root), fix=fix)
        table.record("included", out, **({"reason": _on_one_line(reason)} if reason else {}))
        for run_id in out:
            table.rows.exclude(run_id, None)
    return tuple(out)


@dataclass(frozen=True, slots=True)
class _Table:
    """A run table that is being corrected."""

    rows: RunTableRows
    excluded: ExcludedRuns
    journal: Journal

    def excludes(self, run_id: str) -> bool:
        """Return whether a run is excluded: by the journal, or by the file, which a kill may have left behind."""
        is_in_file = self.rows.excluded(self.rows.index_of(run_id)) is not None
        return is_in_file or self.excluded.reason(run_id) is not None

    def chosen(self, expressions: Sequence[str], findings: Iterable[Finding]) -> list[str]:
        chooser = RunChooser(self.rows.planned, has_repetition=self.rows.layout.has_repetition)
        places = chooser.choose("RUNS", expressions).places
        chooser.findings += findings
        chooser.refuse()
        return [self.rows.run_id(place) for place in places]

    def record(self, kind: str, runs: Sequence[str], **fields: str) -> None:
        for number, run_id in enumerate(runs, start=1):
            self.journal.append(kind, flush=number == len(runs), run=run_id, **fields)


@contextmanager
def _correcting(folder: ExperimentFolder) -> Iterator[_Table]:
    """Lock an experiment's folder, and write its table and schema at the end.

    Where the file is as we wrote it, so it is known afterwards, too: a correction that is killed before it is written
    again is then no edit by hand. Otherwise the next session compares it with the journal, and still finds what was
    edited by hand, or had ended after it was written, before this correction.
    """
    read_manifest(folder.manifest)  # raises where there is no experiment
    with ExperimentLock(folder.lock):
        refuse_without_journal(folder)
        schema = read_schema(folder.schema)
        rows = _read_rows(folder, schema)
        history = TableHistory.of(folder.journal)
        is_as_written = not history.newer and sha256_of(folder.run_table) == history.written
        with Journal(folder.journal) as journal:
            yield _Table(rows, history.excluded, journal)
            with told_as_recorded("the correction"):
                # First the schema: where only the table has the column, it would be taken for one of the user's own.
                write_schema(folder.schema, _with_exclusion(schema))
                digest = write_run_table(folder.run_table, rows)
                if is_as_written:
                    journal.append("table_written", sha256=digest)


def _read_rows(folder: ExperimentFolder, schema: Sequence[ColumnDescription]) -> RunTableRows:
    layout = TableLayout.of_schema(schema)
    rows = read_run_table(folder.run_table, layout)
    if EXCLUDED in rows.layout.extras:
        where = f"{folder.run_table}, column {EXCLUDED!r}"
        fix = "Rename your column: runs that are left out get one of that name."
        raise StorageError("the run table has a column of your own there", where=where, fix=fix)
    return rows if layout.has_exclusions else read_run_table(folder.run_table, replace(layout, has_exclusions=True))


def _with_exclusion(schema: Sequence[ColumnDescription]) -> list[ColumnDescription]:
    if any(column.name == EXCLUDED for column in schema):
        return list(schema)
    return [*schema[:2], EXCLUSION, *schema[2:]]
