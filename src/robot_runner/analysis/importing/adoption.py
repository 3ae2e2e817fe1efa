"""Write understood results as an experiment folder; the originals are only read."""

from __future__ import annotations

import csv
import hashlib
import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.importing.description import description_text
from robot_runner.analysis.importing.foreign_samples import ForeignSamples, RunSamples, read_run_samples
from robot_runner.analysis.importing.foreign_table import free_heading
from robot_runner.analysis.importing.recomputation import Difference, recompute, unit_of_recipe
from robot_runner.analysis.importing.sample_times import TimeKind, TraceSpan, trace_warnings
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.factor import Combination, factor_places
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.cells import CellValue, RunStatus, quoted, typed_value
from robot_runner.core.storage.guarded_files import make_experiment_folder
from robot_runner.core.storage.journal import Journal, utc_now
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import describe_software, write_manifest
from robot_runner.core.storage.run_table_rows import RunRow, RunTableRows, write_run_table
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole, FactorColumn, TableLayout
from robot_runner.core.storage.table_schema import describe_columns, write_schema

if TYPE_CHECKING:
    from robot_runner.analysis.importing.foreign_runs import ForeignRun
    from robot_runner.analysis.importing.understanding import Understanding

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
        checksums: SHA-256 of each original file.
    """

    run_id: str
    started_at: int | None = None
    begun: float = 0.0
    duration: float | None = None
    recomputed: Mapping[str, float | None] = field(default_factory=dict)
    spans: tuple[TraceSpan, ...] = ()
    checksums: Mapping[str, str] = field(default_factory=dict)

    @property
    def stamps(self) -> dict[str, str | None]:
        """The time stamps of the measurement, for the run table."""
        if self.started_at is None:
            return dict.fromkeys(_STAMPS)
        ends = (self.started_at, self.started_at + round((self.duration or 0.0) * 1e9))
        moments = (datetime.fromtimestamp(end // 10**6 / 1000, UTC).isoformat(timespec="milliseconds") for end in ends)
        return {name: text.replace("+00:00", "Z") for name, text in zip(_STAMPS, moments, strict=True)}


@dataclass(frozen=True, slots=True)
class Adoption:
    """An import that was carried out.

    Attributes:
        differences: each value of the table with the recomputed one.
        warnings: anomalies of the raw files.
    """

    folder: Path
    runs: tuple[AdoptedRun, ...]
    differences: tuple[Difference, ...]
    warnings: tuple[str, ...] = ()


def adopt(understanding: Understanding, target: Path) -> Adoption:
    """Write an experiment folder.

    Raises:
        StorageError: the target exists, or cannot be written.
        AnalysisError: a raw file does not have the form that was understood.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise StorageError("there is something already", where=str(target), fix="Choose another folder: --to FOLDER.")
    if understanding.root.resolve() in (target.resolve(), *target.resolve().parents):
        problem = "the new folder would be inside of the results, which are not to be changed"
        raise StorageError(problem, where=str(target), fix="Choose a folder outside of them: --to FOLDER.")
    beside = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    try:
        make_experiment_folder(beside)
        adopted = _write(understanding, ExperimentFolder(beside), target)
        beside.replace(target)
    except OSError as error:
        raise storage_error(target, "written", error) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return adopted


def _write(understanding: Understanding, folder: ExperimentFolder, target: Path) -> Adoption:
    folder.runs.mkdir()
    runs = tuple(_adopted(understanding, folder, run) for run in understanding.runs)
    warnings = tuple(trace_warnings(understanding.runs, {run.run_id: run.spans for run in runs}, understanding.units))
    differences = tuple(_differences(understanding, runs))
    rows = _rows(understanding, runs)
    write_run_table(folder.run_table, rows)
    write_schema(folder.schema, describe_columns(rows, _known(understanding)))
    write_manifest(folder.manifest, _manifest(understanding, runs, warnings))
    _write_journal(understanding, folder, runs)
    beside = folder.root / "import"
    beside.mkdir()
    description = description_text(understanding.description)
    write_beside_and_rename(beside / "description.toml", lambda file: file.write(description))
    _write_differences(understanding, beside / "differences.csv", differences)
    return Adoption(target, runs, differences, warnings)


def _adopted(understanding: Understanding, experiment: ExperimentFolder, run: ForeignRun) -> AdoptedRun:
    if run.folder is None:
        return AdoptedRun(run.run_id)
    folder = experiment.run(run.run_id)
    known = {path: each for each in understanding.samples if (path := each.paths.get(run.source_id)) is not None}
    everything = [(each, read_run_samples(each, path)) for path, each in known.items()]
    samples = [(each, read) for each, read in everything if len(read.nanoseconds)]
    zeros = _zeros(samples)
    for (each, read), zero in zip(samples, zeros, strict=True):
        _write_samples(each, read, zero, folder / each.name)
    files = sorted(path for path in run.folder.iterdir() if path.is_file())
    for path in files:
        if path not in known:
            (folder / "original").mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, folder / "original" / path.name)
    by_file = {each.file: read for each, read in samples}
    begun, ended = (
        [float(read.nanoseconds[edge] - zero) / 1e9 for (_, read), zero in zip(samples, zeros, strict=True)]
        for edge in (0, -1)
    )
    # Times below 0 are from before the mission, which begins at 0.
    first = 0.0 if min(begun, default=0.0) <= 0 <= max(ended, default=0.0) else min(begun)
    moments = (zero for (each, _), zero in zip(samples, zeros, strict=True) if each.time_kind is TimeKind.MOMENT)
    return AdoptedRun(
        run.run_id,
        started_at=next(moments, None),
        begun=first,
        duration=max(ended) - first if samples else None,
        recomputed={
            recipe.measure: recompute(recipe, by_file[recipe.file]) if recipe.file in by_file else None
            for recipe in understanding.recipes
        },
        spans=tuple(read.span for _, read in everything),
        checksums={path.name: _checksum(path) for path in files},
    )


