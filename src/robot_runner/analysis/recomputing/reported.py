"""The tables of a report, with which a recomputation is compared: rows of numbers, with the labels of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.statistics.outcome import Proportion
from robot_runner.core.words import combination_label

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics
    from robot_runner.analysis.statistics.tested import Comparison, Effect, EffectSize, Interval

Number = float | int | None
Row = dict[str, Number]

#: The confidence level of the interval of a mean.
LEVEL = 0.95
#: The columns of the degrees of freedom and the p-value of a test.
_TEST = {"df": "degrees_of_freedom", "p": "p_value"}


@dataclass(frozen=True, slots=True)
class Reported:
    """A table of the report: rows of numbers, each with a label; missing numbers are None."""

    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, tuple[Number, ...]], ...] = ()

    @classmethod
    def of(cls, rows: Sequence[tuple[str, Mapping[str, Number]]]) -> Reported:
        """Return a table with the columns in which at least one row has a number."""
        names = dict.fromkeys(name for _, row in rows for name, value in row.items() if value is not None)
        return cls(tuple(names), tuple((label, tuple(row.get(name) for name in names)) for label, row in rows))

    def __bool__(self) -> bool:
        return bool(self.rows)

    @property
    def numbers(self) -> list[float]:
        """All numbers of the table."""
        return [float(value) for _, row in self.rows for value in row if value is not None]


def attributes(of: Any, *names: str, **others: str) -> Row:
    """Return attributes by their names, with spaces for underscores, or by other given names."""
    return {name.replace("_", " "): getattr(of, name) for name in names} | {
        name: getattr(of, attribute) for name, attribute in others.items()
    }


def ends(interval: Interval | None, of: str = "") -> Row:
    """Return the ends of an interval, by names with a prefix."""
    low, high = (None, None) if interval is None else (interval.low, interval.high)
    return {f"{of}low": low, f"{of}high": high}


def described_row(of: Description | Proportion) -> Row:
    """Return the descriptive statistics of a group of runs."""
    if isinstance(of, Proportion):
        return attributes(of, "n", "missing", "count", "percent") | ends(of.interval)
    row = attributes(
        of, "n", "missing", "mean", "sd", "minimum", "first_quartile", "median", "third_quartile", "maximum"
    )
    found = {"outliers": len(of.outliers), "extreme": sum(each.is_extreme for each in of.outliers)}
    return row | ends(of.mean_interval) | found


def about_residuals(measure: MeasureStatistics) -> dict[str, Reported]:
    """Return the tables on the distribution and the drift of residuals, and on the power."""
    checks = [
        (
            f"{each.name}, {combination_label(each.treatments.values()) or 'all groups'}",
            attributes(each, "statistic", p="p_value"),
        )
        for each in measure.assumptions
    ]
    tables = {"distribution": Reported.of(checks), **dict.fromkeys(("quantiles", "drift", "power"), Reported())}
    if (line := measure.quantiles) is not None:
        tables["quantiles"] = Reported.of([("reference line", attributes(line, "slope", "intercept"))])
    if (drift := measure.drift) is not None:
        row = attributes(drift, rho="correlation", p="p_value", slope="slope") | ends(drift.slope_interval)
        tables["drift"] = Reported.of([("over the order of execution", row)])
    if (power := measure.power) is not None:
        row = {f"runs for {each.effect_size:g}": each.repetitions for each in power.needed}
        tables["power"] = Reported.of([(power.effect_name, attributes(power, "detectable_effect") | row)])
    return tables


def tested_table(measure: MeasureStatistics, of: str) -> Reported:
    """Return the tests of all effects, each with its check of `ranks` or `means`."""
    if measure.test is None:
        return Reported.of([])
    return Reported.of([(each.label, _effect_row(each, measure.test.spread, of)) for each in measure.test.effects])


def contrasts_table(measure: MeasureStatistics) -> Reported:
    """Return the contrasts of hypotheses."""
    rows = [
        (each.statement, attributes(each, "estimate") | ends(each.interval) | attributes(each, "statistic", **_TEST))
        for each in measure.contrasts
    ]
    return Reported.of(rows)


def _effect_row(effect: Effect, spread: float | None, of: str) -> Row:
    row: Row = {"statistic": effect.statistic, **freedom_row(effect.degrees_of_freedom, ""), "p": effect.p_value}
    row |= {"spread": spread}
    for at, part in enumerate(effect.parts):
        row |= {f"p of {part.name}": part.p_value}
        if at:  # the first is the statistic itself
            row |= {f"statistic of {part.name}": part.statistic}
            row |= freedom_row(part.degrees_of_freedom, f" of {part.name}")
    for size in effect.effect_sizes:
        if size.name.endswith("omega squared"):
            row |= _size(size, "omega squared")
    if effect.check is not None:
        row |= {f"statistic of {of}": effect.check.statistic}
        row |= {**freedom_row(effect.check.degrees_of_freedom, f" of {of}"), f"p of {of}": effect.check.p_value}
    return row


def freedom_row(freedom: Sequence[float], of: str) -> Row:
    """Return one or two degrees of freedom, with a suffix for their test."""
    return {f"df{'' if place == 0 else ' 2'}{of}": each for place, each in enumerate(freedom)}


def _size(size: EffectSize, name: str) -> Row:
    return {name: size.value, **ends(size.interval, f"{name} ")}


def pair_row(pair: Comparison, of: str) -> Row:
    """Return the comparison of two groups, with its check of `ranks` or `means`."""
    row = attributes(pair, "difference") | ends(pair.interval) | attributes(pair, "statistic", **_TEST)
    row |= {f"p of {of}": pair.check_p_value}
    for size in pair.effect_sizes:
        row |= _size(size, size.name)
    return row
