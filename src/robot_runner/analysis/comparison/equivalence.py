"""Statistics of two experiments: tests of difference and of equivalence within a bound, limits of agreement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from robot_runner.analysis.comparison.compared import Agreement, Bound
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.tested import Interval

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

__all__ = [
    "DifferenceTest",
    "agreement_of",
    "difference_test",
    "equivalence_p_value",
    "why_not_testable",
]


_PERCENT = 100.0
_FEWEST = 2
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
    result = _t_test(second, first, is_paired=is_paired)
    method = "paired t" if is_paired else "Welch's t"
    intervals = []
    for level in (1 - alpha, 1 - 2 * alpha):
        interval = result.confidence_interval(confidence_level=level)
        intervals.append(Interval(float(interval.low), float(interval.high), level, method))
    return DifferenceTest(float(result.pvalue), *intervals)


def equivalence_p_value(
    first: NDArray[np.float64], second: NDArray[np.float64], bound: Bound, *, is_paired: bool
) -> float:
    """Return the p-value of two one-sided tests (TOST): the second mean lies within the bound around the first one.

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
    above = _t_test(second, lower, is_paired=is_paired, alternative="greater")
    below = _t_test(second, upper, is_paired=is_paired, alternative="less")
    return max(float(above.pvalue), float(below.pvalue))


def _t_test(one: NDArray[np.float64], other: NDArray[np.float64], *, is_paired: bool, **settings: str) -> Any:
    """Return scipy's t-test of pairs, or Welch's."""
    with quiet():  # of experiments whose own values are all equal scipy says that precision may be lost
        if is_paired:
            return stats.ttest_1samp(one - other, 0.0, **settings)
        return stats.ttest_ind(one, other, equal_var=False, **settings)


#: Bland and Altman, "Statistical methods for assessing agreement between two methods of clinical measurement" (Lancet
#: 327, 1986): 95 % of normally distributed differences.
_SPREAD = 1.96


def agreement_of(
    groups: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]], *, is_paired: bool
) -> Agreement | None:
    """Return relative error and limits of agreement, or None where there is no pair.

    Args:
        groups: by combination: the values of the first and the second experiment; of pairs in the same order.
        is_paired: whether values belong together; otherwise those of one combination are put beside each other.
    """
    pairs = {
        label: [(float(one), float(other)) for one, other in zip(first, second, strict=False)]
        for label, (first, second) in groups.items()
        if len(first) and len(second)
    }
    differences = np.array([other - one for several in pairs.values() for one, other in several])
    if not len(differences):
        return None
    bias = float(differences.mean())
    spread = float(differences.std(ddof=1)) * _SPREAD if len(differences) >= _FEWEST else None
    references = (
        [pair for several in pairs.values() for pair in several]
        if is_paired
        else [
            (float(first.mean()), float(second.mean())) for first, second in groups.values() if len(first) * len(second)
        ]
    )
    return Agreement(
        pairs,
        are_natural=is_paired,
        bias=bias,
        lower=None if spread is None else bias - spread,
        upper=None if spread is None else bias + spread,
        error=_error(references),
    )


def _error(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return the mean absolute percentage error of the second values, in percent of the first ones."""
    if any(one == 0 for one, _ in pairs):
        return None
    return float(np.mean([abs(other - one) / abs(one) for one, other in pairs])) * _PERCENT
