"""Measures: what a run yields, as declared by a plugin or a config and as published in a run."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from numbers import Integral, Real

from robot_runner.core.design.columns import NamedColumn, name_findings
from robot_runner.core.errors import Finding, MeasureError, did_you_mean
from robot_runner.core.words import exact

#: What a cell of the run table can hold. None is a missing value: an empty cell.
MeasureValue = int | float | bool | str | None

#: A larger integer is a mistake, and readers of the table would take it for infinity.
_LARGEST = sys.float_info.max
#: Longer texts, such as a whole log, make the run table larger than its readers take, after some runs.
_LONGEST_TEXT = 1_000_000


class Origin(Enum):
    """Where a value comes from, so that no simulated or estimated value passes for a measured one."""

    MEASURED = "measured"
    SIMULATED = "simulated"
    ESTIMATED = "estimated"
    ENTERED = "entered by hand"


class Over(Enum):
    """How the values of several windows are combined into one, for a phase that a mission has several times."""

    SUM = "sum"
    MEAN = "mean"
    MINIMUM = "minimum"
    MAXIMUM = "maximum"


@dataclass(frozen=True, slots=True)
class Measure:
    """One named value that each run yields (a dependent variable).

    Attributes:
        name: the column of the run table, such as `Energy`.
        unit: SI symbol, `%` for percentages (0..100), `1` for counts and ratios, empty where there is none.
        description: one sentence: what it is and how it is aggregated from the raw samples.
        over: how the values of several windows are combined into one (a mean is weighted by their durations); None for
            a measure that has no value for a part of the mission.
        low: the least plausible value; one below it is kept, and doubtful.
        high: the largest plausible value; one above it is kept, and doubtful.

    Raises:
        MeasureError: an attribute is invalid; `findings` lists all problems.

    Example:
        >>> Measure("Energy", "J", "Energy drawn from the battery over the measured window.")
        Measure(name='Energy', unit='J', description='Energy drawn from the battery over the measured window.')
    """

    name: str
    unit: str = ""
    description: str = ""
    over: Over | None = field(default=None, kw_only=True, repr=False)
    low: float | None = field(default=None, kw_only=True, repr=False)
    high: float | None = field(default=None, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        MeasureError.refuse(self._findings())

    def _findings(self) -> Iterator[Finding]:
        where = f"measure {self.name!r}"
        yield from name_findings(self.name, kind="measure")
        for name, value in (("unit", self.unit), ("description", self.description)):
            if not isinstance(value, str):
                yield Finding.error(where, f"{name} is {value!r}", "Give a text.")
        if self.over is not None and not isinstance(self.over, Over):
            yield Finding.error(where, f"over is {self.over!r}", did_you_mean(str(self.over), map(str, Over)))
        limits = {name: value for name, value in (("low", self.low), ("high", self.high)) if value is not None}
        wrong = [
            name
            for name, each in limits.items()
            if isinstance(each, bool) or not isinstance(each, Real) or math.isnan(each)
        ]
        for name in wrong:
            yield Finding.error(where, f"{name} is {limits[name]!r}", "Give a number, or leave it out.")
        if not wrong and self.low is not None and self.high is not None and self.low > self.high:
            problem = f"no value can be plausible: low is {self.low!r}, and high is {self.high!r}"
            yield Finding.error(where, problem, "Give low the smaller number.")

    def implausible(self, value: MeasureValue) -> str:
        """Return why a value is not plausible; empty where it is, or is not a number.

        Example:
            >>> Measure("MeanPower", "W", "Mean power.", low=0.5, high=25.0).implausible(31.0)
            'the value, 31 W, is above 25 W, the largest that is plausible'
        """
        if isinstance(value, bool) or not isinstance(value, int | float):
            return ""
        if self.low is not None and value < self.low:
            return f"the value, {self._told(value)}, is below {self._told(self.low)}, the least that is plausible"
        if self.high is not None and value > self.high:
            return f"the value, {self._told(value)}, is above {self._told(self.high)}, the largest that is plausible"
        return ""

    def _told(self, value: float) -> str:
        return f"{exact(value)} {self.unit}".rstrip()  # exact: rounded, it might look plausible

    def in_phase(self, phase: str) -> Measure:
        """Return the same measure for one phase; a sum and a maximum may be less there than the least of a mission.

        Example:
            >>> from robot_runner.plugins import Over
            >>> Measure("Energy", "J", "Energy drawn.", over=Over.SUM).in_phase("navigate").name
            'Energy.navigate'
        """
        low = None if self.over in {Over.SUM, Over.MAXIMUM} and (self.low or 0) > 0 else self.low
        return replace(self, name=f"{self.name}.{phase}", description=f"In phase {phase}: {self.description}", low=low)


def with_phases(measures: Sequence[Measure], phases: Sequence[str]) -> tuple[Measure, ...]:
    """Return the measures, followed by those of each phase, for measures that can have a value per phase."""
    return (*measures, *(each.in_phase(phase) for each in measures if each.over is not None for phase in phases))


@dataclass(frozen=True, slots=True)
class PublishedMeasure:
    """A measure's value in one run, with its publisher, its origin, and why it is doubtful, or missing, if it is."""

    name: str
    value: MeasureValue
    owner: str
    unit: str = ""
    origin: Origin = Origin.MEASURED
    doubts: tuple[str, ...] = ()

    @property
    def quality(self) -> Quality:
        """How far the value can be trusted."""
        return quality_of_value(self.value, self.doubts)


