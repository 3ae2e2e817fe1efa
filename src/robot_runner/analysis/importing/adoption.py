"""Write understood results as an experiment folder; the originals are only read."""

from __future__ import annotations

import hashlib
import secrets
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.importing.adopted_records import AdoptedRun, write_records
from robot_runner.analysis.importing.foreign_samples import ForeignSamples, RunSamples, read_run_samples
from robot_runner.analysis.importing.foreign_table import free_heading
from robot_runner.analysis.importing.recomputation import Difference, recompute
from robot_runner.analysis.importing.sample_times import TimeKind, TraceSpan, trace_warnings
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.cells import quoted
from robot_runner.core.storage.guarded_files import make_experiment_folder
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.system_refusals import storage_error

if TYPE_CHECKING:
    from robot_runner.analysis.importing.foreign_runs import ForeignRun
    from robot_runner.analysis.importing.understanding import Understanding


@dataclass(frozen=True, slots=True)
class Adoption:
    """An import that was carried out.

    Attributes:
        folder: the experiment folder that was written.
        runs: the contents of each run's raw files.
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
    runs = [_adopted(understanding, folder.run(run.run_id), run) for run in understanding.runs]
    warnings = trace_warnings(understanding.runs, {run.run_id: run.spans for run in runs}, understanding.units)
    adoption = Adoption(target, tuple(runs), tuple(_differences(understanding, runs)), tuple(warnings))
    write_records(understanding, folder, adoption.runs, adoption.differences, warnings)
    return adoption


def _adopted(understanding: Understanding, folder: Path, run: ForeignRun) -> AdoptedRun:
    if run.folder is None:
        return AdoptedRun(run.run_id)
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
        spans=tuple(_span(each, read) for each, read in everything),
        unsorted=tuple(each.file for each, read in samples if not read.was_sorted),
        checksums={path.name: _checksum(path) for path in files},
    )


def _span(samples: ForeignSamples, run: RunSamples) -> TraceSpan:
    first, last = (int(run.nanoseconds[0]), int(run.nanoseconds[-1])) if len(run.nanoseconds) else (0, 0)
    is_moment = samples.time_kind is TimeKind.MOMENT
    return TraceSpan(
        samples.file,
        first,
        last,
        is_moment,
        count=len(run.nanoseconds),
        left_out=run.left_out,
        without_number=run.without_number,
        moments=len(np.unique(run.nanoseconds)),
        restarted=run.restarted,
        impossible=run.impossible,
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
            yield Difference(run.run_id, measure, float(unit.to_si(value) if unit else value), recomputed)
