"""Statistics of two experiments: tests of difference and equivalence, limits of agreement, practical equivalence.

Values of pairs have the same order in both experiments; `units` are those whose values vary together.

Practical equivalence is the posterior probability that a difference is too small to matter. The prior is the reference
prior of each mean and standard deviation, p(mean, sd) = 1 / sd, so that the posterior of a mean is Student's t around
the sample mean. The difference then has the Behrens-Fisher distribution for two independent experiments, and Student's
t for pairs (Box and Tiao, Bayesian Inference in Statistical Analysis, 1973, chapter 2; Kruschke, Bayesian estimation
supersedes the t test, Journal of Experimental Psychology: General 142, 2013, for the region).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import integrate, optimize

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.comparison.compared import Agreement, Bound, PracticalEquivalence, stated
from robot_runner.analysis.comparison.matching import of_one_quantity
from robot_runner.analysis.comparison.shared_units import APART, Estimate, Units, estimate_of, shares_of
from robot_runner.analysis.importing.units import known_units, unit_of
from robot_runner.analysis.statistics.descriptive import STEPS_OF_NOISE, out_of_range, quiet, step_of
from robot_runner.analysis.statistics.score_intervals import DIFFERENCE, score_of, sum_ends
from robot_runner.analysis.statistics.tested import Interval
from robot_runner.core.errors import AnalysisError, did_you_mean

_PERCENT = 100.0
_FEWEST = 2
#: Values with a smaller spread, as a share of their size, differ only by rounding.
_ROUNDING = 1e-12
#: A bias of a smaller share of the values is that of their last binary places.
_LAST_PLACES = 4 * np.finfo(np.float64).eps


class DifferenceTest(NamedTuple):
    """A test of a difference; its interval is at 1 - alpha, the narrow one at 1 - 2 alpha."""

    p_value: float
    interval: Interval
    narrow: Interval


def why_not_testable(first: Floats, second: Floats, *, is_paired: bool, units: Units = APART) -> str:
    """Return why the difference cannot be tested; empty where it can."""
    if min(len(first), len(second)) < _FEWEST:
        return f"There are {len(first)} and {len(second)} runs; {_FEWEST} are needed of each."
    if why := units.why_unknown:
        return why
    if odd := out_of_range(first) or out_of_range(second):
        return f"One of the experiments {odd}"
    spread = float(np.ptp(second - first)) if is_paired else float(np.ptp(first)) + float(np.ptp(second))
    if spread <= _ROUNDING * max(float(np.abs(first).max()), float(np.abs(second).max())):
        return _hardly_varies(first, second, spread, is_paired=is_paired)
    if units.are_shared and not _difference(first, second, is_paired=is_paired, units=units).variance > 0:
        return f"The means of each {units.name} are equal, so chance cannot be told from a difference."
    return ""


def _hardly_varies(first: Floats, second: Floats, spread: float, *, is_paired: bool) -> str:
    values = np.concatenate((first, second))
    noise = STEPS_OF_NOISE * step_of(values) if np.any(values % 1) else 0.0
    if spread > noise:
        fix = "Compare how far they are from a fixed value, such as the time since the mission began."
        return f"The values differ by too little relative to their size, where they are rounded. {fix}"
    same = "All pairs differ by the same" if is_paired else "Within each experiment all values are equal"
    return f"{same}, so chance cannot be told from a difference."


def spread_of(values: Floats) -> float | None:
    """Return the standard deviation; None for a single value, and for values too large or small to compute with."""
    return float(values.std(ddof=1)) if len(values) >= _FEWEST and not out_of_range(values) else None


def difference_test(
    first: Floats, second: Floats, *, alpha: float, is_paired: bool, units: Units = APART
) -> DifferenceTest:
    """Test the difference of two means, second minus first: Welch's t-test, or one of pairs."""
    found = _difference(first, second, is_paired=is_paired, units=units)
    method = ("paired t" if is_paired else "Welch's t") + units.in_words
    wide, narrow = (found.interval(level, method) for level in (1 - alpha, 1 - 2 * alpha))
    return DifferenceTest(2 * min(found.below(0.0), found.above(0.0)), wide, narrow)


def equivalence_p_value(first: Floats, second: Floats, bound: Bound, *, is_paired: bool, units: Units = APART) -> float:
    """Return the p-value of two one-sided tests (TOST) that the second mean lies within a bound around the first."""
    lower, upper = (_difference(edge, second, is_paired=is_paired, units=units) for edge in _edges(first, bound))
    with quiet():  # differences to an edge may all be equal
        return float(np.maximum(lower.below(0.0), upper.above(0.0)))  # NaN, where they all are the edge


