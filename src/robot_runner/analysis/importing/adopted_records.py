"""The files of an adopted experiment beside its samples: run table, schema, manifest, journal, differences."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.importing.description_file import description_text
from robot_runner.analysis.importing.recomputation import unit_of_recipe
from robot_runner.core.design.factor import Combination, factor_places
from robot_runner.core.design.run_table import PlannedRun
from robot_runner.core.storage.cells import CellValue, RunStatus, typed_value
from robot_runner.core.storage.journal import Journal, utc_now
from robot_runner.core.storage.manifest import describe_software, write_manifest
from robot_runner.core.storage.run_table_rows import RunRow, RunTableRows, write_run_table
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.table_columns import ColumnRole, FactorColumn, TableLayout
from robot_runner.core.storage.table_schema import ColumnDescription, describe_columns, write_schema

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from robot_runner.analysis.importing.adoption import AdoptedRun
    from robot_runner.analysis.importing.foreign_runs import ForeignRun
    from robot_runner.analysis.importing.recomputation import Difference
    from robot_runner.analysis.importing.understanding import Understanding
    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = ["write_records"]

_STAMPS = ("start_measurement_at", "stop_measurement_at")
_OWNER = "import"


def write_records(
    understanding: Understanding,
    folder: ExperimentFolder,
    runs: Sequence[AdoptedRun],
    differences: Sequence[Difference],
) -> None:
    """Write everything but the samples.

    Raises:
        StorageError: a file cannot be written.
    """
    rows = _rows(understanding, runs)
    write_run_table(folder.run_table, rows)
    write_schema(folder.schema, describe_columns(rows, _known(understanding)))
    write_manifest(folder.manifest, _manifest(understanding, runs))
    _write_journal(understanding, folder, runs)
    (folder.root / "import").mkdir()
    description = description_text(understanding)
    write_beside_and_rename(folder.root / "import" / "description.toml", lambda file: file.write(description))
    _write_differences(understanding, folder, differences)


def _rows(understanding: Understanding, runs: Sequence[AdoptedRun]) -> RunTableRows:
    roles, headings = understanding.roles, understanding.headings
    has_repetition = all(run.repetition is not None for run in understanding.runs)
    has_stamps = any(run.started_at is not None for run in runs)
    measures = (*roles.measures, *understanding.new_measures)
    layout = TableLayout(
        tuple(FactorColumn(headings[name]) for name in roles.factors),
        tuple(headings[name] for name in measures),
        has_repetition=has_repetition,
        stamps=_STAMPS if has_stamps else (),
        extras=tuple(headings[name] for name in roles.extras),
    )
    places = factor_places(layout.factor_names)
    stamps = _STAMPS if has_stamps else ()
    rows = [
        RunRow(
            PlannedRun(run.run_id, number, Combination(places, _treatments(run, roles.factors)), run.repetition or 1),
            run.status,
            tuple(_stamps(adopted)[stamp] for stamp in stamps),
            tuple(_value(run, adopted, name, roles.measures) for name in measures),
            _kept(understanding, run) or None,
        )
        for number, (run, adopted) in enumerate(zip(understanding.runs, runs, strict=True), start=1)
    ]
    return RunTableRows(layout, rows)


def _treatments(run: ForeignRun, factors: Sequence[str]) -> tuple[CellValue, ...]:
    return tuple(typed_value(run.treatments[name], None) for name in factors)


def _value(run: ForeignRun, adopted: AdoptedRun, name: str, written: Collection[str]) -> CellValue:
    return run.measures[name] if name in written else adopted.recomputed.get(name)


def _kept(understanding: Understanding, run: ForeignRun) -> dict[str, str]:
    """Return the text that the table keeps as it is: the columns without a role, and treatments as they were written."""
    kept = {name: run.extras[name] for name in understanding.roles.extras if run.extras[name]}
    kept |= {name: run.treatments[name] for name in understanding.roles.factors}
    return {understanding.headings[name]: text for name, text in kept.items()}


def _stamps(run: AdoptedRun) -> dict[str, str | None]:
    if run.started_at is None:
        return dict.fromkeys(_STAMPS)
    end = run.started_at + round((run.duration or 0.0) * 1e9)
    return dict(zip(_STAMPS, (_stamp(run.started_at), _stamp(end)), strict=True))


def _stamp(nanoseconds: int) -> str:
    moment = datetime.fromtimestamp(nanoseconds // 10**6 / 1000, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _known(understanding: Understanding) -> dict[str, ColumnDescription]:
    known = {}
    for name in understanding.roles.measures:
        unit = understanding.units.get(name)
        known[understanding.headings[name]] = _measure(
            understanding, name, unit.symbol if unit else "", f"As in {understanding.table.path.name}."
        )
    by_file = {each.file: each for each in understanding.samples}
    for recipe in understanding.recipes:
        if recipe.measure in understanding.new_measures:
            unit_symbol = unit_of_recipe(recipe, by_file[recipe.file])
            text = f"Computed from the raw samples: {recipe.words}."
            known[understanding.headings[recipe.measure]] = _measure(understanding, recipe.measure, unit_symbol, text)
    return known


def _measure(understanding: Understanding, name: str, unit: str, description: str) -> ColumnDescription:
    return ColumnDescription(
        name=understanding.headings[name],
        role=ColumnRole.MEASURE,
        title=understanding.headings[name],
        description=description,
        unit=unit,
        owner=_OWNER,
        origin=understanding.origin,
    )


def _manifest(understanding: Understanding, runs: Sequence[AdoptedRun]) -> dict[str, Any]:
    headings = understanding.headings
    return {
        "experiment_name": understanding.name,
        "origin": "imported",
        "design": {
            "source": understanding.table.path.name,
            "factors": {headings[name]: list(understanding.treatments(name)) for name in understanding.roles.factors},
            "repetitions": max((run.repetition or 1 for run in understanding.runs), default=1),
            "shuffle": None,
            "blocks": None,
        },
        "plugins": [
            {"name": each.name, "class": None, "package": None, "version": None, "measures": []}
            for each in understanding.samples
        ],
        "executions": [],
        "imported": {
            "at": utc_now(),
            "from": understanding.root.resolve().name,
            "table": understanding.table.path.name,
            "notes": [*understanding.notes, *_sorting_notes(runs)],
            "sources": {run.run_id: dict(run.checksums) for run in runs if run.checksums},
        },
        "software": describe_software(),
    }


def _sorting_notes(runs: Sequence[AdoptedRun]) -> list[str]:
    unsorted = [f"{run.run_id}/{name}" for run in runs for name in run.unsorted]
    return [f"times were not in order, or missing, in {', '.join(unsorted)}"] if unsorted else []


def _write_journal(understanding: Understanding, folder: ExperimentFolder, runs: Sequence[AdoptedRun]) -> None:
    with Journal(folder.journal) as journal:
        journal.append("imported", name=understanding.name, table=understanding.table.path.name, runs=len(runs))
        for run, adopted in zip(understanding.runs, runs, strict=True):
            if run.status is not RunStatus.TODO:
                _write_attempt(journal, understanding, run, adopted)
        journal.append("table_written")


def _write_attempt(journal: Journal, understanding: Understanding, run: ForeignRun, adopted: AdoptedRun) -> None:
    begin, end = (_stamps(adopted)[stamp] or utc_now() for stamp in _STAMPS)
    which: dict[str, Any] = {"run": run.run_id, "attempt": 1}
    journal.append("attempt_started", at=begin, **which)
    if adopted.duration is not None:
        journal.append("event", at=begin, **which, event="start_measurement", clock=0.0)
        journal.append("event", at=end, **which, event="stop_measurement", clock=adopted.duration)
    journal.append(
        "attempt_finished",
        at=end,
        **which,
        is_last=True,
        status="done" if run.status is RunStatus.DONE else "failed",
        seconds=adopted.duration,
        stamps={name.removesuffix("_at"): stamp for name, stamp in _stamps(adopted).items() if stamp},
        measures=_published(understanding, run, adopted),
        failure=None if run.status is RunStatus.DONE else "as in the table that was imported",
    )


def _published(understanding: Understanding, run: ForeignRun, adopted: AdoptedRun) -> dict[str, dict[str, Any]]:
    values: dict[str, CellValue] = {understanding.headings[name]: value for name, value in run.measures.items()}
    for name, recomputed in adopted.recomputed.items():
        heading = understanding.headings[name]
        values[f"{heading} (recomputed)" if name in run.measures else heading] = recomputed
    return {name: {"value": each, "owner": _OWNER, "origin": understanding.origin} for name, each in values.items()}


def _write_differences(
    understanding: Understanding, folder: ExperimentFolder, differences: Sequence[Difference]
) -> None:
    def write(file: Any) -> None:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["run_id", "measure", "unit", "table", "recomputed", "difference", "relative_difference"])
        for each in differences:
            unit = understanding.units.get(each.measure)
            values = (each.table, each.recomputed, each.absolute, "" if each.relative is None else each.relative)
            heading = understanding.headings[each.measure]
            lines.writerow([each.run_id, heading, unit.si if unit else "", *values])

    write_beside_and_rename(folder.root / "import" / "differences.csv", write)
