"""The rows of a foreign run table, understood."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.foreign_samples import find_run_folders
from robot_runner.analysis.wording import counted
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.cells import CellValue, RunStatus, number_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from robot_runner.analysis.importing.description import ImportDescription
    from robot_runner.analysis.importing.foreign_table import ForeignTable
    from robot_runner.analysis.importing.understanding import ColumnRoles

__all__ = ["ForeignRun", "read_runs"]

_WORDS = {
    RunStatus.DONE: ("done", "true", "yes", "1", "finished", "completed", "complete", "ok", "success", "x"),
    RunStatus.TODO: (
        "",
        "-",
        "–",  # noqa: RUF001 - spreadsheets write it
        "—",
        "todo",
        "to do",
        "to_do",
        "not done",
        "false",
        "no",
        "0",
        "pending",
        "running",
        "planned",
    ),
    RunStatus.FAILED: ("failed", "error", "aborted", "crashed", "fail"),
}
_STATUSES = {word: status for status, words in _WORDS.items() for word in words}
_MISSING = frozenset({"", "na", "n/a", "nan", "none", "null"})
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")
_LONGEST_ID = 60

#: Repetitions that are numbered in words, as in `r3` or `rep_3`.
_LAST_NUMBER = re.compile(r"[A-Za-z]+[ _-]?(\d+)")


@dataclass(frozen=True, slots=True)
class ForeignRun:
    """One row of a foreign run table, understood.

    Attributes:
        run_id: its id here; the same as there, but for characters that cannot name a folder.
        source_id: its id there.
        status: how far it had come.
        treatments: the texts of the factors' cells.
        repetition: from 1; None where there are none.
        measures: the values; None where there is none.
        extras: the texts of columns that are kept as they are.
        folder: its raw files, or None.
    """

    run_id: str
    source_id: str
    status: RunStatus
    treatments: Mapping[str, str]
    repetition: int | None
    measures: Mapping[str, CellValue]
    extras: Mapping[str, str]
    folder: Path | None


def read_runs(
    root: Path, table: ForeignTable, roles: ColumnRoles, said: ImportDescription, notes: list[str]
) -> list[ForeignRun]:
    """Return the runs of a foreign table; what looks odd is added to the notes.

    Raises:
        AnalysisError: a run has no id, or one that another has; a status or a repetition cannot be read.
    """
    table = _without_copies(table, roles, notes)
    source_ids = (
        table.column(roles.run_id) if roles.run_id else [f"r_{place}" for place in range(1, len(table.rows) + 1)]
    )
    run_ids = _run_ids(source_ids, table, notes)
    shared = {source for source, times in Counter(source_ids).items() if times > 1}
    folders = find_run_folders(root, [source for source in source_ids if source not in shared], said.run_folder)
    repetitions = _repetitions(table, roles, source_ids, notes)
    runs = []
    for place, row in enumerate(table.rows):
        cells = dict(zip(table.headings, row, strict=True))
        measures = {name: _value(cells[name], table) for name in roles.measures}
        runs.append(
            ForeignRun(
                run_id=run_ids[place],
                source_id=source_ids[place],
                status=_status(cells, roles, measures, table, place),
                treatments={name: _treatment(cells[name], name, table) for name in roles.factors},
                repetition=repetitions[place],
                measures=measures,
                extras={name: cells[name] for name in roles.extras},
                folder=folders.get(source_ids[place]),
            )
        )
    notes += _run_notes(table, roles, runs)
    return runs


def _without_copies(table: ForeignTable, roles: ColumnRoles, notes: list[str]) -> ForeignTable:
    """Return the table without rows that are there already, cell by cell: tables are put together by hand."""
    if roles.run_id is None:
        return table
    first = {row: place for place, row in reversed([*enumerate(table.rows)])}
    kept = sorted(first.values())
    copies = len(table.rows) - len(kept)
    if not copies:
        return table
    notes.append(f"{counted(copies, 'row')} left out that {'is' if copies == 1 else 'are'} there twice, cell by cell")
    rows, lines = tuple(table.rows[place] for place in kept), tuple(table.lines[place] for place in kept)
    return replace(table, rows=rows, lines=lines)


def _run_ids(source_ids: Sequence[str], table: ForeignTable, notes: list[str]) -> list[str]:
    """Return an id for each run that can name a folder, and that no other run has."""
    plain = [_UNFIT.sub("_", source).strip(".-")[:_LONGEST_ID] for source in source_ids]
    if "" in plain:
        where = f"{table.path}:{table.lines[plain.index('')]}"
        raise AnalysisError("the run has no id", where=where, fix="Give it one.")
    changed = sum(one != other for one, other in zip(plain, source_ids, strict=True))
    if changed:
        notes.append(f"{counted(changed, 'run id')} had characters that cannot name a folder, replaced by '_'")
    taken = {each.casefold() for each in plain}
    seen: set[str] = set()
    run_ids = []
    for run_id in plain:
        free, number = run_id, 2
        while free.casefold() in seen or (free != run_id and free.casefold() in taken):
            free, number = f"{run_id}_{number}", number + 1
        seen.add(free.casefold())
        run_ids.append(free)
    again = [place for place, (one, other) in enumerate(zip(run_ids, plain, strict=True)) if one != other]
    if again:
        example = f"{source_ids[again[0]]!r} in line {table.lines[again[0]]} is called {run_ids[again[0]]!r} here"
        notes.append(
            f"{counted(len(again), 'run')} had an id that another has, so that none of either has raw files: {example}"
        )
    return run_ids


def _repetitions(
    table: ForeignTable, roles: ColumnRoles, source_ids: Sequence[str], notes: list[str]
) -> list[int | None]:
    if roles.repetition is None:
        numbers = [roles.repetition_of(run_id) for run_id in source_ids]
    else:
        numbers = [_number_of_repetition(cell) for cell in table.column(roles.repetition)]
        if None in numbers:
            place = numbers.index(None)
            where = f"{table.path}:{table.lines[place]}, column {roles.repetition!r}"
            fix = "Mend it, or name the column a factor: --factor."
            raise AnalysisError("it is no number of a repetition", where=where, fix=fix)
    counted = [number for number in numbers if number is not None]
    if counted and min(counted) == 0:
        notes.append("repetitions are numbered from 1 here, not from 0")
        return [None if number is None else number + 1 for number in numbers]
    return numbers


def _number_of_repetition(cell: str) -> int | None:
    worded = _LAST_NUMBER.fullmatch(cell)
    number = number_of(worded[1] if worded else cell)
    return int(number) if number is not None and number >= 0 and number == int(number) else None


def _status(
    cells: Mapping[str, str], roles: ColumnRoles, measures: Mapping[str, CellValue], table: ForeignTable, place: int
) -> RunStatus:
    if roles.status is None:
        return RunStatus.DONE if any(value is not None for value in measures.values()) else RunStatus.TODO
    word = cells[roles.status].casefold()
    if word not in _STATUSES:
        where = f"{table.path}:{table.lines[place]}, column {roles.status!r}"
        fix = "Write DONE, TODO or FAILED, or name another column: --status."
        raise AnalysisError(f"{cells[roles.status]!r} is no status", where=where, fix=fix)
    return _STATUSES[word]


def _value(cell: str, table: ForeignTable) -> CellValue:
    if cell.casefold() in _MISSING:
        return None
    number = number_of(cell, decimal_comma=table.dialect.decimal_comma)
    if number is not None:
        return number
    return {"true": True, "false": False}.get(cell.casefold(), cell)


def _treatment(cell: str, factor: str, table: ForeignTable) -> str:
    if table.is_boolean(factor):
        return cell.capitalize()
    if table.is_numeric(factor):
        return str(number_of(cell, decimal_comma=table.dialect.decimal_comma))
    return cell


def _run_notes(table: ForeignTable, roles: ColumnRoles, runs: Sequence[ForeignRun]) -> list[str]:
    notes = []
    running = [cell for cell in table.column(roles.status) if cell.casefold() == "running"] if roles.status else []
    if running:
        notes.append(f"{counted(len(running), 'run')} were being executed when the table was written: to do again")
    for name in roles.measures:
        texts = [run.run_id for run in runs if isinstance(run.measures[name], str)]
        numbers = [run for run in runs if isinstance(run.measures[name], int | float)]
        if texts and numbers:
            notes.append(f"{name} is text in {counted(len(texts), 'run')}, such as {texts[0]}: no statistics of it")
    done = [run for run in runs if run.status is RunStatus.DONE]
    without = [run.run_id for run in done if run.folder is None]
    if any(run.folder for run in runs) and without:
        notes.append(f"{counted(len(without), 'run')} done without a folder of raw files, such as {without[0]}")
    return notes
