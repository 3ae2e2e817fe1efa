"""The Theil-Sen slope for thousands of runs, whose pairs are too many for memory, or to be counted one by one.

The number of pairwise slopes below s equals the number of pairs that decrease after a line with slope s is subtracted,
which a sort counts. So the slope of a rank is the root of a function (the idea of Cole, Salowe, Steiger and Szemeredi,
An optimal-time algorithm for slope selection, SIAM Journal on Computing 18, 1989).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import optimize, stats

from robot_runner.analysis.arrays import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray


#: The most values for `scipy.stats.theilslopes`, which then needs some 100 MB: it stores each pair several times.
_MOST_AT_ONCE = 2_000
#: The tolerance of a slope, relative to that of the diagonal of all values.
_PRECISION = 1e-18
_MOST_STEPS = 500


class TheilSen(NamedTuple):
    """The median of all pairwise slopes, with its confidence interval (Sen 1968)."""

    slope: float
    low: float
    high: float


def theil_sen(places: Floats, values: Floats, level: float) -> TheilSen:
    """Return the slope like `scipy.stats.theilslopes`, in memory linear in the number of values.

    Places are in ascending order; pairs at the same place have no slope.

    Example:
        >>> theil_sen(np.arange(4.0), np.array([0.0, 2.0, 4.0, 6.0]), 0.95).slope
        2.0
    """
    if len(values) <= _MOST_AT_ONCE:
        found = stats.theilslopes(values, places, alpha=level)
        return TheilSen(float(found.slope), float(found.low_slope), float(found.high_slope))
    alike = _ties(places)
    count = (len(values) * (len(values) - 1) - int(np.sum(alike * (alike - 1)))) // 2
    low, high = _ends(places, values, count, level)
    ranks = (low, (count - 1) // 2, count // 2, high)
    slopes = _slopes_of_ranks(places, values, ranks)
    return TheilSen((slopes[ranks[1]] + slopes[ranks[2]]) / 2, slopes[low], slopes[high])


def _ties(values: Floats) -> Floats:
    return np.unique(values, return_counts=True)[1].astype(np.float64)


def _ends(places: Floats, values: Floats, count: int, level: float) -> tuple[int, int]:
    """Return the ranks of the ends of the interval (equation 2.6 of Sen 1968), rounded like scipy's."""
    n = len(values)
    alike = [float(np.sum(ties * (ties - 1) * (2 * ties + 5))) for ties in map(_ties, (places, values))]
    variance = (n * (n - 1) * (2 * n + 5) - sum(alike)) / 18
    half = float(stats.norm.ppf((1 + level) / 2)) * float(np.sqrt(variance))
    return max(round((count - half) / 2) - 1, 0), min(round((count + half) / 2), count - 1)


def _slopes_of_ranks(places: Floats, values: Floats, ranks: tuple[int, ...]) -> dict[int, float]:
    """Return the slopes of these ranks, from 0, among all pairwise slopes."""
    order = np.lexsort((values, places))  # pairs at the same place never decrease, whatever the line
    places, values = places[order], values[order]
    centred = values - np.median(values)  # for values far from 0, a line would be lost in rounding
    steepness = (float(np.ptp(values)) or 1.0) / float(np.ptp(places))
    precision = _PRECISION * steepness

    def beyond(slope: float, rank: int) -> float:
        return _falling(centred - slope * places) - rank - 0.5

    found = {}
    for rank in set(ranks):
        reach = steepness
        while not beyond(-reach, rank) < 0 < beyond(reach, rank):  # which it is once no pair is steeper
            reach *= 8
        near = optimize.brentq(beyond, -reach, reach, (rank,), xtol=precision, maxiter=_MOST_STEPS)
        # After a line with its slope is subtracted, both values of a pair are equal, and so neighbours.
        beside = np.argsort(centred - near * places, kind="stable")
        run = np.diff(places[beside])
        slopes = np.diff(values[beside])[run != 0] / run[run != 0]
        found[rank] = float(slopes[np.argmin(np.abs(slopes - near))]) + 0.0  # to avoid -0.0
    return found


def _falling(values: Floats) -> int:
    """Return the number of inversions, pairs with the larger value first."""
    size = 1 << (len(values) - 1).bit_length()
    ranks: NDArray[np.int32] = np.arange(size, dtype=np.int32)  # the padding is larger than all values
    ranks[_stable_order(values)] = np.arange(len(values), dtype=np.int32)
    found, half = 0, size // 2
    while half:
        # Each group of 2 * half ranks is split into its lower and its upper ones, which keep their order.
        groups = size // (2 * half)
        is_upper = (ranks & half) != 0
        lower, upper = np.flatnonzero(~is_upper), np.flatnonzero(is_upper)
        # The place of a lower rank in its group is its place among these plus the number of upper ones before it.
        found += int((lower & (2 * half - 1)).sum()) - groups * half * (half - 1) // 2
        ranks = np.stack([ranks.take(each).reshape(groups, half) for each in (lower, upper)], axis=1).ravel()
        half //= 2
    return found


def _stable_order(values: Floats) -> NDArray[np.intp]:
    order = np.argsort(values)  # much faster than a stable sort, from which only equal values differ
    in_order = values[order]
    return np.argsort(values, kind="stable") if (in_order[1:] == in_order[:-1]).any() else order