def _zeros(samples: Sequence[tuple[ForeignSamples, RunSamples]]) -> list[int]:
    """Return the zero of each file's times, ns: the first timestamp, or time of day, of all files.

    Times that count from an arbitrary start keep their zero, unless they begin when the samples of other files are
    over: then they count from before the run, as from the start of the computer, and are set beside the others.
    """
    firsts: dict[TimeKind, int] = {}
    for each, read in samples:
        first = 0 if each.time_kind is TimeKind.COUNTED else int(read.nanoseconds[0])
        firsts[each.time_kind] = min(firsts.get(each.time_kind, first), first)
    zeros = [firsts[each.time_kind] for each, _ in samples]
    ends: list[int] = []
    before = 0
    for place in sorted(range(len(samples)), key=lambda place: int(samples[place][1].nanoseconds[0]) - zeros[place]):
        (each, read), zero = samples[place], zeros[place]
        first, last = (int(read.nanoseconds[edge]) - zero for edge in (0, -1))
        if each.time_kind is TimeKind.COUNTED:
            before = first if ends and first - before > max(ends) else before
            zeros[place] += before
        ends.append(last + zero - zeros[place])
    return zeros


def _write_samples(samples: ForeignSamples, run: RunSamples, zero: int, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    columns: dict[str, Any] = {"time_s": (run.nanoseconds - zero) / 1e9}
    for name, values in run.values.items():
        # Texts are Arrow arrays already; of numbers, a missing one becomes an empty cell.
        column = values if isinstance(values, pa.ChunkedArray) else pa.array(values, from_pandas=True)
        columns[free_heading(samples.heading(name), columns)] = column
    with (folder / "samples.csv").open("wb") as file:
        file.write(",".join(map(quoted, columns)).encode() + b"\n")
        begun = file.tell()
        try:
            arrow_csv.write_csv(pa.table(columns), file, _written("none"))
        except pa.ArrowInvalid:  # a text has a comma, a quote or a line break
            file.seek(begun)
            file.truncate()
            arrow_csv.write_csv(pa.table(columns), file, _written("needed"))


def _written(quoting: str) -> arrow_csv.WriteOptions:
    return arrow_csv.WriteOptions(include_header=False, quoting_style=quoting)


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _differences(understanding: Understanding, runs: Sequence[AdoptedRun]) -> Iterator[Difference]:
    for run, adopted in zip(understanding.runs, runs, strict=True):
        for measure, recomputed in adopted.recomputed.items():
            value = run.measures.get(measure)
            if recomputed is None or isinstance(value, str | bool) or value is None:
                continue
            unit = understanding.units.get(measure)
            in_si = float(unit.to_si(value) if unit else value)
            yield Difference(run.run_id, measure, in_si, recomputed, unit.si if unit else "")


# The records: run table, schema, manifest, journal, differences.


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
    unsorted = [f"{run.run_id}/{each.file}" for run in runs for each in run.spans if each.count and not each.was_sorted]
    notes = [f"times were not in order, or missing, in {', '.join(unsorted)}"] if unsorted else []
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
            "notes": [*understanding.notes, *notes, *warnings],
            "sources": {run.run_id: dict(run.checksums) for run in runs if run.checksums},
        },
        "software": describe_software(),
    }


def _write_journal(understanding: Understanding, folder: ExperimentFolder, runs: Sequence[AdoptedRun]) -> None:
    now = utc_now()
    with Journal(folder.journal) as journal:
        journal.append("imported", name=understanding.name, table=understanding.table.path.name, runs=len(runs))
        for run, adopted in zip(understanding.runs, runs, strict=True):
            if run.status is not RunStatus.TODO:
                _write_attempt(journal, understanding, run, adopted, now)
        journal.append("table_written")


def _write_attempt(
    journal: Journal, understanding: Understanding, run: ForeignRun, adopted: AdoptedRun, now: str
) -> None:
    begin, end = (adopted.stamps[stamp] or now for stamp in _STAMPS)
    which: dict[str, Any] = {"run": run.run_id, "attempt": 1}
    journal.append("attempt_started", at=begin, **which)
    if adopted.duration is not None:
        journal.append("event", at=begin, **which, event="start_measurement", clock=adopted.begun)
        journal.append("event", at=end, **which, event="stop_measurement", clock=adopted.begun + adopted.duration)
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
        if name in run.measures:  # the heading may name another unit
            unit = understanding.units.get(name)
            heading += f" (recomputed, {unit.si})" if unit else " (recomputed)"
        values[heading] = recomputed
    return {name: {"value": each, "owner": _OWNER, "origin": understanding.origin} for name, each in values.items()}


def _write_differences(understanding: Understanding, path: Path, differences: Sequence[Difference]) -> None:
    def write(file: Any) -> None:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["run_id", "measure", "unit", "table", "recomputed", "difference", "relative_difference"])
        for each in differences:
            values = (each.table, each.recomputed, each.absolute, "" if each.relative is None else each.relative)
            lines.writerow([each.run_id, understanding.headings[each.measure], each.unit, *values])

    write_beside_and_rename(path, write)
