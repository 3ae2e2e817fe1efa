"""A user's description of results from elsewhere, by options or in a TOML file; the rest is guessed."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

from robot_runner.analysis.declared_design import DeclaredDesign
from robot_runner.analysis.importing.units import TIME_UNITS, known_units, unit_of
from robot_runner.analysis.plan_file import read_toml
from robot_runner.core.errors import AnalysisError, did_you_mean


class Aggregation(Enum):
    """How a measure is computed from samples.

    INTEGRAL is over time, by the trapezoid rule; MEAN is the plain mean of the samples, TIME_MEAN the mean over time;
    ENERGY_PT is the paper's E = P x t: the mean times the duration; CHANGE is the last sample minus the first, for
    counters.
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
        """Whether the aggregation needs values, not only times."""
        return self not in {Aggregation.COUNT, Aggregation.DURATION}


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a measure is recomputed from the samples of a run.

    Attributes:
        measure: the column of the table; a new one where the table has none of that name.
        how: the aggregation.
        file: the samples' file in a run's folder.
        column: the heading in that file; empty for a count or a duration.
        is_guessed: whether the user did not give it.

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
        """The recipe in the syntax of the command line, without the measure."""
        return f"{self.how.value}({self.file}{':' if self.column else ''}{self.column})"


@dataclass(frozen=True, slots=True)
class SamplesDescription:
    """The description of one kind of raw file.

    Attributes:
        file: its name in each run's folder.
        name: the name of the samples in the experiment folder, like a plugin's name; None for the file's name.
        time: the heading of its times; None to guess it.
        time_unit: `s`, `ms`, `us`, `ns`, `min`, `h`; `iso` for dates with times of day; a format such as `%H:%M:%S`;
            None to guess it.
        units: the unit of each value column that the user gave.
    """

    file: str
    name: str | None = None
    time: str | None = None
    time_unit: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def with_options(self, said: SamplesDescription) -> SamplesDescription:
        """Return this description, overridden by the options of the command line."""
        changed = {key: value for key in ("name", "time", "time_unit") if (value := getattr(said, key))}
        return replace(self, **changed, units={**self.units, **said.units})


@dataclass(frozen=True, slots=True)
class ImportDescription:
    """A user's description of a results folder; what is None or empty is guessed.

    Attributes:
        name: the experiment's name.
        table: the run table's file, below the folder.
        run_id, status, repetition, block: columns of the table.
        factors, measures, ignore: columns of the table.
        decimal: `.` or `,`, the decimal sign of the table's numbers.
        units: units of measures, by column.
        run_folder: the path of a run's files, below the folder, with `{run_id}` in it.
        samples: the raw files.
        recipes: how measures are computed from samples.
        origin: `measured`, `simulated` or `estimated`.
        guess: whether to look for further raw files and recipes.
        design: the design by which the runs were planned; None for a full factorial, with or without blocks.
    """

    name: str | None = None
    table: str | None = None
    run_id: str | None = None
    status: str | None = None
    repetition: str | None = None
    block: str | None = None
    factors: tuple[str, ...] | None = None
    measures: tuple[str, ...] | None = None
    ignore: tuple[str, ...] = ()
    decimal: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    run_folder: str | None = None
    samples: tuple[SamplesDescription, ...] = ()
    recipes: tuple[Recipe, ...] = ()
    origin: str | None = None
    guess: bool = True
    design: DeclaredDesign | None = None

    def with_options(self, said: ImportDescription) -> ImportDescription:
        """Return this description, overridden by the options of the command line."""
        nothing = ImportDescription()
        changed = {name: value for name in self.__slots__ if (value := getattr(said, name)) != getattr(nothing, name)}
        if said.units:
            changed["units"] = {**self.units, **said.units}
        if said.samples:
            by_file = {each.file: each for each in self.samples}
            by_file |= {each.file: by_file.get(each.file, each).with_options(each) for each in said.samples}
            changed["samples"] = tuple(by_file.values())
        if said.recipes:
            given = {recipe.measure for recipe in said.recipes}
            changed["recipes"] = (*(each for each in self.recipes if each.measure not in given), *said.recipes)
        return replace(self, **changed)


