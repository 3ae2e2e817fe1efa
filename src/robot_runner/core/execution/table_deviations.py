"""Cells of a run table that differ from the journal."""

from __future__ import annotations

import io
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from robot_runner.core.design.columns import EXCLUDED, REPETITION, RUN_ID
from robot_runner.core.design.factor import texts_of
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import Finding, Severity
from robot_runner.core.events.measure import MeasureColumns, Origin, quality_text
from robot_runner.core.execution.recovered_table import Deviation
from robot_runner.core.storage.cells import ENDS, CellValue, RunStatus, csv_text, is_same_number, measure_text
from robot_runner.core.storage.executed_runs import ROW, ExcludedRuns
from robot_runner.core.storage.run_table_reading import run_table_in
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_decoders import MISSING, TYPE_WORDS, is_unfit
from robot_runner.core.words import counted, enumerated, listed

#: The `column` of a deviation that is a changed order of rows.
ORDER = "order"


def cell_deviations(
    rows: RunTableRows, record: Mapping[str, Any], changed: Mapping[tuple[str, str], str]
) -> Iterator[Deviation]:
    """Yield each cell of a run's row that differs from its last attempt and from the changes recorded since.

    The same number in other digits (`11.0` for 11, as pandas writes beside a missing value), or in fewer, as R and
    spreadsheets write, and `NA` for nothing are put back in `rows`. `record` is the end of the run's last attempt;
    `changed` has the text by run and column.
    """
    run_id = record["run"]
    if record["status"] not in ENDS:  # it was interrupted, and is to be done again
        return
    place = rows.place_of(run_id)
    if place is None:
        if changed.get((run_id, ROW)) != "":
            yield Deviation(run_id, ROW, record["status"], "")
        return
    row = rows.row(place)
    for name, text in _expected(rows, row["status"], record).items():
        was, is_now = changed.get((run_id, name), text), _text(row[name])
        if is_now == was:
            continue
        value = record["measures"].get(name, {}).get("value")
        if was == text and (is_same_number(value, row[name]) or (not was and is_now in MISSING)):
            rows.record(run_id, measures={name: value})
        else:
            yield Deviation(run_id, name, was, is_now)


def _expected(rows: RunTableRows, status: Any, record: Mapping[str, Any]) -> dict[str, str]:
    """Return the text that each cell of a run's row has by the end of its last attempt."""
    layout, expected = rows.layout, {}
    if layout.spelling.tells_apart(ENDS[record["status"]], status):
        expected["status"] = ENDS[record["status"]].value
    stamps = {f"{event}_at": stamp for event, stamp in record["stamps"].items()}
    expected |= {name: stamp for name, stamp in stamps.items() if name in layout.stamps}
    return expected | {name: measure_text(record["measures"].get(name, {}).get("value")) for name in layout.measures}


def treatment_deviations(
    rows: RunTableRows, record: Mapping[str, Any], defaults: Mapping[str, Any], changed: Mapping[tuple[str, str], str]
) -> Iterator[Deviation]:
    """Yield each treatment, and the repetition, of a done run that differs from what was executed or recorded since.

    `record` is the beginning of the run's last attempt. Of factors that were added later, `defaults` count for earlier
    runs; `changed` has the text by run and column.
    """
    run_id, executed = record["run"], record.get("combination")
    place = rows.place_of(run_id)
    if executed is None or place is None or rows.status(place) is not RunStatus.DONE:
        return
    expected, found = {**texts_of(defaults), **executed}, texts_of(rows.combination(place))
    if rows.layout.has_repetition and "repetition" in record:
        expected[REPETITION], found[REPETITION] = str(record["repetition"]), str(rows.repetition(place))
    for name, is_now in found.items():
        was = changed.get((run_id, name), expected.get(name, is_now))
        if was != is_now:
            yield Deviation(run_id, name, was, is_now)


