"""The one gate for measures, and the notice board of one run."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, MeasureError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = [
    "CONFIG_OWNER",
    "Measure",
    "MeasureBroker",
    "MeasureColumn",
    "MeasureColumns",
    "MeasureValue",
    "Origin",
    "Over",
    "PublishedMeasure",
    "ReportRecord",
    "as_measure_value",
    "resolve_columns",
    "with_phases",
]


# Measures: what a run yields, as declared by a plugin or a config and as published in a run.

#: What a cell of the run table can hold. None is a missing value: an empty cell.
MeasureValue = int | float | bool | str | None

#: A larger number is a slip, and no table reader could take it.
_MOST_BITS = 1024


class Origin(Enum):
    """Where a value comes from, so that no simulated or estimated value passes for a measured one."""

    MEASURED = "measured"
    SIMULATED = "simulated"
    ESTIMATED = "estimated"


class Over(Enum):
    """How the values of several windows make one, for a phase that a mission has several times."""

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
        over: how the values of several windows make one (a mean is weighted by their durations); None for a measure
            that has no value for a part of the mission.

    Example:
        >>> Measure("Energy", "J", "Energy drawn from the battery over the measured window.")
        Measure(name='Energy', unit='J', description='Energy drawn from the battery over the measured window.')
    """

    name: str
    unit: str = ""
    description: str = ""
    over: Over | None = field(default=None, kw_only=True, repr=False)

    def in_phase(self, phase: str) -> Measure:
        """Return the same measure for one phase of the mission.

        Example:
            >>> Measure("Energy", "J", "Energy drawn.", over=Over.SUM).in_phase("navigate").name
            'Energy.navigate'
        """
        return replace(self, name=f"{self.name}.{phase}", description=f"In phase {phase}: {self.description}")


def with_phases(measures: Sequence[Measure], phases: Sequence[str]) -> tuple[Measure, ...]:
    """Return the measures, and behind them those that have a value per phase, for each of the phases."""
    return (*measures, *(each.in_phase(phase) for each in measures if each.over is not None for phase in phases))


@dataclass(frozen=True, slots=True)
class PublishedMeasure:
    """A measure's value in one run, with who published it and where it comes from."""

    name: str
    value: MeasureValue
    owner: str
    unit: str = ""
    origin: Origin = Origin.MEASURED


def as_measure_value(name: str, value: object, *, where: str) -> MeasureValue:
    """Return `value` as one of the plain types that a run table holds.

    Numbers of other libraries (numpy's scalars among them) become int or float.

    Raises:
        MeasureError: it is not a number, a bool, a string or None, or it is not finite.
    """
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return _writable(name, value, where)
    item = getattr(value, "item", None)  # a numpy scalar, without importing numpy
    plain = item() if callable(item) and getattr(value, "shape", None) == () else value
    if isinstance(plain, bool):
        return plain
    if isinstance(plain, str):
        return _writable(name, plain, where)
    if isinstance(plain, Integral):
        return _bounded(name, int(plain), where)
    if isinstance(plain, Real):
        return _finite(name, float(plain), where)
    raise MeasureError(
        f"measure {name!r} got {value!r}, which is of type {type(value).__name__}",
        where=where,
        fix="Give a number, a bool, a string, or None for a missing value.",
    )


def _finite(name: str, number: float, where: str) -> float:
    if math.isfinite(number):
        return number
    raise MeasureError(
        f"measure {name!r} got {number}, which is not a finite number",
        where=where,
        fix="Give None where there is no value.",
    )


