"""Which cells of executed runs somebody has changed in the run table's file, as the journal tells it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.errors import Finding
from robot_runner.core.storage.cells import RunStatus, measure_text
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.words import listed

_SETTLE = "Execute the config again: nothing is executed that is done, and each change is settled, on record."
_MOST_NAMED = 8


def edited_findings(journal: Path, table: Path, rows: RunTableRows) -> Iterator[Finding]:
    """Yield a warning where treatments or measures of done runs are not what the journal has, or changes on record.

    Args:
        journal: the experiment's history.
        table: the file from which `rows` were read.
        rows: the run table.

    Raises:
        StorageError: the journal cannot be read.
    """
    written = ""
    for record in read_journal(journal, kinds={"table_written"}):
        written = record.get("sha256", "")
    with open_to_read(table) as file:
        if hashlib.file_digest(file, "sha256").hexdigest() == written:
            return  # as nearly always: nothing else of the journal is read
    known: dict[str, dict[str, str]] = {}
    for record in read_journal(journal, kinds={"attempt_started", "attempt_finished", "deviation"}):
        match record["kind"]:
            case "attempt_started":
                known[record["run"]] = dict(record.get("combination") or {})
                if "repetition" in record:
                    known[record["run"]][REPETITION] = str(record["repetition"])
            case "attempt_finished":
                measures = {name: measure_text(each["value"]) for name, each in record["measures"].items()}
                known.setdefault(record["run"], {}).update(measures)
            case _:
                known.setdefault(record["run"], {})[record["column"]] = record["is"]
    found = [cell for place in range(len(rows)) for cell in _edited(rows, place, known)]
    if found:
        yield Finding.warning(
            str(table), f"cells of runs that were executed were changed by hand: {listed(found, _MOST_NAMED)}", _SETTLE
        )


def _edited(rows: RunTableRows, place: int, known: dict[str, dict[str, str]]) -> Iterator[str]:
    run_id = rows.run_id(place)
    if rows.status(place) is not RunStatus.DONE or run_id not in known:
        return
    row = rows.row(place)
    for name in (*rows.combination(place), REPETITION, *rows.layout.measures):
        if name in known[run_id] and name in row and not _is_alike(known[run_id][name], row[name]):
            yield f"{name} of {run_id} is {str(row[name])!r}, and was {known[run_id][name]!r}"


def _is_alike(text: str, cell: Any) -> bool:
    """Whether a cell is what it was, in other digits (`11.0` for 11) at most."""
    if text in {measure_text(cell), str(cell)}:
        return True
    try:
        return float(text) == float(cell)
    except (TypeError, ValueError):
        return False
