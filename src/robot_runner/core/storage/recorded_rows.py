"""The rows of an experiment as far as they have come: its run table, and what the journal has beyond that file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.storage.cells import ENDS, RunStatus
from robot_runner.core.storage.executed_runs import ExcludedRuns
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import ColumnDescription, TableLayout


def recorded_rows(folder: ExperimentFolder, columns: Sequence[ColumnDescription]) -> tuple[RunTableRows, set[str]]:
    """Read the run table, with the runs that have ended since the file was written; a kill leaves it so.

    Args:
        folder: of the experiment.
        columns: of the run table, by its schema.

    Returns:
        the rows, and the runs whose last attempt came to an end by the journal.

    Raises:
        StorageError: there is no run table, or it or the journal cannot be read.
    """
    # Read the journal first: a table that is written meanwhile is newer than its records, never older.
    ended: set[str] = set()
    newer: dict[str, dict[str, Any]] = {}
    for record in read_journal(folder.journal, kinds={"attempt_finished", "table_written"}):
        if record["kind"] == "table_written":
            newer.clear()
        else:
            newer[record["run"]] = record
            (ended.discard if record["status"] == "interrupted" else ended.add)(record["run"])
    excluded = ExcludedRuns.read(folder.journal) if folder.journal.exists() else None
    layout = TableLayout.of_schema(columns)
    if excluded is not None and excluded.were_any:
        layout = replace(layout, has_exclusions=True)
    rows = read_run_table(folder.run_table, layout)
    for record in newer.values():
        if rows.place_of(record["run"]) is not None:
            _take(rows, record)
    if excluded is not None:  # the journal decides; the next session settles a cell that was edited by hand
        for run_id in rows.values(RUN_ID) if rows.layout.has_exclusions else ():
            rows.exclude(run_id, excluded.reason(run_id))
    return rows, ended


def _take(rows: RunTableRows, record: Mapping[str, Any]) -> None:
    stamps = {f"{event}_at": at for event, at in record["stamps"].items() if f"{event}_at" in rows.layout.stamps}
    measures = {name: each["value"] for name, each in record["measures"].items() if name in rows.layout.measures}
    rows.record(record["run"], status=ENDS.get(record["status"], RunStatus.TODO), stamps=stamps, measures=measures)
