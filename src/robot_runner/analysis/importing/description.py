"""What a user says about results made elsewhere; the rest is found out."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.units import TIME_UNITS, known_units, unit_of
from robot_runner.core.errors import AnalysisError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = [
    "Aggregation",
    "ImportDescription",
    "Recipe",
    "SamplesDescription",
    "check_time_unit",
    "check_unit",
    "parse_recipe",
]


class Aggregation(Enum):
    """How a measure comes out of samples.

    INTEGRAL is over time, by the trapezoid rule; MEAN is of the samples as they are, TIME_MEAN over time; ENERGY_PT is
    the paper's E = P x t: the mean times the duration; CHANGE is the last sample less the first, for counters.
    """

    INTEGRAL = "integral"
    MEAN = "mean"
    TIME_MEAN = "time_mean"
    ENERGY_PT = "mean_times_duration"
    SUM = "sum"
    MIN = "min"
    MAX = "max"
    MEDIAN = "median"
    CHANGE = "change"
    COUNT = "count"
    DURATION = "duration"

    @property
    def needs_column(self) -> bool:
        """Whether it is computed from values, not from times alone."""
        return self not in {Aggregation.COUNT, Aggregation.DURATION}


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a measure is recomputed from the samples of a run.

    Attributes:
        measure: the column of the table; a new one where it has none of that name.
        how: the aggregation.
        file: the samples' file in a run's folder.
        column: the heading in that file; empty for a count or a duration.
        is_guessed: whether nobody said so.

    Example:
        >>> parse_recipe("energy_J=integral(power.csv:power_mW)").how
        <Aggregation.INTEGRAL: 'integral'>
    """

    measure: str
    how: Aggregation
    file: str
    column: str = ""
    is_guessed: bool = False

    @property
    def words(self) -> str:
        """The recipe as it is written on the command line, without the measure."""
        return f"{self.how.value}({self.file}{':' if self.column else ''}{self.column})"


@dataclass(frozen=True, slots=True)
class SamplesDescription:
    """What is said about one kind of raw file.

    Attributes:
        file: its name in each run's folder.
        name: names the samples in the experiment folder, as a plugin's name does; None for the file's name.
        time: the heading of its times; None to find it out.
        time_unit: `s`, `ms`, `us`, `ns`, `min`, `h`; `iso` for dates with times of day; a format such as `%H:%M:%S`;
            None to find it out.
        units: the unit of each value column that has been told.
    """

    file: str
    name: str | None = None
    time: str | None = None
    time_unit: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ImportDescription:
    """Everything that a user says about a results folder; None, or empty, is to be found out.

    Attributes:
        name: the experiment's name.
        table: the run table's file, below the folder.
        run_id, status, repetition: columns of the table.
        factors, measures, ignore: columns of the table.
        units: units of measures, by column.
        run_folder: where a run's files are, below the folder, with `{run_id}` in it.
        samples: the raw files.
        recipes: which measure comes out of which samples.
        origin: `measured`, `simulated` or `estimated`.
        guess: whether raw files and recipes that nobody mentioned are looked for.
    """

    name: str | None = None
    table: str | None = None
    run_id: str | None = None
    status: str | None = None
    repetition: str | None = None
    factors: tuple[str, ...] | None = None
    measures: tuple[str, ...] | None = None
    ignore: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    run_folder: str | None = None
    samples: tuple[SamplesDescription, ...] = ()
    recipes: tuple[Recipe, ...] = ()
    origin: str | None = None
    guess: bool = True

    def with_options(self, said: ImportDescription) -> ImportDescription:
        """Return this description with what was said on the command line instead, where anything was."""
        nothing = ImportDescription()
        changed = {name: value for name in self.__slots__ if (value := getattr(said, name)) != getattr(nothing, name)}
        if said.units:
            changed["units"] = {**self.units, **said.units}
        if said.samples:
            changed["samples"] = _merged(self.samples, said.samples)
        if said.recipes:
            told = {recipe.measure for recipe in said.recipes}
            changed["recipes"] = (*(each for each in self.recipes if each.measure not in told), *said.recipes)
        return replace(self, **changed)


_RECIPE = re.compile(
    r"\s*(?P<measure>[^=]+?)\s*=\s*(?P<how>\w+)\s*\(\s*(?P<file>[^:()]+?)\s*(?::\s*(?P<column>.+?)\s*)?\)\s*"
)


def parse_recipe(text: str) -> Recipe:
    """Return the recipe that is written as `MEASURE=HOW(FILE:COLUMN)`.

    Raises:
        AnalysisError: it is no recipe.
    """
    found = _RECIPE.fullmatch(text)
    if found is None:
        fix = "Write it as in energy_J=integral(power.csv:power_mW)."
        raise AnalysisError(f"{text!r} is no recipe", where="recompute", fix=fix)
    hows = [each.value for each in Aggregation]
    if found["how"] not in hows:
        raise AnalysisError(
            f"there is no way {found['how']!r}", where=f"recompute {text}", fix=did_you_mean(found["how"], hows)
        )
    how = Aggregation(found["how"])
    if how.needs_column and not found["column"]:
        fix = f"Write {how.value}({found['file']}:COLUMN)."
        raise AnalysisError(f"{text!r} names no column", where="recompute", fix=fix)
    return Recipe(found["measure"], how, found["file"], found["column"] or "")


def check_unit(unit: str, where: str) -> None:
    """Refuse a unit that is not known.

    Raises:
        AnalysisError: it is none.
    """
    if unit_of(unit) is None:
        raise AnalysisError(f"{unit!r} is no unit that is known", where=where, fix=did_you_mean(unit, known_units()))


def check_time_unit(unit: str | None, where: str) -> None:
    """Refuse a unit of times that is not known.

    Raises:
        AnalysisError: it is none.
    """
    if unit is not None and unit not in {*TIME_UNITS, "iso"} and "%" not in unit:
        fix = f"Give one of {', '.join(TIME_UNITS)}, iso, or a format such as %H:%M:%S."
        raise AnalysisError(f"times cannot be in {unit!r}", where=where, fix=fix)


def _merged(
    described: Sequence[SamplesDescription], said: Sequence[SamplesDescription]
) -> tuple[SamplesDescription, ...]:
    by_file = {each.file: each for each in described}
    for each in said:
        before = by_file.get(each.file, SamplesDescription(each.file))
        by_file[each.file] = SamplesDescription(
            each.file,
            name=each.name or before.name,
            time=each.time or before.time,
            time_unit=each.time_unit or before.time_unit,
            units={**before.units, **each.units},
        )
    return tuple(by_file.values())