def planned_otherwise(
    plan: Sequence[PlannedRun], rows: RunTableRows, executed: Container[str], changed: Mapping[tuple[str, str], str]
) -> Iterator[Deviation]:
    """Yield each treatment of a run that is not done which differs from the plan, and each run that only one has.

    Where rows of `executed` runs are missing, that is found by the journal, and not here; one that was added is on
    record since before it was executed. `changed` has the text by run and column.
    """
    planned = {run.run_id: run for run in plan}
    found: list[Deviation] = []
    for place, row in enumerate(rows.planned):
        run = planned.pop(row.run_id, None)
        if run is None and row.run_id not in executed:
            found.append(Deviation(row.run_id, ROW, "", rows.status(place).value))
        elif run is not None and run is not row and rows.status(place) is not RunStatus.DONE:
            was, now = texts_of(run.combination), texts_of(row.combination)
            found += (Deviation(run.run_id, name, was[name], now[name]) for name in was if was[name] != now[name])
    found += (Deviation(run_id, ROW, RunStatus.TODO.value, "") for run_id in planned if run_id not in executed)
    yield from (each for each in found if changed.get((each.run, each.column)) != each.is_now)


def with_changes(
    path: Path, rows: RunTableRows, plan: Sequence[PlannedRun], changed: Mapping[tuple[str, str], str]
) -> tuple[RunTableRows, str]:
    """Apply recorded changes by hand to a table that was made anew.

    `changed` has the text by run and column. Return the rows, and the changes in words: ", and 2 cells as ...".
    """
    columns = {name: place for place, name in enumerate(rows.layout.columns) if name != EXCLUDED}
    cells = {
        (place, columns[name]): text
        for (run_id, name), text in changed.items()
        if name in columns and (text or name != ROW) and (place := rows.place_of(run_id)) is not None
    }
    removed = [run_id for (run_id, name), text in changed.items() if name == ROW and not text]
    told = f"; {enumerated(removed)} had been removed by hand" if removed else ""
    rows_changed = (run_id for (run_id, name), text in changed.items() if name == ROW and text)
    if added := [run_id for run_id in rows_changed if rows.place_of(run_id) is None]:
        told += f"; {enumerated(added)}, which had been added by hand, {'is' if len(added) == 1 else 'are'} lost"
    if not cells:
        return rows, told
    # By way of CSV, so that changed texts are read by the same rules as those of a file.
    lines = [rows.layout.headings, *map(list, chain.from_iterable(rows.cells()))]
    for (place, column), text in cells.items():
        lines[1 + place][column] = text
    changed_rows = run_table_in(io.StringIO(csv_text(lines), newline=""), path, rows.layout, plan)
    return changed_rows, f", and {counted(len(cells), 'cell')} as they were changed by hand{told}"


def unfit_values(path: Path, rows: RunTableRows, found: Iterable[Deviation]) -> Iterator[Finding]:
    """Yield an error for each changed measure that is not of the type of its column: numbers, or truth values."""
    fix = "Correct the cell, or leave it empty where there is no value."
    measured = (each for each in found if each.column in rows.layout.measures)
    for each in measured:
        kind, place = rows.layout.types.get(each.column), rows.place_of(each.run)
        if kind is not None and place is not None and is_unfit(rows.row(place)[each.column], kind):
            problem = f"{each.is_now!r} is not {TYPE_WORDS[kind]}, as the column's other values"
            yield Finding.error(f"{path}, run {each.run}, column {each.column!r}", problem, fix)


def amended_ends(
    rows: RunTableRows, columns: MeasureColumns, ends: Iterable[Mapping[str, Any]], found: Sequence[Deviation]
) -> tuple[list[dict[str, Any]], list[Deviation]]:
    """Return the ends of attempts with the measures that were changed by hand, and changed cells of quality columns.

    A new value has the doubts for which it gives reason itself, and none of those about the earlier one. Quality
    columns of `rows` are made to follow the values; `ends` are the records of the last ends of attempts.
    """
    changed: dict[str, list[str]] = {}
    for each in found:
        if each.column in rows.layout.measures:
            changed.setdefault(each.run, []).append(each.column)
    amended, followed = [], list[Deviation]()
    for end in ends:
        run_id, place = end["run"], rows.place_of(end["run"])
        names, status = changed.get(run_id), None if place is None else _ENDED.get(rows.status(place))
        if not names or place is None or status is None:  # a run that is to do has no values that count
            continue
        row = rows.row(place)
        measures = end["measures"] | {name: _by_hand(name, row[name], end["measures"], columns) for name in names}
        for column in columns.in_table:
            if column.tells_of in names and column.name not in names:
                told = measures[column.tells_of]
                is_now = quality_text(told["value"], told.get("doubts", ()))
                measures[column.name] = {"value": is_now, "owner": column.owner, "origin": Origin.MEASURED.value}
                rows.record(run_id, measures={column.name: is_now})
                if (was := _text(row[column.name])) != is_now:
                    followed.append(Deviation(run_id, column.name, was, is_now))
        doubts = {name: why for name, why in end.get("doubts", {}).items() if name not in names}
        kept = {name: fact for name, fact in end.items() if name not in _OF_RECORD}
        kept |= {"status": status, "failure": end["failure"] if status == end["status"] else None}
        amended.append({**kept, "measures": measures, **({"doubts": doubts} if doubts else {}), "is_amended": True})
    return amended, followed


