"""Writing what was understood as an experiment folder of our own format; the originals are only read."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.importing.adopted_records import write_records
from robot_runner.analysis.importing.foreign_samples import ForeignSamples, RunSamples, read_run_samples
from robot_runner.analysis.importing.recomputation import Difference, recompute
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.cells import quoted
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.safe_write import storage_error

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.analysis.importing.foreign_runs import ForeignRun
    from robot_runner.analysis.importing.understanding import Understanding

__all__ = ["AdoptedRun", "Adoption", "adopt"]


@dataclass(frozen=True, slots=True)
class AdoptedRun:
    """What came of the raw files of one run.

    Attributes:
        started_at: when its first sample was taken, nanoseconds since 1970; None where that is not known.
        duration: s, from the first sample to the last; None without samples.
        recomputed: the measures that were computed from samples, in SI.
        unsorted: the files whose times were not in order.
        checksums: SHA-256 of each original file.
    """

    run_id: str
    started_at: int | None = None
    duration: float | None = None
    recomputed: Mapping[str, float | None] = field(default_factory=dict)
    unsorted: tuple[str, ...] = ()
    checksums: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Adoption:
    """An import that was carried out.

    Attributes:
        folder: the experiment folder that was written.
        runs: what came of each run's raw files.
        differences: each value of the table beside the recomputed one.
    """

    folder: Path
    runs: tuple[AdoptedRun, ...]
    differences: tuple[Difference, ...]


def adopt(understanding: Understanding, target: Path, *, progress: Callable[[int], None] = lambda _: None) -> Adoption:
    """Write an experiment folder.

    Args:
        understanding: what was understood of the results.
        target: the folder to make; it must not exist, or be empty.
        progress: told how many runs have been read.

    Raises:
        StorageError: the target is taken, or cannot be written.
        AnalysisError: a raw file is not what it was understood to be.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise StorageError("there is something already", where=str(target), fix="Choose another folder: --to FOLDER.")
    if understanding.root.resolve() in (target.resolve(), *target.resolve().parents):
        fix = "Choose a folder outside of it: --to FOLDER."
        raise StorageError("it is inside of the results, which are not to be changed", where=str(target), fix=fix)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        raise storage_error(target, "made", error) from error
    try:
        adopted = _write(understanding, ExperimentFolder(beside), progress)
        beside.chmod(0o755)
        beside.replace(target)
    except OSError as error:
        raise storage_error(target, "written", error) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return Adoption(target, adopted.runs, adopted.differences)


def _write(understanding: Understanding, folder: ExperimentFolder, progress: Callable[[int], None]) -> Adoption:
    folder.runs.mkdir()
    runs = []
    for count, run in enumerate(understanding.runs, start=1):
        runs.append(_adopted(understanding, folder, run))
        progress(count)
    differences = tuple(_differences(understanding, runs))
    write_records(understanding, folder, runs, differences)
    return Adoption(folder.root, tuple(runs), differences)


def _adopted(understanding: Understanding, folder: ExperimentFolder, run: ForeignRun) -> AdoptedRun:
    if run.folder is None:
        return AdoptedRun(run.run_id)
    samples = {path: each for each in understanding.samples if (path := each.paths.get(run.source_id)) is not None}
    read = {each.file: read_run_samples(each, path) for path, each in samples.items()}
    known = {each.file: each for each in samples.values()}
    filled = {name: values for name, values in read.items() if len(values.nanoseconds)}
    zeros = _zeros(known, filled)
    for name, values in filled.items():
        _write_samples(known[name], values, zeros[name], folder.run(run.run_id) / known[name].name)
    files = sorted(path for path in run.folder.iterdir() if path.is_file())
    for path in files:
        if path not in samples:
            _copy(path, folder.run(run.run_id) / "original" / path.name)
    moments = [int(each.nanoseconds[0]) for name, each in filled.items() if _is_moment(known[name])]
    ends = [float(each.nanoseconds[-1] - zeros[name]) / 1e9 for name, each in filled.items()]
    return AdoptedRun(
        run.run_id,
        started_at=min(moments, default=None),
        duration=max(ends, default=None),
        recomputed={
            recipe.measure: recompute(recipe, filled[recipe.file]) if recipe.file in filled else None
            for recipe in understanding.recipes
        },
        unsorted=tuple(name for name, each in filled.items() if not each.was_sorted),
        checksums={path.name: _checksum(path) for path in files},
    )


def _zeros(known: Mapping[str, ForeignSamples], read: Mapping[str, RunSamples]) -> dict[str, int]:
    """Return the time that is 0 on the run's clock, for each file: moments have one in common, times of day another.

    Times that are counted from some start are left as they are.
    """
    firsts: dict[str, int] = {}
    for name, samples in read.items():
        kind = _kind(known[name])
        firsts[kind] = min(firsts.get(kind, int(samples.nanoseconds[0])), int(samples.nanoseconds[0]))
    return {name: firsts[_kind(known[name])] if known[name].is_absolute else 0 for name in read}


def _kind(samples: ForeignSamples) -> str:
    return "clock" if samples.time_unit == "clock" else "moment" if samples.is_absolute else "counted"


def _is_moment(samples: ForeignSamples) -> bool:
    return _kind(samples) == "moment"


def _write_samples(samples: ForeignSamples, run: RunSamples, zero: int, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    columns: dict[str, Any] = {"time_s": (run.nanoseconds - zero) / 1e9}
    for name, values in run.values.items():
        columns[_free(samples.heading(name), columns)] = (
            values if isinstance(values, pa.ChunkedArray) else _filled(values)
        )
    with (folder / "samples.csv").open("wb") as file:
        file.write(",".join(map(quoted, columns)).encode() + b"\n")
        _write_rows(pa.table(columns), file)


def _filled(values: Any) -> pa.Array:
    """Return numbers so that a missing one is written as an empty cell."""
    return pa.array(values, from_pandas=True)


def _write_rows(table: pa.Table, file: BinaryIO) -> None:
    begun = file.tell()
    try:
        arrow_csv.write_csv(table, file, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))
    except pa.ArrowInvalid:  # a text holds a comma, a quote or the end of a line
        file.seek(begun)
        file.truncate()
        arrow_csv.write_csv(table, file, arrow_csv.WriteOptions(include_header=False, quoting_style="needed"))


def _free(heading: str, taken: Mapping[str, Any]) -> str:
    while heading in taken:
        heading += "_"
    return heading


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _differences(understanding: Understanding, runs: list[AdoptedRun]) -> list[Difference]:
    found = []
    for run, adopted in zip(understanding.runs, runs, strict=True):
        for measure, recomputed in adopted.recomputed.items():
            value = run.measures.get(measure)
            if recomputed is None or isinstance(value, str | bool) or value is None:
                continue
            unit = understanding.units.get(measure)
            in_si = unit.to_si(value) if unit else value
            found.append(Difference(run.run_id, measure, float(in_si), recomputed))
    return found