def proportion_test(first: Floats, second: Floats, *, alpha: float, units: Units = APART) -> DifferenceTest:
    """Test the difference of two proportions of answers (1 for yes, 0 for no) by Newcombe's score intervals."""
    one, other, chance = shares_of(first, second, units)
    ends = [sum_ends((other, one), DIFFERENCE, float(chance.isf(each))) for each in (alpha / 2, alpha)]
    p_value = min(1.0, 2 * float(chance.sf(abs(score_of((other, one), DIFFERENCE)))))
    wide, narrow = (
        Interval(*each, level, f"Newcombe's score interval{units.in_words}")
        for each, level in zip(ends, (1 - alpha, 1 - 2 * alpha), strict=True)
    )
    return DifferenceTest(p_value, wide, narrow)


def equivalent_proportions(first: Floats, second: Floats, bound: Bound, *, units: Units = APART) -> float:
    """Return the p-value of two one-sided tests that the second proportion lies within a bound around the first.

    With a bound in percent, it is tested against multiples of the first proportion, which is an estimate itself.
    """
    one, other, chance = shares_of(first, second, units)
    share = bound.value / _PERCENT if bound.is_relative else 0.0
    edge = 0.0 if bound.is_relative else bound.value
    scores = score_of((other, one), (1, share - 1), -edge), -score_of((other, one), (1, -1 - share), edge)
    return float(chance.sf(min(scores)))


def _difference(first: Floats, second: Floats, *, is_paired: bool, units: Units) -> Estimate:
    """Return the difference of two means, second minus first."""
    if is_paired:
        return estimate_of(second - first, units.of_pairs)
    return estimate_of(second, units.second).less(estimate_of(first, units.first))


#: Bland and Altman, "Statistical methods for assessing agreement between two methods of clinical measurement" (Lancet
#: 327, 1986): 95 % of normally distributed differences.
_SPREAD = 1.96


def agreement_of(
    groups: Mapping[str, tuple[Floats, Floats]], *, is_paired: bool, has_limits: bool = True, has_shares: bool = True
) -> Agreement | None:
    """Return relative error and limits of agreement, or None where there is no pair.

    The values of both experiments are by combination; unless they are pairs, those of one combination are paired in
    their order. Limits assume that differences can be normal, as those of yes and no cannot, and the error that a
    percentage of a value is meaningful, as it is not in degC.
    """
    both = {label: values for label, values in groups.items() if all(map(len, values))}
    pairs = {
        label: [(float(one), float(other)) for one, other in zip(first, second, strict=False)]
        for label, (first, second) in both.items()
    }
    every = [pair for several in pairs.values() for pair in several]
    if not every:
        return None
    # Of experiments of different sizes, some runs are in no pair, and still tell where the mean lies.
    means = [math.fsum((*second / len(second), *-first / len(first))) for first, second in both.values()]
    bias = float(np.average(means, weights=[len(several) for several in pairs.values()]))
    if abs(bias) <= _LAST_PLACES * max(float(np.abs(each).max()) for of in groups.values() for each in of if len(each)):
        bias = 0.0
    spread = spread_of(np.array([other - one for one, other in every])) if has_limits else None
    reach = None if spread is None else spread * _SPREAD
    of_means = [(float(first.mean()), float(second.mean())) for first, second in both.values()]
    return Agreement(
        pairs,
        are_natural=is_paired,
        bias=bias,
        lower=None if reach is None else bias - reach,
        upper=None if reach is None else bias + reach,
        error=_error(every if is_paired else of_means) if has_shares else None,
    )


