"""The rows of another tool's run table, understood."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.cells import CellValue, RunStatus, number_of
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from robot_runner.analysis.importing.column_roles import ColumnRoles
    from robot_runner.analysis.importing.foreign_table import ForeignTable

__all__ = ["ForeignRun", "read_runs"]

_WORDS = {
    RunStatus.DONE: "done true yes 1 finished completed complete ok success x",
    RunStatus.TODO: "- – — todo to_do false no 0 pending running planned",  # noqa: RUF001 - spreadsheets write dashes
    RunStatus.FAILED: "failed error aborted crashed fail",
}
_STATUSES = {word: status for status, words in _WORDS.items() for word in words.split()} | dict.fromkeys(
    ("", "to do", "not done"), RunStatus.TODO
)
_MISSING = frozenset({"", "na", "n/a", "nan", "none", "null"})
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")
_LONGEST_ID = 60

#: Repetitions that are numbered in words, as in `r3` or `rep_3`.
_LAST_NUMBER = re.compile(r"[A-Za-z]+[ _-]?(\d+)")


@dataclass(frozen=True, slots=True)
class ForeignRun:
    """One row of the run table, understood.

    Attributes:
        run_id: its id here; the same as there, but for characters that cannot name a folder.
        source_id: its id there.
        status: how far it had come.
        treatments: the texts of the factors' cells.
        repetition: from 1; None where there are none.
        measures: the values; None where one is missing.
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
    root: Path, table: ForeignTable, roles: ColumnRoles, pattern: str | None, notes: list[str]
) -> list[ForeignRun]:
    """Return the runs of a table; what looks odd is added to the notes.

    Args:
        root: the folder that the table is in.
        table: the run table.
        roles: what its columns are.
        pattern: where a run's files are below the folder, with `{run_id}` in it; None for `{run_id}`, else
            `runs/{run_id}`.
        notes: takes what looks odd.

    Raises:
        AnalysisError: a run has no id; a status or a repetition cannot be read.
    """
    table = _without_copies(table, roles, notes)
    source_ids = table.column(roles.run_id) if roles.run_id else [f"r_{n}" for n in range(1, len(table.rows) + 1)]
    times = Counter(source_ids)
    patterns = [pattern] if pattern else ["{run_id}", "runs/{run_id}"]
    run_ids, repetitions = _run_ids(source_ids, table, notes), _repetitions(table, roles, source_ids, notes)
    runs = []
    for place, (row, source_id) in enumerate(zip(table.rows, source_ids, strict=True)):
        cells = dict(zip(table.headings, row, strict=True))
        measures = {name: _value(cells[name], table) for name in roles.measures}
        folders = [root / each.replace("{run_id}", source_id) for each in patterns if times[source_id] == 1]
        runs.append(
            ForeignRun(
                run_id=run_ids[place],
                source_id=source_id,
                status=_status(cells, roles, measures, f"{table.path}:{table.lines[place]}"),
                treatments={name: _treatment(cells[name], name, table) for name in roles.factors},
                repetition=repetitions[place],
                measures=measures,
                extras={name: cells[name] for name in roles.extras},
                folder=next((folder for folder in folders if folder.is_dir()), None),
            )
        )
    notes += _run_notes(table, roles, runs)
    return runs


def _without_copies(table: ForeignTable, roles: ColumnRoles, notes: list[str]) -> ForeignTable:
    """Return the table without rows that repeat an earlier one cell by cell: tables are put together by hand."""
    first = dict(zip(reversed(table.rows), reversed(table.lines), strict=True))
    copies = len(table.rows) - len(first)
    if roles.run_id is None or not copies:
        return table
    notes.append(f"{counted(copies, 'row')} left out that {'is' if copies == 1 else 'are'} there twice, cell by cell")
    rows = sorted(first, key=first.__getitem__)
    return replace(table, rows=tuple(rows), lines=tuple(first[row] for row in rows))


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
        cells = table.column(roles.repetition)
        numbers = [_number_of_repetition(cell) for cell in cells]
        if None in numbers:
            place = numbers.index(None)
            where = f"{table.path}:{table.lines[place]}, column {roles.repetition!r}"
            fix = "Mend it, or name the column a factor: --factor."
            raise AnalysisError(f"{cells[place]!r} is not a repetition number", where=where, fix=fix)
    if 0 in numbers:
        notes.append("repetitions are numbered from 1 here, not from 0")
        return [None if number is None else number + 1 for number in numbers]
    return numbers


def _number_of_repetition(cell: str) -> int | None:
    worded = _LAST_NUMBER.fullmatch(cell)
    number = number_of(worded[1] if worded else cell)
    return int(number) if number is not None and number >= 0 and number == int(number) else None


def _status(cells: Mapping[str, str], roles: ColumnRoles, measures: Mapping[str, CellValue], where: str) -> RunStatus:
    if roles.status is None:
        return RunStatus.DONE if any(value is not None for value in measures.values()) else RunStatus.TODO
    word = cells[roles.status]
    if word.casefold() not in _STATUSES:
        fix = "Write DONE, TODO or FAILED, or name another column: --status."
        raise AnalysisError(f"{word!r} is not a status", where=f"{where}, column {roles.status!r}", fix=fix)
    return _STATUSES[word.casefold()]


def _value(cell: str, table: ForeignTable) -> CellValue:
    if cell.casefold() in _MISSING:
        return None
    number = table.number(cell)
    return number if number is not None else {"true": True, "false": False}.get(cell.casefold(), cell)


def _treatment(cell: str, factor: str, table: ForeignTable) -> str:
    if table.is_boolean(factor):
        return cell.capitalize()
    return str(table.number(cell)) if table.is_numeric(factor) else cell


def _run_notes(table: ForeignTable, roles: ColumnRoles, runs: Sequence[ForeignRun]) -> list[str]:
    notes = []
    running = [cell for cell in table.column(roles.status) if cell.casefold() == "running"] if roles.status else []
    if running:
        notes.append(f"{counted(len(running), 'run')} were being executed when the table was written: to do again")
    for name in roles.measures:
        texts = [run.run_id for run in runs if isinstance(run.measures[name], str)]
        if texts and any(isinstance(run.measures[name], int | float) for run in runs):
            notes.append(f"{name} is text in {counted(len(texts), 'run')}, such as {texts[0]}: no statistics of it")
    without = [run.run_id for run in runs if run.status is RunStatus.DONE and run.folder is None]
    if any(run.folder for run in runs) and without:
        notes.append(f"{counted(len(without), 'run')} done without a folder of raw files, such as {without[0]}")
    return notes
