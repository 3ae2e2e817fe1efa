"""Tests of a difference, and two one-sided tests of equivalence (TOST), with scipy.

Schuirmann, "A comparison of the two one-sided tests procedure and the power approach" (J. Pharmacokinet. Biopharm. 15,
1987); with a bound in percent of the first mean, after Sasabuchi: each one-sided test compares the second mean with the
first one multiplied by 1 less or plus the bound, so that the first mean's own uncertainty counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.outcome import Interval

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.comparison.bounds import Bound

__all__ = ["DifferenceTest", "difference_test", "equivalence_p_value", "why_not_testable"]

_FEWEST = 2
_PERCENT = 100.0
#: Spread below which values are equal but for rounding, as a share of their size.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class DifferenceTest:
    """A t-test of a difference of means.

    Attributes:
        interval: at 1 - alpha; `narrow` at 1 - 2 alpha.
    """

    p_value: float
    interval: Interval
    narrow: Interval


def why_not_testable(first: NDArray[np.float64], second: NDArray[np.float64], *, is_paired: bool) -> str:
    """Return why nothing can be tested, or nothing where it can."""
    if min(len(first), len(second)) < _FEWEST:
        return f"There are {len(first)} and {len(second)} runs; {_FEWEST} are needed of each."
    spread = float(np.ptp(second - first)) if is_paired else float(np.ptp(first)) + float(np.ptp(second))
    if spread <= _ROUNDING * max(float(np.abs(first).max()), float(np.abs(second).max())):
        return "All values are equal, so chance cannot be told from a difference."
    return ""


def difference_test(
    first: NDArray[np.float64], second: NDArray[np.float64], *, alpha: float, is_paired: bool
) -> DifferenceTest:
    """Test the difference of two means, second less first: Welch's t-test, or one of pairs.

    Args:
        first: values of the first experiment.
        second: values of the second; of pairs in the same order.
        alpha: the level of significance.
        is_paired: whether values belong together.
    """
    result = stats.ttest_1samp(second - first, 0.0) if is_paired else stats.ttest_ind(second, first, equal_var=False)
    method = "paired t" if is_paired else "Welch's t"
    intervals = []
    for level in (1 - alpha, 1 - 2 * alpha):
        interval = result.confidence_interval(confidence_level=level)
        intervals.append(Interval(float(interval.low), float(interval.high), level, method))
    return DifferenceTest(float(result.pvalue), *intervals)


def equivalence_p_value(
    first: NDArray[np.float64], second: NDArray[np.float64], bound: Bound, *, is_paired: bool
) -> float:
    """Return the p-value of two one-sided tests: the second mean lies within the bound around the first one.

    Args:
        first: values of the first experiment.
        second: values of the second; of pairs in the same order.
        bound: what would not matter.
        is_paired: whether values belong together.
    """
    if bound.is_relative:
        share = bound.value / _PERCENT
        edges = sorted((first * (1 - share), first * (1 + share)), key=lambda edge: float(np.mean(edge)))
    else:
        edges = [first - bound.value, first + bound.value]
    lower, upper = edges
    if is_paired:
        above = stats.ttest_1samp(second - lower, 0.0, alternative="greater")
        below = stats.ttest_1samp(second - upper, 0.0, alternative="less")
    else:
        above = stats.ttest_ind(second, lower, equal_var=False, alternative="greater")
        below = stats.ttest_ind(second, upper, equal_var=False, alternative="less")
    return max(float(above.pvalue), float(below.pvalue))