def _by_hand(name: str, value: CellValue, told: Mapping[str, Any], columns: MeasureColumns) -> dict[str, Any]:
    """Return the facts on a value that somebody wrote into the table: `told` has those on the earlier ones."""
    earlier = told.get(name, {})
    column = next((each for each in columns.in_table if each.name == name), None)
    implausible = column.measure.implausible(value) if column else ""
    return {
        "value": value,
        "owner": earlier.get("owner") or (column.owner if column else ""),
        "origin": Origin.ENTERED.value if value is not None else earlier.get("origin", Origin.MEASURED.value),
        **({"doubts": [implausible]} if implausible else {}),
    }


_ENDED = {status: word for word, status in ENDS.items()}
#: What an amended end has anew, or, as any, does not repeat.
_OF_RECORD = {"kind", "at", "doubts", "left", "to_ask"}


def changed_exclusions(rows: RunTableRows, excluded: ExcludedRuns) -> Iterator[Deviation]:
    """Yield each run whose exclusion differs between table and journal."""
    for run_id, found in zip(rows.values(RUN_ID), rows.values(EXCLUDED), strict=True) if excluded.were_any else ():
        reason = excluded.reason(run_id)
        if reason != found:
            yield Deviation(run_id, EXCLUDED, reason or "", found or "")


def is_reordered(plan: Sequence[PlannedRun], rows: RunTableRows) -> bool:
    """Return whether the runs that plan and table have in common are in different orders."""
    planned = [run.run_id for run in plan]
    there = [run.run_id for run in rows.planned]
    if planned == there:
        return False
    both = set(planned) & set(there)
    return [each for each in planned if each in both] != [each for each in there if each in both]


def _text(cell: Any) -> str:
    return str(cell.value) if isinstance(cell, RunStatus) else measure_text(cell)


#: Of a column with more differing cells than this there is one finding, which shows the first few.
_MOST_CELLS = 5
_SHOWN_CELLS = 3


def deviation_findings(path: Path, found: Sequence[Deviation], severity: Severity, fix: str = "") -> Iterator[Finding]:
    """Yield a finding for each cell that differs, or one for the whole column where many do, as with one cause."""
    columns: dict[str, list[Deviation]] = {}
    for each in found:
        columns.setdefault(each.column, []).append(each)
    for column, members in columns.items():
        if len(members) <= _MOST_CELLS:
            yield from (Finding(severity, *_place_and_problem(path, each), fix) for each in members)
        elif column == ROW and not members[0].is_now:
            lost = listed([each.run for each in members], _SHOWN_CELLS)
            problem = f"{len(members):,} runs were executed, and the table has no such runs any more: {lost}"
            yield Finding(severity, str(path), problem, fix)
        else:
            shown = [f"{each.run} has {_shown(each.is_now)} for {_shown(each.was)}" for each in members[:_SHOWN_CELLS]]
            problem = f"{len(members):,} runs have another value than the journal: {', '.join(shown)}, ..."
            yield Finding(severity, f"{path}, column {column!r}", problem, fix)


def _place_and_problem(path: Path, each: Deviation) -> tuple[str, str]:
    where = f"{path}, run {each.run}"
    if each.column == ROW and not each.is_now:
        return where, "the run was executed, and the table has no such run any more"
    return f"{where}, column {each.column!r}", f"the table has {_shown(each.is_now)}, the journal {_shown(each.was)}"


def _shown(text: str) -> str:
    return repr(text) if text else "nothing"
