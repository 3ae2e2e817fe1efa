"""The raw CSV files in the runs' folders of a foreign tool: which column is time, which are samples, in which unit."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.importing.foreign_table import CsvDialect, dialect_of
from robot_runner.analysis.importing.units import (
    DAY,
    Unit,
    first_moment,
    guessed_unit,
    is_absolute,
    is_number,
    named_time,
    nanoseconds_of,
    si_heading,
    split_heading,
    unit_of,
    unit_words,
    zone_words,
)
from robot_runner.core.errors import AnalysisError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from robot_runner.analysis.importing.description import SamplesDescription

__all__ = ["ForeignSamples", "RunSamples", "find_run_folders", "read_run_samples", "understand_samples"]

_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True, slots=True)
class ForeignSamples:
    """One kind of raw file, understood.

    Attributes:
        file: its name in each run's folder; `*` stands for numbers that differ from run to run.
        name: names the samples in the experiment folder.
        time: the heading of its times.
        time_unit: what they are counted in, or `iso`, `clock`, or a format.
        is_absolute: whether times are moments (since 1970, or dates), not seconds since some start.
        units: the unit of each value column, where it is known.
        columns: the value columns.
        numeric: those that hold numbers.
        paths: the file of each run.
        guesses: what nobody told.
    """

    file: str
    name: str
    time: str
    time_unit: str
    is_absolute: bool
    units: Mapping[str, Unit | None]
    columns: tuple[str, ...]
    numeric: frozenset[str]
    paths: Mapping[str, Path] = field(repr=False)
    guesses: tuple[str, ...] = ()

    def heading(self, column: str) -> str:
        """Return the heading of a column in the experiment folder, in SI."""
        return si_heading(column, self.units.get(column))


@dataclass(frozen=True, slots=True)
class RunSamples:
    """The samples of one run, in the order of their times.

    Attributes:
        nanoseconds: the time of each: since 1970 for moments, since midnight for times of day, else as counted.
        values: the columns under their own headings, numbers in SI.
        was_sorted: whether the file was in order already.
    """

    nanoseconds: NDArray[np.int64]
    values: Mapping[str, Any]
    was_sorted: bool

    @property
    def times(self) -> NDArray[np.float64]:
        """The seconds since the first sample."""
        return (self.nanoseconds - self.nanoseconds[:1]) / 1e9


def find_run_folders(root: Path, run_ids: Sequence[str], pattern: str | None) -> dict[str, Path]:
    """Return the folder of each run that has one: as told, else `<run id>` or `runs/<run id>` below the folder."""
    patterns = [pattern] if pattern else ["{run_id}", "runs/{run_id}"]
    found = {}
    for run_id in run_ids:
        for each in patterns:
            folder = root / each.replace("{run_id}", run_id)
            if folder.is_dir():
                found[run_id] = folder
                break
    return found


def understand_samples(
    folders: Mapping[str, Path], described: Sequence[SamplesDescription], *, guess: bool
) -> tuple[list[ForeignSamples], list[str]]:
    """Find out which raw files are samples, and what is in them.

    Args:
        folders: the folder of each run.
        described: what the user said of some.
        guess: whether others are looked at, too.

    Returns:
        The samples, and why files are none that look like some.

    Raises:
        AnalysisError: what the user said is not so.
    """
    by_file = _by_file(folders)
    told = {each.file: each for each in described}
    for file in told:
        if file not in by_file:
            fix = did_you_mean(file, by_file) or "Look at the folders of the runs."
            raise AnalysisError(f"no run has a file {file!r}", where="samples", fix=fix)
    found: list[ForeignSamples] = []
    notes: list[str] = []
    for file, paths in sorted(by_file.items()):
        if file in told or guess:
            understood = _understand(file, paths, told.get(file))
            (found if isinstance(understood, ForeignSamples) else notes).append(understood)  # type: ignore[arg-type]
    return _with_names_of_their_own(found), notes


def _by_file(folders: Mapping[str, Path]) -> dict[str, dict[str, Path]]:
    """Return the CSV files in the runs' folders by their names.

    Names that each occur in one run and differ by numbers only, as tools make them of process ids and times, go
    together under one with `*` for the numbers, where no run has two of them.
    """
    by_name: dict[str, dict[str, Path]] = {}
    for run_id, folder in folders.items():
        for path in sorted(folder.glob("*.csv")):
            by_name.setdefault(path.name, {})[run_id] = path
    alike: dict[str, list[tuple[str, Path]]] = {}
    for name, paths in by_name.items():
        if len(paths) == 1:
            alike.setdefault(_NUMBER.sub("*", name), []).extend(paths.items())
    for pattern, found in alike.items():
        if pattern not in by_name and 1 < len(found) == len(dict(found)):
            for _, path in found:
                del by_name[path.name]
            by_name[pattern] = dict(found)
    return by_name


def read_run_samples(samples: ForeignSamples, path: Path) -> RunSamples:
    """Read the samples of one run.

    Raises:
        AnalysisError: the file is no table, or its times cannot be read.
    """
    dialect = dialect_of(path)
    table = _read(path, dialect, _types(samples))
    if samples.time not in table.column_names:
        fix = "Describe the file, or leave it out."
        raise AnalysisError(f"it has no column {samples.time!r}", where=str(path), fix=fix)
    times, valid = nanoseconds_of(table.column(samples.time), samples.time_unit, str(path))
    if samples.time_unit == "clock":  # a run may go on past midnight
        times = times + DAY * np.cumsum(np.diff(times, prepend=times[:1]) < -DAY // 2)
    order = np.flatnonzero(valid)[np.argsort(times[valid], kind="stable")]
    was_sorted = bool(len(order) == len(times) and np.all(np.diff(times) >= 0))
    values = {name: _values(table, name, samples.units.get(name), order) for name in samples.columns}
    return RunSamples(times[order], values, was_sorted)


def _understand(file: str, paths: Mapping[str, Path], said: SamplesDescription | None) -> ForeignSamples | str:
    first = next((path for path in paths.values() if _has_rows(path)), None)
    if first is None:
        return f"{file} is empty in all runs"
    dialect = dialect_of(first)
    try:
        table = _read(first, dialect, {})
    except AnalysisError as error:
        if said is not None:
            raise
        return f"{file} is left as it is: {error.problem}"
    headings = tuple(name.strip() for name in table.column_names)
    time = said.time if said and said.time else named_time(headings) or first_moment(table)
    if time is None or time not in headings:
        if said is None:
            return f"{file} is left as it is: no column is told to be the time"
        fix = did_you_mean(time or "", headings)
        raise AnalysisError(f"there is no column {time!r} for the time", where=file, fix=fix)
    guesses = [] if said and said.time else [f"{time} is the time"]
    unit = said.time_unit if said and said.time_unit else guessed_unit(time, table.column(time))
    if unit is None:
        if said is None:
            return f"{file} is left as it is: the times in {time} cannot be read"
        raise AnalysisError(f"the times in {time} cannot be read", where=file, fix="Give time_unit.")
    if not (said and said.time_unit):
        guesses.append(f"in {unit_words(unit)}{zone_words(table.column(time))}")
    columns = tuple(name for name in headings if name != time and name)
    _check_units(said, columns, file)
    return ForeignSamples(
        file,
        said.name if said and said.name else _plugin_name(file),
        time,
        unit,
        is_absolute(unit, table.column(time)),
        {name: _unit(name, said, table) for name in columns},
        columns,
        frozenset(name for name in columns if is_number(table.column(name).type)),
        paths,
        tuple(guesses),
    )


def _has_rows(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(1 << 14).strip().count(b"\n") > 0


def _read(path: Path, dialect: CsvDialect, types: Mapping[str, pa.DataType]) -> pa.Table:
    options: dict[str, Any] = {
        "read_options": arrow_csv.ReadOptions(
            skip_rows=dialect.blank_lines, encoding=dialect.encoding.removesuffix("-sig"), use_threads=False
        ),
        "parse_options": arrow_csv.ParseOptions(
            delimiter=dialect.delimiter, invalid_row_handler=_skip, newlines_in_values=False
        ),
    }
    point = "," if dialect.decimal_comma else "."
    for column_types in (types, {}) if types else ({},):
        convert = arrow_csv.ConvertOptions(
            column_types=dict(column_types),
            decimal_point=point,
            null_values=["", " ", "NA", "N/A", "NaN", "nan", "null"],
            strings_can_be_null=True,
        )
        try:
            table = arrow_csv.read_csv(path, convert_options=convert, **options)
        except pa.ArrowInvalid as error:
            problem = str(error).partition("\n")[0]
        else:
            return table.rename_columns([name.lstrip("\ufeff").strip() for name in table.column_names])
    raise AnalysisError(f"it is no table: {problem}", where=str(path), fix="Leave it out, or mend it.")


def _skip(row: object) -> str:
    del row
    return "skip"


def _types(samples: ForeignSamples) -> dict[str, pa.DataType]:
    is_text = samples.time_unit == "clock" or "%" in samples.time_unit
    return {samples.time: pa.string()} if is_text else {}


def _plugin_name(file: str) -> str:
    return re.sub(r"[^A-Za-z0-9-]+", "_", file.removesuffix(".csv")).strip("_-") or "samples"


def _with_names_of_their_own(samples: Sequence[ForeignSamples]) -> list[ForeignSamples]:
    taken: set[str] = set()
    named = []
    for each in samples:
        name, number = each.name, 2
        while name.casefold() in taken:
            name, number = f"{each.name}_{number}", number + 1
        taken.add(name.casefold())
        named.append(replace(each, name=name))
    return named


def _check_units(said: SamplesDescription | None, columns: Sequence[str], file: str) -> None:
    for name in said.units if said else ():
        if name not in columns:
            raise AnalysisError(f"there is no column {name!r}", where=file, fix=did_you_mean(name, columns))


def _unit(name: str, said: SamplesDescription | None, table: pa.Table) -> Unit | None:
    if said and name in said.units:
        return unit_of(said.units[name])
    return split_heading(name)[1] if is_number(table.column(name).type) else None


def _values(table: pa.Table, name: str, unit: Unit | None, order: NDArray[np.intp]) -> Any:
    if name not in table.column_names:
        return np.full(len(order), np.nan)
    column = table.column(name)
    if not is_number(column.type):
        return column.take(pa.array(order))
    values = column.to_numpy()[order]
    return values if unit is None else unit.to_si(values)
