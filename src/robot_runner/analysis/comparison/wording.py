"""What comparing two experiments found, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.outcome import Verdict
from robot_runner.analysis.report.numbers import listed, shown_number, with_unit
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from robot_runner.analysis.comparison.outcome import Difference, MeasureComparison

__all__ = ["conclusion_of", "difference_unit", "shown_bound", "shown_percentage"]


def conclusion_of(measure: MeasureComparison) -> str:
    """Return one or two plain sentences about a measure."""
    if not measure.differences:
        return "There are no runs of the same combination to compare."
    largest = max(
        (each for each in measure.differences if each.difference is not None),
        key=lambda each: abs(each.difference or 0.0),
        default=None,
    )
    tail = f" {_largest(measure, largest)}" if largest is not None else ""
    match measure.verdict:
        case Verdict.EQUIVALENT:
            return f"Equivalent: differences are within the bound of {shown_bound(measure)}.{tail}"
        case Verdict.DIFFERENT:
            return f"Different{_where(measure)}.{tail}"
        case _:
            return f"Undecided: {_why_undecided(measure)}{tail}"


def shown_bound(measure: MeasureComparison) -> str:
    """Return the bound as it was stated, with the unit."""
    if measure.bound is None:
        return "no bound"
    return str(measure.bound) if measure.bound.is_relative else with_unit(measure.bound.value, measure.unit)


def shown_percentage(value: float | None) -> str:
    """Return a percentage with its sign, as in `+3.5 %`.

    Example:
        >>> shown_percentage(3.54)
        '+3.54 %'
    """
    if value is None:
        return shown_number(None)
    return f"{'+' if value > 0 else ''}{shown_number(value, 3)} %"


def difference_unit(measure: MeasureComparison) -> str:
    """Return the unit of a difference: that of percentages is not a percentage of anything."""
    return "percentage points" if measure.unit == "%" else measure.unit


def _where(measure: MeasureComparison) -> str:
    different = [each.label for each in measure.differences if each.verdict is Verdict.DIFFERENT]
    return "" if len(different) == len(measure.differences) else f" for {listed(different)}"


def _largest(measure: MeasureComparison, difference: Difference) -> str:
    where = f" ({difference.label})" if len(measure.differences) > 1 else ""
    size = with_unit(difference.difference, difference_unit(measure))
    return f"The largest difference is {size}, {shown_percentage(difference.relative)}{where}."


def _why_undecided(measure: MeasureComparison) -> str:
    open_ones = [each for each in measure.differences if each.verdict is Verdict.UNDECIDED]
    untested = [each for each in open_ones if each.not_computed]
    if len(untested) == len(measure.differences):
        return f"nothing could be tested. {untested[0].not_computed}"
    if measure.bound is None:
        return "no difference was found, and without a bound nothing can be called equivalent."
    which = listed(each.label for each in open_ones)
    return (
        f"for {which} the runs suffice neither to show a difference nor to show that it is within the bound of "
        f"{shown_bound(measure)} ({counted(min(each.first_n for each in open_ones), 'run')} a combination)."
    )