def _error(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return the mean absolute percentage error of the second values, in percent of the first."""
    if any(one == 0 for one, _ in pairs):
        return None
    return float(np.mean([abs(other - one) / abs(one) for one, other in pairs])) * _PERCENT


#: The largest number of subintervals of the integral, for posteriors of very different widths.
_PARTS = 500
_NUMBER = re.compile(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*")


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions of practical equivalence of several measures: differences that do not matter.

    Attributes:
        general: regions of all measures in a unit, by that unit (empty for any).
        own: regions of single measures, by name, with the unit.

    Example:
        >>> Regions.parse(["2%", "Energy=5 J"]).of("Energy", "kJ")
        Bound(value=0.005, is_relative=False)
    """

    general: Mapping[str, Bound]
    own: Mapping[str, tuple[str, Bound]]

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Regions:
        """Read regions, each as `2%`, `5` or `5 J`, or for one measure as `Energy=5 J`.

        Raises:
            AnalysisError: a text is not a region, or a measure has two.
        """
        return cls(*stated(texts, _read, "region", "rope"))

    def of(self, measure: str, unit: str) -> Bound | None:
        """Return the region of a measure, in its unit; None where it has none.

        Raises:
            AnalysisError: its own region is in a unit that cannot be converted.
        """
        if measure in self.own:
            given, bound = self.own[measure]
            found = _in_unit(bound, given, unit)
            if found is None:
                fix = f"Give it in {unit or 'the unit of the measure'}, or in percent: --rope {measure}=2%."
                raise AnalysisError(f"the region of {measure} is in {given}", where="rope", fix=fix)
            return found
        matching = (_in_unit(bound, given, unit) for given, bound in self.general.items() if given)
        return next(filter(None, matching), self.general.get(""))


def _read(text: str) -> tuple[str, Bound]:
    """Return the unit of a region (empty for a percentage, or if there is none) and its half-width."""
    fix = "Give a percentage, or a number with or without a unit: --rope 2%, or --rope '5 J'."
    found = _NUMBER.fullmatch(text)
    if found is None:
        raise AnalysisError(f"{text!r} is not a region of practical equivalence", where="rope", fix=fix)
    number, unit = found.groups()
    if unit not in {"", "%"} and unit_of(unit) is None:
        raise AnalysisError(f"{unit!r} is not a unit", where="rope", fix=did_you_mean(unit, known_units()))
    try:
        return ("", Bound(float(number), is_relative=True)) if unit == "%" else (unit, Bound(float(number)))
    except AnalysisError as error:
        raise AnalysisError(f"the region is {text.strip()}", where="rope", fix=fix) from error


def _in_unit(bound: Bound, given: str, wanted: str) -> Bound | None:
    if not given or given == wanted:
        return bound
    units = of_one_quantity(given, wanted)
    # Offsets of units cancel out in a difference.
    return None if units is None else Bound(bound.value * units[0].factor / units[1].factor)


def practical_equivalence(
    first: Floats, second: Floats, bound: Bound, *, alpha: float, is_paired: bool, units: Units = APART
) -> PracticalEquivalence | None:
    """Return the probabilities that the second mean lies below, within and above a region around the first.

    The credible interval of the difference is at 1 - alpha. A percentage is of the first mean, which is an estimate
    itself. None where values do not vary, so that there is no posterior.
    """
    if is_paired:
        return _of_pairs(first, second, bound, alpha, units)
    one, other = estimate_of(first, units.first), estimate_of(second, units.second)
    if not min(one.variance, other.variance) > 0:
        return None
    below = _probability(one, other, lambda mean: mean - bound.in_units(mean))
    above = 1 - _probability(one, other, lambda mean: mean + bound.in_units(mean))
    low, high = (_quantile(one, other, share) for share in (alpha / 2, 1 - alpha / 2))
    return _result(first, bound, below, above, Interval(low, high, 1 - alpha, "posterior (Behrens-Fisher)"))


def _of_pairs(first: Floats, second: Floats, bound: Bound, alpha: float, units: Units) -> PracticalEquivalence | None:
    edges = (*_edges(first, bound), first)
    lower, upper, difference = (_difference(edge, second, is_paired=True, units=units) for edge in edges)
    if not min(lower.variance, upper.variance, difference.variance) > 0:
        return None
    return _result(first, bound, lower.below(0.0), upper.above(0.0), difference.interval(1 - alpha, "posterior (t)"))


def _edges(first: Floats, bound: Bound) -> list[Floats]:
    """Return the values minus and plus the bound, the lower ones first: a percentage swaps them for negative values."""
    if not bound.is_relative:
        return [first - bound.value, first + bound.value]
    share = bound.value / _PERCENT
    return sorted((first * (1 - share), first * (1 + share)), key=lambda edge: float(np.mean(edge)))


def _result(first: Floats, bound: Bound, below: float, above: float, interval: Interval) -> PracticalEquivalence:
    within = min(1.0, max(0.0, 1 - below - above))
    return PracticalEquivalence(bound.in_units(float(first.mean())), below, within, above, interval)


def _probability(one: Estimate, other: Estimate, edge: Callable[[float], float]) -> float:
    """Return the probability that the other mean lies below an edge that depends on the one."""
    found = integrate.quad(lambda share: other.below(edge(one.quantile(share))), 0.0, 1.0, limit=_PARTS)
    return min(1.0, max(0.0, float(found[0])))


def _quantile(one: Estimate, other: Estimate, share: float) -> float:
    """Return the quantile of the difference, other minus one."""
    # The sums of quantiles at half the probability enclose the root (Bonferroni).
    part = min(share, 1 - share) / 2
    low = other.quantile(part) - one.quantile(1 - part)
    high = other.quantile(1 - part) - one.quantile(part)
    return float(optimize.brentq(lambda at: _probability(one, other, lambda mean: mean + at) - share, low, high))
