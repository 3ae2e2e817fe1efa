"""The raw CSV files in the runs' folders of another tool: the column of times, the samples, their units."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.importing.description import SamplesDescription
from robot_runner.analysis.importing.foreign_table import dialect_of
from robot_runner.analysis.importing.sample_times import (
    TimeKind,
    TraceSpan,
    is_number,
    nanoseconds_of,
    time_column,
    time_kind,
    time_unit,
    unit_words,
)
from robot_runner.analysis.importing.units import MISSING, TIME_UNITS, Unit, si_heading, split_heading, unit_of
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from numpy.typing import NDArray


_NUMBER = re.compile(r"\d+")
#: A name that more than one run in so many has is no process id that came up again by chance.
_FEW = 4
_MISSING = [" ", "NaN", *(written for word in MISSING for written in {word, word.upper(), word.capitalize()})]


@dataclass(frozen=True, slots=True)
class ForeignSamples:
    """The form of one kind of raw file.

    Attributes:
        file: its name in each run's folder; `*` stands for numbers that differ between runs.
        name: the name of the samples in the experiment folder.
        time: the heading of its times.
        time_unit: the unit of the times, or `iso`, `clock`, or a format.
        time_kind: the zero of the times.
        units: the unit of each value column, where it is known.
        columns: the value columns.
        numeric: the numeric ones of these.
        paths: the file of each run.
    """

    file: str
    name: str
    time: str
    time_unit: str
    time_kind: TimeKind
    units: Mapping[str, Unit | None]
    columns: tuple[str, ...]
    numeric: frozenset[str]
    paths: Mapping[str, Path] = field(repr=False)
    guesses: tuple[str, ...] = ()

    def is_of_kind(self, times: pa.ChunkedArray) -> bool:
        """Return whether the times of a run have the same kind of zero as those of the first run."""
        if self.time_unit not in TIME_UNITS:
            return not is_number(times.type) or not len(times)
        is_counted = is_number(times.type) and len(times.drop_null())
        return not is_counted or time_kind(self.time_unit, times) is self.time_kind

    def heading(self, column: str) -> str:
        """Return the heading of a column in the experiment folder, with its SI unit."""
        return si_heading(column, self.units.get(column))


@dataclass(frozen=True, slots=True)
class RunSamples:
    """The samples of one run, in the order of their times.

    Attributes:
        nanoseconds: the time of each: since 1970 for timestamps, since midnight for times of day, otherwise as counted.
        values: the columns by their original headings, numbers in SI.
        span: their extent, and what is odd about the file.
    """

    nanoseconds: NDArray[np.int64]
    values: Mapping[str, Any]
    span: TraceSpan

    @property
    def times(self) -> Floats:
        """The seconds since the first sample."""
        return (self.nanoseconds - self.nanoseconds[:1]) / 1e9


def understand_samples(
    folders: Mapping[str, Path], described: Sequence[SamplesDescription], *, guess: bool
) -> tuple[list[ForeignSamples], list[str]]:
    """Find the raw files of samples, and their form.

    Returns:
        The samples, and a note for each other file that was examined.

    Raises:
        AnalysisError: a description does not fit its file.
    """
    notes: list[str] = []
    by_file = _by_file(folders, notes)
    by_name = {each.file: each for each in described}
    for file in by_name:
        if file not in by_file:
            fix = did_you_mean(file, by_file) or "Look at the folders of the runs."
            raise AnalysisError(f"no run has a file {file!r}", where="samples", fix=fix)
    found: list[ForeignSamples] = []
    for file, paths in sorted(by_file.items()):
        if file not in by_name and not guess:
            continue
        first = next(filter(_has_rows, paths.values()), None)
        if first is None:
            notes.append(f"{file} is empty in all runs")
            continue
        try:
            understood = _understand(paths, first, by_name.get(file, SamplesDescription(file)))
        except AnalysisError as error:
            if file in by_name:
                raise
            notes.append(f"{file} is left as it is: {error.problem}")
        else:
            notes += _missing(file, paths, folders)
            found.append(replace(understood, name=_free_name(understood.name, [each.name for each in found])))
    return found, notes


def _by_file(folders: Mapping[str, Path], notes: list[str]) -> dict[str, dict[str, Path]]:
    """Return the CSV files in the runs' folders, by name.

    Names that occur in one run each, or in few, and differ only in numbers (tools put process ids and times into names)
    are combined into one name with `*` for the numbers, unless about as many runs have two of them. Those that do are
    noted: an attempt before has left one behind, and nothing tells which.
    """
    by_name: dict[str, dict[str, Path]] = {}
    for run_id, folder in folders.items():
        for path in sorted(each for each in folder.glob("*.csv") if each.is_file()):
            by_name.setdefault(path.name, {})[run_id] = path
    alike: dict[str, list[tuple[str, Path]]] = {}
    for name, paths in by_name.items():
        if len(paths) == 1 or _FEW * len(paths) <= len(folders):
            alike.setdefault(_NUMBER.sub("*", name), []).extend(paths.items())
    for pattern, found in alike.items():
        counts = Counter(run_id for run_id, _ in found)
        several = [run_id for run_id in folders if counts[run_id] > 1]
        if pattern not in by_name and len(found) > 1 and 2 * len(several) < len(counts):
            for name in {path.name for _, path in found}:
                del by_name[name]
            by_name[pattern] = {run_id: path for run_id, path in found if counts[run_id] == 1}
            if several:
                words = f"{pattern} is left as it is in {len(several)} of {counted(len(counts), 'run')}"
                which = f"such as {several[0]}, which has {counts[several[0]]} of them"
                notes.append(f"{words}, {which}: keep the one that belongs to the run")
    return by_name


def _missing(file: str, paths: Mapping[str, Path], folders: Mapping[str, Path]) -> Iterator[str]:
    """Yield notes on runs without a file that most have, and on runs where it has no samples."""
    missing = [run for run in folders if run not in paths]
    if missing and len(missing) < len(paths):
        yield f"{file} is missing in {len(missing)} of {counted(len(folders), 'run')}, such as {missing[0]}"
    empty = [run for run, path in paths.items() if not _has_rows(path)]
    if empty:
        yield f"{file} has no samples in {len(empty)} of {counted(len(paths), 'run')}, such as {empty[0]}"


def _has_rows(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(1 << 14).strip().count(b"\n") > 0


def _understand(paths: Mapping[str, Path], first: Path, described: SamplesDescription) -> ForeignSamples:
    file = described.file
    table = _read(first)
    headings = tuple(table.column_names)
    time = time_column(table, headings, described.time, file)
    times = table.column(time)
    unit = described.time_unit or time_unit(time, times, file)
    columns = tuple(name for name in headings if name not in {time, ""})
    for name in described.units:
        if name not in columns:
            raise AnalysisError(f"there is no column {name!r}", where=file, fix=did_you_mean(name, columns))
    numeric = frozenset(name for name in columns if is_number(table.column(name).type))
    guesses = [] if described.time else [f"{time} is the time"]
    guesses += [] if described.time_unit else [f"in {unit_words(unit, times)}"]
    return ForeignSamples(
        file,
        described.name or re.sub(r"[^A-Za-z0-9-]+", "_", file.removesuffix(".csv")).strip("_-") or "samples",
        time,
        unit,
        time_kind(unit, times),
        {name: _unit(name, described, is_numeric=name in numeric) for name in columns},
        columns,
        numeric,
        paths,
        tuple(guesses),
    )


def _unit(name: str, described: SamplesDescription, *, is_numeric: bool) -> Unit | None:
    if name in described.units:
        return unit_of(described.units[name])
    return split_heading(name)[1] if is_numeric else None


def _free_name(wanted: str, taken: Sequence[str]) -> str:
    folded = {each.casefold() for each in taken}
    name, number = wanted, 2
    while name.casefold() in folded:
        name, number = f"{wanted}_{number}", number + 1
    return name


def read_run_samples(samples: ForeignSamples, path: Path) -> RunSamples:
    """Read the samples of one run.

    Raises:
        AnalysisError: the file is not a table, or its times cannot be read.
    """
    is_text = samples.time_unit == "clock" or "%" in samples.time_unit
    left_out: list[object] = []
    table = _read(path, {samples.time: pa.string()} if is_text else {}, left_out)
    if samples.time not in table.column_names:
        fix = "Describe the file, or leave it out."
        raise AnalysisError(f"the file has no column {samples.time!r}", where=str(path), fix=fix)
    if not samples.is_of_kind(table.column(samples.time)):
        fix = "Correct the file, or leave it out."
        problem = f"times are of another kind than in other runs, which have {samples.time_unit}"
        raise AnalysisError(problem, where=str(path), fix=fix)
    times, valid = nanoseconds_of(table.column(samples.time), samples.time_unit, str(path))
    order = np.flatnonzero(valid)[np.argsort(times[valid], kind="stable")]
    without_number = 0
    for place, name in enumerate(table.column_names):
        column = table.column(place)
        if name in samples.numeric and not is_number(column.type):  # it has a word among its numbers
            numbers = pa.array(pd.to_numeric(column.to_pandas(), errors="coerce"), pa.float64(), from_pandas=True)
            without_number += numbers.null_count - column.null_count
            table = table.set_column(place, name, numbers)
    values = {name: _values(table, name, samples.units.get(name), order) for name in samples.columns}
    counters = (name for name, unit in samples.units.items() if unit is not None and unit.si == "J")
    restarted = tuple(name for name in counters if _starts_again(values[name]))
    impossible = 0
    for name in filter(_POWER.search, samples.numeric.intersection(values)):
        if (wrapped := _far_below_zero(values[name])).any():
            values[name] = np.where(wrapped, np.nan, values[name])
            impossible += int(np.count_nonzero(wrapped))
    kept = times[order]
    span = TraceSpan(
        samples.file,
        first=int(kept[0]) if len(kept) else 0,
        last=int(kept[-1]) if len(kept) else 0,
        is_moment=samples.time_kind is TimeKind.MOMENT,
        count=len(kept),
        was_sorted=bool(len(order) == len(times) and np.all(np.diff(times) >= 0)),
        left_out=len(left_out),
        without_number=without_number,
        moments=len(np.unique(kept)),
        restarted=restarted,
        impossible=impossible,
    )
    return RunSamples(kept, values, span)


_POWER = re.compile(r"power|watt", re.IGNORECASE)
#: Powers come of a wrapped counter if no more than this share is so low, and others are not below zero by as much.
_FEW_POWERS, _FAR_BELOW = 0.01, 3


def _far_below_zero(powers: Floats) -> NDArray[np.bool_]:
    """Return which powers are far below zero; none where more than a few are, as of a battery that discharges."""
    most = np.max(powers, initial=0.0, where=np.isfinite(powers))
    are_few = np.count_nonzero(powers < 0) <= _FEW_POWERS * len(powers)
    return (powers < -_FAR_BELOW * most) & bool(most > 0 and are_few)


#: A counter that falls at once by more than this share of its highest count has wrapped around, or was reset.
_RESTART = 0.5


def _starts_again(counts: Any) -> bool:
    """Return whether counts, which rise more often than they fall, drop at once by more than half."""
    if isinstance(counts, pa.ChunkedArray):  # words stand in its column in this run
        return False
    known = counts[np.isfinite(counts)]
    steps = np.diff(known)
    is_counter = np.count_nonzero(steps > 0) > np.count_nonzero(steps < 0)
    return bool(is_counter and np.max(-steps) > np.max(np.abs(known)) * _RESTART)


def _read(path: Path, types: Mapping[str, pa.DataType] | None = None, left_out: list[object] | None = None) -> pa.Table:
    """Read a file with the expected types, or with inferred ones where these do not fit.

    Rows with more or fewer cells than the heading are added to `left_out`.
    """
    skipped: list[object] = [] if left_out is None else left_out

    def skip(row: object) -> str:
        skipped.append(row)
        return "skip"

    dialect = dialect_of(path)
    try:
        table = arrow_csv.read_csv(
            path,
            read_options=arrow_csv.ReadOptions(
                skip_rows=dialect.blank_lines, encoding=dialect.encoding.removesuffix("-sig"), use_threads=False
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=skip),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types,
                decimal_point="," if dialect.decimal_comma else ".",
                null_values=_MISSING,
                strings_can_be_null=True,
            ),
        )
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        if types:
            skipped.clear()
            return _read(path, None, skipped)
        problem = f"the file is not a table: {str(error).partition(chr(10))[0]}"
        raise AnalysisError(problem, where=str(path), fix="Leave it out, or correct it.") from error
    table = table.rename_columns([name.lstrip("\ufeff").strip() for name in table.column_names])
    for name in filter(None, table.column_names):
        if table.column_names.count(name) > 1:
            problem = f"heading {name!r} is there twice"
            raise AnalysisError(problem, where=str(path), fix="Name each column, each differently.")
    return table


def _values(table: pa.Table, name: str, unit: Unit | None, order: Numbers) -> Any:
    if name not in table.column_names:
        return np.full(len(order), np.nan)
    column = table.column(name)
    if not is_number(column.type):
        return column.take(pa.array(order))
    values = column.to_numpy()[order]
    return values if unit is None else unit.to_si(values)