class Quality(Enum):
    """How far a value can be trusted."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    MISSING = "missing"


def quality_of_value(value: MeasureValue, doubts: Sequence[str]) -> Quality:
    """Return the quality of a value that has these doubts."""
    if value is None:
        return Quality.MISSING
    return Quality.DOUBTFUL if doubts else Quality.GOOD


#: Appended to the name of a measure, the name of the column with the quality of its values, if the config wants it.
QUALITY_SUFFIX = ".quality"


def quality_text(value: MeasureValue, doubts: Sequence[str]) -> str:
    """Return the text of a cell in a quality column: the quality, and its reasons.

    Example:
        >>> quality_text(7.5, ["the sensor is at its limit"])
        'doubtful: the sensor is at its limit'
    """
    quality = quality_of_value(value, doubts).value
    return f"{quality}: {'; '.join(doubts)}" if doubts else quality


def as_measure_value(name: str, value: object, *, where: str) -> MeasureValue:
    """Return `value` as one of the plain types that a run table holds.

    Numbers of other libraries (numpy's scalars among them) become int or float; an empty text is a missing value.

    Raises:
        MeasureError: it is not a number, a bool, a string or None; or it is not finite, or a text as long as a file.
    """
    plain = value
    item = getattr(value, "item", None)  # a numpy scalar, without importing numpy
    if callable(item) and getattr(value, "shape", None) == ():
        is_time = getattr(getattr(value, "dtype", None), "kind", "") in {"m", "M"}  # `item` may return ns as an integer
        is_masked = getattr(value, "mask", False)  # `item` would return the masked number
        plain = ... if is_time or is_masked else item()
    if plain is None or isinstance(plain, bool):
        return plain
    if isinstance(plain, str):
        text = str.__str__(plain)  # a subclass may have another `__str__`
        problem, fix = _refusal_of_text(text)
        if not problem:
            return text or None
    elif isinstance(plain, Integral):
        number = int(plain)
        if abs(number) <= _LARGEST:
            return number
        problem = f"a whole number of {number.bit_length()} bits"
        fix = f"Give one of {_LARGEST:.1e} at most, as a float is."
    elif isinstance(plain, Real):
        if math.isfinite(real := _as_float(plain)):
            return real
        problem, fix = f"{real}, which is not a finite number", "Give None where there is no value."
    else:
        problem = f"{shown(value)}, which is of type {type(value).__name__}"
        fix = "Give a number, a bool, a string, or None for a missing value."
    raise MeasureError(f"measure {name!r} got {problem}", where=where, fix=fix)


def _refusal_of_text(text: str) -> tuple[str, str]:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        return f"text that holds {text[error.start : error.end]!r}, which UTF-8 cannot hold", "Leave it out."
    if len(text) <= _LONGEST_TEXT:
        return "", ""
    problem = f"a text of {len(text):,} characters, and the run table takes {_LONGEST_TEXT:,} in a cell"
    return problem, "Write it into a file in context.raw_data_folder, and publish the file's name."


def _as_float(number: Real) -> float:
    try:
        return float(number)
    except OverflowError:  # a fraction beyond the largest float
        return math.inf


def shown(value: object) -> str:
    """Return the `repr` of a refused value, or its type where that raises."""
    try:
        return repr(value)
    except Exception:  # noqa: BLE001 - a user's __repr__ may raise anything, and a number may have too many digits
        return f"a {type(value).__name__}"


# Which measures have a column in the run table, and who may publish what.

CONFIG_OWNER = "config"
#: Owns the answers of the person who takes part.
OPERATOR_OWNER = "operator"
#: Owner and name of the measure that says which robot executed a run, where several take turns.
ROBOTS_OWNER, ROBOT = "robots", "Robot"


@dataclass(frozen=True, slots=True)
class MeasureColumn:
    """A measure and its name in the run table.

    Attributes:
        name: the column: the measure's name, or `<plugin>.<measure>` where names clash.
        owner: the plugin that yields it, or `config`.
        is_in_table: whether the run table has a column for it; published values are in the journal in any case.
        tells_of: the name of the measure column whose quality this one has; empty for a measure.
    """

    name: str
    owner: str
    measure: Measure
    is_in_table: bool = True
    tells_of: str = ""


@dataclass(frozen=True)
class MeasureColumns:
    """All measures of an experiment, and among them the columns of its run table in their order."""

    in_table: tuple[MeasureColumn, ...]
    declared: tuple[MeasureColumn, ...]

    @cached_property
    def _by_owner(self) -> Mapping[str, Mapping[str, MeasureColumn]]:
        by_owner: dict[str, dict[str, MeasureColumn]] = {}
        # Quality columns are not published: they follow from values and doubts.
        published = [column for column in (*self.declared, *self.in_table) if not column.tells_of]
        for column in published:
            names = by_owner.setdefault(column.owner, {})
            names[column.measure.name] = names[column.name] = column
        # The config may fill every column: its populate_run_data adds to and overrides what plugins publish.
        everything = {column.name: column for column in published}
        by_owner[CONFIG_OWNER] = everything | by_owner.get(CONFIG_OWNER, {})
        return by_owner

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the run table's measure columns, in order."""
        return tuple(column.name for column in self.in_table)

    @property
    def doubtful_with_run(self) -> list[str]:
        """The names of all columns whose values are doubtful where their run is: all but the robot's name."""
        return [column.name for column in self.declared if column.owner != ROBOTS_OWNER]

    def with_quality(self) -> MeasureColumns:
        """Return the same columns, with a quality column behind each measure of the run table."""
        described = "Whether the value of {} is good, doubtful or missing, and why."
        in_table = [
            each
            for column in self.in_table
            for each in (
                column,
                MeasureColumn(
                    column.name + QUALITY_SUFFIX,
                    column.owner,
                    Measure(column.measure.name + QUALITY_SUFFIX, "", described.format(column.name)),
                    tells_of=column.name,
                ),
            )
        ]
        return MeasureColumns(tuple(in_table), (*self.declared, *(each for each in in_table if each.tells_of)))

    def with_all_of(self, owner: str) -> MeasureColumns:
        """Return the same columns, with all measures of this owner in the run table."""
        declared = tuple(replace(each, is_in_table=True) if each.owner == owner else each for each in self.declared)
        there = set(self.names)
        added = (each for each in declared if each.owner == owner and each.name not in there)
        return MeasureColumns((*self.in_table, *added), declared)

    def column_for(self, owner: str, name: object) -> MeasureColumn:
        """Return the column of a measure, by its name or its column's; `config` may name those of all owners.

        Raises:
            MeasureError: the owner declared no such measure.
        """
        declared = self._by_owner.get(owner, {})
        if isinstance(name, str) and name in declared:
            return declared[name]
        hint = did_you_mean(str(name), declared)
        place = "data_columns" if owner == CONFIG_OWNER else f"the measures of {owner}"
        fix = f"{hint} Or add it to {place}." if hint else f"Add it to {place}."
        raise MeasureError(f"measure {name!r} was not declared", where=owner, fix=fix)


def resolve_columns(
    data_columns: Sequence[NamedColumn] | None, measures_by_plugin: Mapping[str, Sequence[Measure]]
) -> tuple[MeasureColumns, list[Finding]]:
    """Match the config's `data_columns` with the measures that plugins declare.

    `data_columns` are the measure columns of the run table, in order; None for all measures of all plugins. A name that
    no plugin declares is the config's own, and may be given as a `Measure` with its unit. There is a finding for each
    name that two plugins could mean.
    """
    declared = _declared_columns(measures_by_plugin)
    if data_columns is None:
        return MeasureColumns(tuple(declared), tuple(declared)), []
    by_name = {column.name: column for column in declared}
    findings: list[Finding] = []
    chosen: list[MeasureColumn] = []
    for each in data_columns:
        own = each if isinstance(each, Measure) else Measure(str(each))
        column = by_name.get(own.name)
        findings += _misnamed(own.name, declared) if column is None else _twice(each, column)
        chosen.append(column or MeasureColumn(own.name, CONFIG_OWNER, own))
    wanted = {column.name for column in chosen}
    owns = [column for column in chosen if column.owner == CONFIG_OWNER]
    marked = [replace(column, is_in_table=column.name in wanted) for column in declared]
    return MeasureColumns(tuple(chosen), (*marked, *owns)), findings


def _declared_columns(measures_by_plugin: Mapping[str, Sequence[Measure]]) -> list[MeasureColumn]:
    names = [measure.name for measures in measures_by_plugin.values() for measure in measures]
    return [
        MeasureColumn(measure.name if names.count(measure.name) == 1 else f"{plugin}.{measure.name}", plugin, measure)
        for plugin, measures in measures_by_plugin.items()
        for measure in measures
    ]


def _misnamed(name: str, declared: Sequence[MeasureColumn]) -> list[Finding]:
    """Return an error for a name that no measure has but that seems to mean a plugin's."""
    measure, _, phase = name.rpartition(".")
    if phase and any(column.name == measure and column.measure.over is not None for column in declared):
        problem = f"{name!r} would be {measure!r} in a phase that the config does not ask for"
        return [Finding.error("data_columns", problem, f"Add {phase!r} to the config's `phases`.")]
    for column in declared:
        if name == f"{column.owner}.{column.measure.name}":  # its name if two plugins had the measure
            problem = f"{name!r} is called {column.name!r}, as no other plugin has a measure of that name"
            return [Finding.error("data_columns", problem, f"Write {column.name!r}.")]
    full_names = [column.name for column in declared if column.measure.name == name]
    if not full_names:
        return []
    problem = f"{name!r} could be any of {', '.join(map(repr, full_names))}"
    fix = f"Write {full_names[0]!r}, or give one of the plugins fewer measures."
    return [Finding.error("data_columns", problem, fix)]


def _twice(asked: NamedColumn, column: MeasureColumn) -> list[Finding]:
    if isinstance(asked, str):
        return []
    problem = f"measure {asked.name!r} is declared here, and by plugin {column.owner}"
    return [Finding.error("data_columns", problem, f"Write {asked.name!r} for the plugin's, or rename this one.")]
