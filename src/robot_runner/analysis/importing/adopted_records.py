"""The files of an imported experiment, except samples: run table, schema, manifest, journal, differences."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.importing.description import description_text
from robot_runner.analysis.importing.recomputation import Difference, unit_of_recipe
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.factor import Combination, factor_places
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.storage.cells import CellValue, RunStatus, typed_value
from robot_runner.core.storage.journal import Journal, utc_now
from robot_runner.core.storage.manifest import describe_software, write_manifest
from robot_runner.core.storage.run_table_rows import RunRow, RunTableRows, write_run_table
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole, FactorColumn, TableLayout
from robot_runner.core.storage.table_schema import describe_columns, write_schema

if TYPE_CHECKING:
    from robot_runner.analysis.importing.foreign_runs import ForeignRun
    from robot_runner.analysis.importing.sample_times import TraceSpan
    from robot_runner.analysis.importing.understanding import Understanding
    from robot_runner.core.storage.layout import ExperimentFolder

_STAMPS = ("start_measurement_at", "stop_measurement_at")
_OWNER = "import"


@dataclass(frozen=True, slots=True)
class AdoptedRun:
    """The contents of one run's raw files.

    Attributes:
        run_id: the run.
        started_at: when its first sample was taken, nanoseconds since 1970; None where that is not known.
        begun: the time of the first sample, s on the clock of the samples; 0 where some are from before it.
        duration: s, from the first sample to the last; None without samples.
        recomputed: the measures that were computed from samples, in SI.
        spans: the extent of each file's samples.
        unsorted: the files whose times were not in order.
        checksums: SHA-256 of each original file.
    """

    run_id: str
    started_at: int | None = None
    begun: float = 0.0
    duration: float | None = None
    recomputed: Mapping[str, float | None] = field(default_factory=dict)
    spans: tuple[TraceSpan, ...] = ()
    unsorted: tuple[str, ...] = ()
    checksums: Mapping[str, str] = field(default_factory=dict)

    @property
    def stamps(self) -> dict[str, str | None]:
        """The time stamps of the measurement, for the run table."""
        if self.started_at is None:
            return dict.fromkeys(_STAMPS)
        ends = (self.started_at, self.started_at + round((self.duration or 0.0) * 1e9))
        moments = (datetime.fromtimestamp(end // 10**6 / 1000, UTC).isoformat(timespec="milliseconds") for end in ends)
        return {name: text.replace("+00:00", "Z") for name, text in zip(_STAMPS, moments, strict=True)}


def write_records(
    understanding: Understanding,
    folder: ExperimentFolder,
    runs: Sequence[AdoptedRun],
    differences: Sequence[Difference],
    warnings: Sequence[str] = (),
) -> None:
    """Write all files except the samples.

    Raises:
        StorageError: a file cannot be written.
    """
    rows = _rows(understanding, runs)
    write_run_table(folder.run_table, rows)
    write_schema(folder.schema, describe_columns(rows, _known(understanding)))
    write_manifest(folder.manifest, _manifest(understanding, runs, warnings))
    _write_journal(understanding, folder, runs)
    (folder.root / "import").mkdir()
    description = description_text(understanding.description)
    write_beside_and_rename(folder.root / "import" / "description.toml", lambda file: file.write(description))
    _write_differences(understanding, folder, differences)


def _rows(understanding: Understanding, runs: Sequence[AdoptedRun]) -> RunTableRows:
    roles, headings = understanding.roles, understanding.headings
    stamps = _STAMPS if any(run.started_at is not None for run in runs) else ()
    layout = TableLayout(
        tuple(FactorColumn(headings[name]) for name in roles.design),
        tuple(headings[name] for name in (*roles.measures, *understanding.new_measures)),
        has_repetition=all(run.repetition is not None for run in understanding.runs),
        stamps=stamps,
        extras=tuple(headings[name] for name in roles.extras),
    )
    places = factor_places(layout.factor_names)
    rows = []
    for number, (run, adopted) in enumerate(zip(understanding.runs, runs, strict=True), start=1):
        treatments = tuple(typed_value(run.treatments[name], None) for name in roles.design)
        planned = PlannedRun(run.run_id, number, Combination(places, treatments), run.repetition or 1)
        of_table = [run.measures[name] for name in roles.measures]
        computed = [adopted.recomputed.get(name) for name in understanding.new_measures]
        # Treatments, and the text of columns without a role, are written unchanged.
        texts = {name: text for name, text in run.extras.items() if text} | dict(run.treatments)
        kept = {headings[name]: text for name, text in texts.items()}
        moments = tuple(adopted.stamps[stamp] for stamp in stamps)
        rows.append(RunRow(planned, run.status, moments, (*of_table, *computed), kept or None))
    return RunTableRows(layout, rows)


def _known(understanding: Understanding) -> dict[str, ColumnDescription]:
    table = f"As in {understanding.table.path.name}."
    described = {name: (unit.symbol if unit else "", table) for name, unit in understanding.units.items()}
    by_file = {each.file: each for each in understanding.samples}
    for recipe in understanding.recipes:
        if recipe.measure in understanding.new_measures:
            text = f"Computed from the raw samples: {recipe.words}."
            described[recipe.measure] = (unit_of_recipe(recipe, by_file[recipe.file]), text)
    return {
        (heading := understanding.headings[name]): ColumnDescription(
            name=heading,
            role=ColumnRole.MEASURE,
            title=heading,
            description=text,
            unit=unit,
            owner=_OWNER,
            origin=understanding.origin,
        )
        for name, (unit, text) in described.items()
    }


def _manifest(understanding: Understanding, runs: Sequence[AdoptedRun], warnings: Sequence[str]) -> dict[str, Any]:
    headings, roles = understanding.headings, understanding.roles
    unsorted = [_unsorted(runs)] if any(run.unsorted for run in runs) else []
    return {
        "experiment_name": understanding.name,
        "origin": "imported",
        "design": {
            "source": understanding.table.path.name,
            "factors": {headings[name]: list(understanding.treatments(name)) for name in roles.design},
            "repetitions": max((run.repetition or 1 for run in understanding.runs), default=1),
            "blocks": REPETITION if roles.blocks_are_repetitions else headings.get(roles.block or ""),
            **understanding.design_facts,
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
            "notes": [*understanding.notes, *unsorted, *warnings],
            "sources": {run.run_id: dict(run.checksums) for run in runs if run.checksums},
        },
        "software": describe_software(),
    }


def _unsorted(runs: Sequence[AdoptedRun]) -> str:
    files = [f"{run.run_id}/{name}" for run in runs for name in run.unsorted]
    return f"times were not in order, or missing, in {', '.join(files)}"


def _write_journal(understanding: Understanding, folder: ExperimentFolder, runs: Sequence[AdoptedRun]) -> None:
    with Journal(folder.journal) as journal:
        journal.append("imported", name=understanding.name, table=understanding.table.path.name, runs=len(runs))
        for run, adopted in zip(understanding.runs, runs, strict=True):
            if run.status is not RunStatus.TODO:
                _write_attempt(journal, understanding, run, adopted)
        journal.append("table_written")


def _write_attempt(journal: Journal, understanding: Understanding, run: ForeignRun, adopted: AdoptedRun) -> None:
    begin, end = (adopted.stamps[stamp] or utc_now() for stamp in _STAMPS)
    which: dict[str, Any] = {"run": run.run_id, "attempt": 1}
    journal.append("attempt_started", at=begin, **which)
    if adopted.duration is not None:
        journal.append("event", at=begin, **which, event="start_measurement", clock=adopted.begun)
        stopped = adopted.begun + adopted.duration
        journal.append("event", at=end, **which, event="stop_measurement", clock=stopped)
    journal.append(
        "attempt_finished",
        at=end,
        **which,
        is_last=True,
        status="done" if run.status is RunStatus.DONE else "failed",
        seconds=adopted.duration,
        stamps={name.removesuffix("_at"): stamp for name, stamp in adopted.stamps.items() if stamp},
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