_RECIPE = re.compile(
    r"\s*(?P<measure>[^=]+?)\s*=\s*(?P<how>\w+)\s*\(\s*(?P<file>[^:()]+?)\s*(?::\s*(?P<column>.+?)\s*)?\)\s*"
)


def parse_recipe(text: str) -> Recipe:
    """Parse a recipe of the form `MEASURE=HOW(FILE:COLUMN)`.

    Raises:
        AnalysisError: the text is not a recipe.
    """
    found = _RECIPE.fullmatch(text)
    if found is None:
        fix = "Write it as in energy_J=integral(power.csv:power_mW)."
        raise AnalysisError(f"{text!r} is not a recipe", where="recompute", fix=fix)
    hows = [each.value for each in Aggregation]
    if found["how"] not in hows:
        fix = did_you_mean(found["how"], hows)
        raise AnalysisError(f"there is no way {found['how']!r}", where=f"recompute {text}", fix=fix)
    how = Aggregation(found["how"])
    if how.needs_column and not found["column"]:
        fix = f"Write {how.value}({found['file']}:COLUMN)."
        raise AnalysisError(f"{text!r} names no column", where="recompute", fix=fix)
    return Recipe(found["measure"], how, found["file"], found["column"] or "")


def check_unit(unit: str, where: str) -> None:
    """Raise AnalysisError if a unit is not known."""
    if unit_of(unit) is None:
        raise AnalysisError(f"{unit!r} is not a unit that is known", where=where, fix=did_you_mean(unit, known_units()))


def check_time_unit(unit: str | None, where: str) -> None:
    """Raise AnalysisError if a unit is not one of time; None, for a unit to guess, is accepted."""
    if unit is not None and unit not in {*TIME_UNITS, "iso"} and "%" not in unit:
        fix = f"Give one of {', '.join(TIME_UNITS)}, iso, or a format such as %H:%M:%S."
        raise AnalysisError(f"times cannot be in {unit!r}", where=where, fix=fix)


# A description as a TOML file, to edit by hand or to repeat an import.

#: The entries of each table of the file, with their types. A list of one name may be written as a plain name.
_ENTRIES: dict[str, dict[str, type]] = {
    "": {
        **dict.fromkeys(("name", "table", "run_folder", "origin", "decimal"), str),
        "guess": bool,
        "columns": dict,
        "units": dict,
        "samples": list,
        "recompute": dict,
        "design": dict,
    },
    "columns.": {
        **dict.fromkeys(("run_id", "status", "repetition", "block"), str),
        **dict.fromkeys(("factors", "measures", "ignore"), tuple),
    },
    "samples.": {**dict.fromkeys(("file", "name", "time", "time_unit"), str), "units": dict},
}
_FIXES: dict[type, str] = {
    str: "Give a text.",
    bool: "Write true or false.",
    tuple: "Give a list of names.",
    dict: "Write [{key}] and its entries below it.",
    list: "Write [[{key}]] before each.",
}
_ORIGINS = ("measured", "simulated", "estimated")
_DECIMALS = (".", ",")


def read_description(path: Path) -> ImportDescription:
    """Read a description from a TOML file.

    Raises:
        AnalysisError: the file is not a description.
        StorageError: the file cannot be read.
    """
    where = str(path)
    entries = _checked(read_toml(path), "", where)
    for key, choices in (("origin", _ORIGINS), ("decimal", _DECIMALS)):
        if (given := entries.get(key, choices[0])) not in choices:
            fix = did_you_mean(given, choices) or f"Write one of {', '.join(choices)}."
            raise AnalysisError(f"{key} is {given!r}", where=where, fix=fix)
    columns = _checked(entries.pop("columns", {}), "columns.", where)
    entries["recipes"] = tuple(parse_recipe(f"{name}={how}") for name, how in entries.pop("recompute", {}).items())
    entries["samples"] = tuple(_samples(each, where) for each in entries.pop("samples", ()))
    if "design" in entries:
        entries["design"] = DeclaredDesign.of_mapping(entries["design"], f"{where}, [design]")
    return ImportDescription(**{**entries, **columns, "units": _units(entries, where)})


