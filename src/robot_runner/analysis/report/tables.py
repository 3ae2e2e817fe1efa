"""Tables that several sections have."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Cell, Column, Place, Table, Tone
from robot_runner.analysis.report.numbers import (
    ALPHA,
    MINUS,
    MISSING,
    interval_cells,
    interval_columns,
    listed,
    number_cell,
    p_cell,
    shown_interval,
    shown_number,
)
from robot_runner.core.design.analysis_plan import Correction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.analysis.statistics.outcome import (
        AssumptionCheck,
        Description,
        Effect,
        EffectSize,
        MeasureTest,
        PostHoc,
    )

__all__ = [
    "assumption_table",
    "correction_in_words",
    "description_table",
    "effect_table",
    "post_hoc_table",
    "shown_statistic",
]

#: With fewer values a bootstrap's intervals hold somewhat less often than they say.
_ENOUGH_FOR_BOOTSTRAP = 10


def description_table(name: str, caption: str, heading: str, groups: Sequence[Description]) -> Table:
    """Return the descriptive statistics of several groups."""
    names = ("n", "Missing", "Mean", "SD", "Median", "IQR", "Minimum", "Maximum")
    numbers = (Column(each, is_number=True) for each in names)
    columns = (Column(heading), *numbers, *interval_columns("CI of the mean"), Column("Outliers"))
    rows = tuple(_description_row(group) for group in groups)
    intervals = [group.mean_interval for group in groups if group.mean_interval is not None]
    note = f"CI: {intervals[0].level:.0%} confidence interval, {_methods(groups)}. " if intervals else ""
    note = f"{note}SD: standard deviation (n {MINUS} 1). IQR: interquartile range."
    return Table(name, caption, columns, rows, note).without_blank("Missing", "Outliers")


def _methods(groups: Sequence[Description]) -> str:
    """Return how the intervals of the means were computed, and how far they can be trusted."""
    intervals = [(group.mean_interval.method, group.n) for group in groups if group.mean_interval is not None]
    words = " or ".join(dict.fromkeys(method for method, _ in intervals))
    is_narrow = any(method.startswith("bootstrap") and n < _ENOUGH_FOR_BOOTSTRAP for method, n in intervals)
    return f"{words} (rather narrow for fewer than {_ENOUGH_FOR_BOOTSTRAP} runs)" if is_narrow else words


def _description_row(group: Description) -> tuple[Cell, ...]:
    numbers = (group.mean, group.sd, group.median, group.interquartile_range, group.minimum, group.maximum)
    outliers = listed(outlier.run_id for outlier in group.outliers)
    return (
        Cell.of_text(group.label),
        number_cell(group.n),
        Cell(group.missing, shown_number(group.missing), Tone.WARNING if group.missing else Tone.PLAIN),
        *map(number_cell, numbers),
        *interval_cells(group.mean_interval),
        Cell(" ".join(outlier.run_id for outlier in group.outliers) or None, outliers),
    )


def assumption_table(name: str, caption: str, checks: Sequence[AssumptionCheck]) -> Table:
    """Return what was found about the assumptions of a test."""
    columns = (
        Column("Check"),
        Column("Of"),
        Column("Statistic", is_number=True),
        Column("p", is_number=True),
        Column("Conclusion"),
    )
    rows = tuple(
        (
            Cell.of_text(check.name),
            Cell.of_text(" / ".join(check.treatments.values()) or "all groups"),
            number_cell(check.statistic, 3),
            p_cell(check.p_value, is_significant=None),
            Cell.of_text(check.conclusion, Tone.WARNING if check.holds is False else Tone.PLAIN),
        )
        for check in checks
    )
    return Table(name, caption, columns, rows)


def effect_table(name: str, caption: str, test: MeasureTest, alpha: float) -> Table:
    """Return the results of a test, one row an effect."""
    columns = (
        Column("Effect"),
        Column("Statistic"),
        Column("p", is_number=True),
        Column(f"At {ALPHA} = {alpha:g}"),
        Column("Effect size"),
    )
    rows = tuple(
        (
            Cell.of_text(effect.label),
            Cell(effect.statistic, shown_statistic(effect)),
            p_cell(effect.p_value, is_significant=effect.is_significant),
            _significance(effect.is_significant),
            Cell.of_text("; ".join(map(_shown_size, effect.effect_sizes)) or MISSING),
        )
        for effect in test.effects
    )
    return Table(name, caption, columns, rows, f"Computed with {test.library}.")


def post_hoc_table(name: str, caption: str, post_hoc: PostHoc) -> Table:
    """Return all pairs of treatments, compared."""
    middle = "means" if post_hoc.is_of_means else "medians"
    sizes = list(dict.fromkeys(size.name for pair in post_hoc.comparisons for size in pair.effect_sizes))
    columns = (
        Column("First"),
        Column("Second"),
        Column(f"Difference of {middle}", is_number=True),
        *interval_columns("CI"),
        Column("p", is_number=True),
        Column("Adjusted p", is_number=True),
        *(column for size in sizes for column in _size_columns(size)),
    )
    rows = tuple(
        (
            Cell.of_text(pair.first),
            Cell.of_text(pair.second),
            number_cell(pair.difference),
            *interval_cells(pair.interval),
            p_cell(pair.p_value, is_significant=None),
            p_cell(pair.adjusted_p_value, is_significant=pair.is_significant),
            *(cell for size in sizes for cell in _size_cells(size, pair.effect_sizes)),
        )
        for pair in post_hoc.comparisons
    )
    note = f"{post_hoc.method}; p-values adjusted after {correction_in_words(post_hoc.correction)}."
    return Table(name, caption, columns, rows, note)


def correction_in_words(correction: Correction) -> str:
    """Return who a correction is named after."""
    return {Correction.HOLM: "Holm", Correction.BENJAMINI_HOCHBERG: "Benjamini and Hochberg"}[correction]


def _size_columns(name: str) -> tuple[Column, ...]:
    ends = (Column(f"{name}, {part}", place=Place.FILE) for part in ("value", "low", "high", "magnitude"))
    return (Column(name, place=Place.PAGE), *ends)


def _size_cells(name: str, sizes: Sequence[EffectSize]) -> tuple[Cell, ...]:
    size = next((each for each in sizes if each.name == name), None)
    if size is None:
        return (Cell(None, MISSING),) * 5
    interval = size.interval
    shown = f"{shown_number(size.value, 3)}, {size.magnitude.value}"
    shown += "" if interval is None else f"\n{shown_interval(interval, 3)}"
    low, high = (None, None) if interval is None else (interval.low, interval.high)
    return (
        Cell.of_text(shown),
        number_cell(size.value),
        number_cell(low),
        number_cell(high),
        Cell.of_text(size.magnitude.value),
    )


def shown_statistic(effect: Effect) -> str:
    """Return a statistic as papers print it, as in `F(2, 12) = 83.1`."""
    if effect.statistic is None:
        return MISSING
    freedom = ", ".join(f"{each:.4g}" for each in effect.degrees_of_freedom)
    name = f"{effect.statistic_name}({freedom})" if freedom else effect.statistic_name
    return f"{name} = {shown_number(effect.statistic, 4)}"


def _significance(is_significant: bool | None) -> Cell:
    if is_significant is None:
        return Cell(None, "not computed")
    return Cell(is_significant, "significant" if is_significant else "not significant")


def _shown_size(size: EffectSize) -> str:
    interval = f" {shown_interval(size.interval, 3)}" if size.interval is not None else ""
    return f"{size.name} = {shown_number(size.value, 3)}{interval}, {size.magnitude.value}"
