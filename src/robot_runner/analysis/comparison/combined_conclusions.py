"""What several experiments say together of one effect, in sentences that claim no more than the numbers show."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from robot_runner.analysis.wording import p_in_words, shown_number, with_unit
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.comparison.combined import Combined, CombinedEffect
    from robot_runner.analysis.statistics.tested import Interval

__all__ = ["conclusion_of_effect", "difference_unit", "what_so_many_tell"]

_FEW = 5
_PAIR = 2
_WORDS = {3: "Three", 4: "Four"}


def difference_unit(unit: str) -> str:
    """Return the unit of a difference: that of percentages is not a percentage of anything."""
    return "percentage points" if unit == "%" else unit


def conclusion_of_effect(effect: CombinedEffect, measure: str, unit: str, alpha: float) -> str:
    """Return what an effect is on average, how far experiments differ, and what a further one may find."""
    found = effect.difference
    if found is None:
        return "The experiments could not be combined."
    return " ".join(_sentences(effect, found, measure, difference_unit(unit), alpha))


def _sentences(effect: CombinedEffect, found: Combined, measure: str, unit: str, alpha: float) -> Iterator[str]:
    yield _average(effect, found, measure, unit)
    yield _variation(found, unit, alpha)
    if found.prediction is not None and effect.is_significant and not _leaves_out_zero(found.prediction):
        between = _between(found.prediction, unit)
        yield f"A further experiment may find the opposite: its effect is expected between {between}."
    p_value = found.common.p_value
    if p_value is not None and effect.is_significant is not None and (p_value < alpha) is not effect.is_significant:
        verdict = f"{'is' if p_value < alpha else 'is not'} significant ({p_in_words(p_value)})"
        size = with_unit(found.common.estimate, unit)
        yield f"If all experiments estimated one and the same effect, it would be {size}, which {verdict}."
    if len(effect.experiments) < _FEW:
        yield what_so_many_tell(len(effect.experiments))


def _average(effect: CombinedEffect, found: Combined, measure: str, unit: str) -> str:
    random, count = found.random, counted(len(effect.experiments), "experiment")
    size = with_unit(random.estimate, unit)
    if random.interval is None or effect.adjusted_p_value is None:
        return f"All {count} found the same, {size}, so that chance has no measure."
    between = f"{100 * random.interval.level:g} % confidence interval {_between(random.interval, unit, 'to')}"
    facts = f"({size}, {between}, {p_in_words(effect.adjusted_p_value)})"
    if effect.statement:
        verdict = "differs from zero" if effect.is_significant else "is not shown to differ from zero"
        return f'Over {count} the contrast of "{effect.statement}" {verdict} on average {facts}.'
    first, second = effect.weights
    if not effect.is_significant:
        return f"The {count} do not show that {measure} differs between {first} and {second} on average {facts}."
    direction = "higher" if random.estimate > 0 else "lower"
    return f"Over {count} the {measure} of {first} is {direction} than that of {second} on average {facts}."


def _variation(found: Combined, unit: str, alpha: float) -> str:
    told = found.heterogeneity
    facts = f"Q({told.freedom}) = {shown_number(told.q, 3)}, {p_in_words(told.p_value)}, I² = {told.i_squared:.0f} %"
    tau, low, high = (
        math.sqrt(each) for each in (told.tau_squared, told.tau_squared_interval.low, told.tau_squared_interval.high)
    )
    between = f"{shown_number(low, 3)} to {with_unit(high, unit, 3)}"
    spread = f"effects vary between experiments by a standard deviation of {with_unit(tau, unit, 3)} ({between})"
    if told.p_value < alpha:
        return f"The experiments differ by more than chance explains ({facts}): {spread}."
    return f"That they differ by more than chance explains is not shown ({facts}), nor that they agree: {spread}."


def _between(interval: Interval, unit: str, word: str = "and") -> str:
    return f"{shown_number(interval.low)} {word} {with_unit(interval.high, unit)}"


def _leaves_out_zero(interval: Interval) -> bool:
    return interval.low > 0 or interval.high < 0


def what_so_many_tell(count: int) -> str:
    """Return what so few experiments can tell, and what they cannot."""
    if count == _PAIR:
        return (
            "Two experiments do not tell how experiments vary: the interval of the average has one degree of freedom, "
            "which makes it some six times as wide as that of many, and nothing is predicted."
        )
    return f"{_WORDS[count]} experiments hardly tell how experiments vary: their standard deviation is rough."