def _samples(plain: Any, where: str) -> SamplesDescription:
    if not isinstance(plain, dict):
        fix = "Write [[samples]] before each file."
        raise AnalysisError(f"samples holds {plain!r}, which is not a table", where=where, fix=fix)
    entries = _checked(plain, "samples.", where)
    if "file" not in entries:
        raise AnalysisError("samples names no file", where=where, fix='Write file = "power.csv".')
    check_time_unit(entries.get("time_unit"), where)
    return SamplesDescription(**{**entries, "units": _units(entries, where)})


def _checked(plain: Mapping[str, Any], table: str, where: str) -> dict[str, Any]:
    """Return the entries of a table of the file.

    Raises:
        AnalysisError: an entry is unknown, or has the wrong type.
    """
    known = _ENTRIES[table]
    entries = {}
    for key, value in plain.items():
        if key not in known:
            raise AnalysisError(f"there is no entry {table}{key}", where=where, fix=did_you_mean(key, known))
        kind = known[key]
        given = value
        if kind is tuple:
            texts = [value] if isinstance(value, str) else value
            given = tuple(texts) if isinstance(texts, list) and all(isinstance(each, str) for each in texts) else None
        if not isinstance(given, kind):
            raise AnalysisError(f"{key} is {value!r}", where=where, fix=_FIXES[kind].format(key=key))
        entries[key] = given
    return entries


def _units(entries: Mapping[str, Any], where: str) -> dict[str, str]:
    units = {str(name): str(unit) for name, unit in entries.get("units", {}).items()}
    for name, unit in units.items():
        check_unit(unit, f"{where}, unit of {name!r}")
    return units


def description_text(description: ImportDescription) -> str:
    """Return a description as the text of a TOML file."""
    said = {key: getattr(description, key) for key in ("name", "table", "run_folder", "guess", "origin", "decimal")}
    columns = {key: getattr(description, key) for key in _ENTRIES["columns."]}
    lines = ["# How results made elsewhere are to be read: robot-runner import FOLDER --description THIS_FILE"]
    lines += [*_lines(said), "", "[columns]", *_lines(columns), *_section("units", description.units)]
    for each in description.samples:
        said = {key: getattr(each, key) for key in ("file", "name", "time", "time_unit")}
        lines += ["", "[[samples]]", *_lines(said)]
        lines += _section("samples.units", each.units)
    lines += _section("recompute", {recipe.measure: recipe.words for recipe in description.recipes})
    lines += _design(description.design) if description.design is not None else []
    return "\n".join(lines) + "\n"


def _section(name: str, entries: Mapping[str, str]) -> list[str]:
    return ["", f"[{name}]", *_lines({_toml(key): value for key, value in entries.items()})] if entries else []


def _design(design: DeclaredDesign) -> list[str]:
    entries = design.as_mapping()
    tables = {key: value for key, value in entries.items() if isinstance(value, dict)}
    lines = ["", "[design]", *_lines({key: value for key, value in entries.items() if key not in tables})]
    for key, table in tables.items():
        lines += ["", f"[design.{key}]", *_lines({_toml(name): value for name, value in table.items()})]
    return lines


def _lines(entries: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_toml(value)}" for key, value in entries.items() if value is not None]


def _toml(value: Any) -> str:
    # Texts, lists of texts and truth values have the same syntax in TOML and JSON, except for DEL.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