def _writable(name: str, text: str, where: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        odd = text[error.start : error.end]
        problem = f"measure {name!r} got text that holds {odd!r}, which UTF-8 cannot hold"
        raise MeasureError(problem, where=where, fix="Leave it out.") from error
    return text


def _bounded(name: str, number: int, where: str) -> int:
    if number.bit_length() <= _MOST_BITS:
        return number
    problem = f"measure {name!r} got a whole number of {number.bit_length()} bits"
    raise MeasureError(problem, where=where, fix=f"Give one of {_MOST_BITS} bits at most, or a float.")


# Which measures the run table has a column for, and who may publish what.

CONFIG_OWNER = "config"


@dataclass(frozen=True, slots=True)
class MeasureColumn:
    """A measure and its name in the run table.

    Attributes:
        name: the column: the measure's name, or `<plugin>.<measure>` where names clash.
        owner: the plugin that yields it, or `config`.
        is_in_table: whether the run table has a column for it; published values are in the journal in any case.
    """

    name: str
    owner: str
    measure: Measure
    is_in_table: bool = True


@dataclass(frozen=True)
class MeasureColumns:
    """All measures of an experiment, and among them the columns of its run table in their order."""

    in_table: tuple[MeasureColumn, ...]
    declared: tuple[MeasureColumn, ...]

    @cached_property
    def _by_owner(self) -> Mapping[str, Mapping[str, MeasureColumn]]:
        by_owner: dict[str, dict[str, MeasureColumn]] = {}
        for column in self.declared:
            names = by_owner.setdefault(column.owner, {})
            names[column.measure.name] = names[column.name] = column
        # The config may fill every column: its populate_run_data adds to and overrides what plugins publish.
        everything = {column.name: column for column in (*self.declared, *self.in_table)}
        by_owner[CONFIG_OWNER] = everything | by_owner.get(CONFIG_OWNER, {})
        return by_owner

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the run table's measure columns, in order."""
        return tuple(column.name for column in self.in_table)

    def prepare(self) -> None:
        """Look everything up that looking up a column needs, so that a run that is forked finds it done."""
        _ = self._by_owner

    def column_for(self, owner: str, name: object) -> MeasureColumn:
        """Return the column that `owner` means by `name`.

        Raises:
            MeasureError: the owner declared no such measure.
        """
        declared = self._by_owner.get(owner, {})
        if isinstance(name, str) and name in declared:
            return declared[name]
        hint = did_you_mean(str(name), declared)
        remedy = "Or add it to data_columns." if owner == CONFIG_OWNER else f"Or add it to the measures of {owner}."
        raise MeasureError(f"measure {name!r} was not declared", where=owner, fix=f"{hint} {remedy}".strip())


def resolve_columns(
    data_columns: Sequence[str] | None, measures_by_plugin: Mapping[str, Sequence[Measure]]
) -> tuple[MeasureColumns, list[Finding]]:
    """Match the config's `data_columns` with the measures that plugins declare.

    Args:
        data_columns: the measure columns that the run table is to have, in order; None asks for all measures of
            all plugins. A name that no plugin declares is the config's own.
        measures_by_plugin: what each plugin declares, by the plugin's name.

    Returns:
        The columns, and a finding for each name that two plugins could mean.
    """
    declared = _declared_columns(measures_by_plugin)
    if data_columns is None:
        return MeasureColumns(tuple(declared), tuple(declared)), []
    by_name = {column.name: column for column in declared}
    findings: list[Finding] = []
    chosen: list[MeasureColumn] = []
    for name in data_columns:
        column = by_name.get(name)
        findings += _ambiguity(name, declared) if column is None else []
        chosen.append(column or MeasureColumn(name, CONFIG_OWNER, Measure(name)))
    wanted = {column.name for column in chosen}
    own = [column for column in chosen if column.owner == CONFIG_OWNER]
    marked = [
        MeasureColumn(column.name, column.owner, column.measure, is_in_table=column.name in wanted)
        for column in declared
    ]
    return MeasureColumns(tuple(chosen), (*marked, *own)), findings


def _declared_columns(measures_by_plugin: Mapping[str, Sequence[Measure]]) -> list[MeasureColumn]:
    names = [measure.name for measures in measures_by_plugin.values() for measure in measures]
    return [
        MeasureColumn(measure.name if names.count(measure.name) == 1 else f"{plugin}.{measure.name}", plugin, measure)
        for plugin, measures in measures_by_plugin.items()
        for measure in measures
    ]


def _ambiguity(name: str, declared: Sequence[MeasureColumn]) -> list[Finding]:
    full_names = [column.name for column in declared if column.measure.name == name]
    if not full_names:
        return []
    return [
        Finding.error(
            "data_columns",
            f"{name!r} could be any of " + ", ".join(map(repr, full_names)),
            f"Write {full_names[0]!r}, or give one of the plugins fewer measures.",
        )
    ]


#: Takes what happens in a run as it happens: a kind and its plain fields.
ReportRecord = Callable[[str, dict[str, Any]], None]


class MeasureBroker:
    """Takes what is published in one run, refuses what was not declared, and reports the rest at once.

    Plugins may publish from threads of their own.
    """

    def __init__(self, run_id: str, columns: MeasureColumns, report: ReportRecord) -> None:
        self._run_id = run_id
        self._columns = columns
        self._report = report
        self._lock = threading.Lock()
        self._measures: dict[str, PublishedMeasure] = {}
        self._shared: dict[str, dict[str, object]] = {}
        self._findings: list[Finding] = []

    @property
    def measures(self) -> Mapping[str, PublishedMeasure]:
        """What was published so far, by column of the run table."""
        return self._measures

    @property
    def shared(self) -> Mapping[str, Mapping[str, object]]:
        """The key-value pairs shared so far, by plugin."""
        return self._shared

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The warnings recorded so far."""
        return tuple(self._findings)

    def publish(self, owner: str, name: str, value: object, origin: Origin) -> None:
        """Take one measure; a later value of the same measure replaces the earlier.

        Raises:
            MeasureError: the name was not declared, the type is wrong, or the number is not finite. The value
                that was refused is reported all the same, so that it is kept with the run.
        """
        try:
            column = self._columns.column_for(owner, name)
            plain = as_measure_value(column.name, value, where=f"{owner}, run {self._run_id}")
        except MeasureError:
            self._report("refused", {"owner": owner, "name": str(name), "value": repr(value)})
            raise
        published = PublishedMeasure(column.name, plain, owner, column.measure.unit, origin)
        with self._lock:
            self._measures[column.name] = published
            fields = {"name": column.name, "value": plain, "owner": owner, "origin": origin.value}
            self._report("measure", fields)

    def share(self, owner: str, values: Mapping[str, object]) -> None:
        """Pass key-value pairs on to the subscribers of the following events."""
        with self._lock:
            self._shared.setdefault(owner, {}).update(values)
            self._report("shared", {"owner": owner, "values": dict(values)})

    def warn(self, owner: str, problem: str, fix: str) -> None:
        """Record a warning finding about this run."""
        self._record_finding(owner, problem, fix, {})

    def doubt(self, owner: str, problem: str, fix: str, measures: Sequence[str] = ()) -> None:
        """Record a warning finding that makes values of this run doubtful.

        Args:
            owner: who doubts.
            problem: the reason.
            fix: what can be done about it.
            measures: whose values; none named: all that the owner declared.

        Raises:
            MeasureError: the owner declared no such measure.
        """
        columns = [self._columns.column_for(owner, name).name for name in measures]
        doubted = columns or [column.name for column in self._columns.declared if column.owner == owner]
        self._record_finding(owner, problem, fix, {"measures": doubted})

    def _record_finding(self, owner: str, problem: str, fix: str, more: dict[str, Any]) -> None:
        with self._lock:
            self._findings.append(Finding.warning(f"{self._run_id}, {owner}", problem, fix))
            self._report("finding", {"owner": owner, "problem": problem, "fix": fix, **more})

    def note_clock(self, owner: str, facts: Mapping[str, object]) -> None:
        """Keep how another computer's clock stood to the run's."""
        with self._lock:
            self._report("clock", {"owner": owner, **facts})
