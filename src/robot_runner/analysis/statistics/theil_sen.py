"""The slope of Theil and Sen over thousands of runs, whose pairs would not fit into memory, nor be counted one by one.

The slopes of all pairs that are below a number are as many as the pairs that fall once a line of this slope is taken
away, and a sort counts these. So the slope of a rank is the root of a function (Cole, Salowe, Steiger and Szemeredi, An
optimal-time algorithm for slope selection, SIAM Journal on Computing 18, 1989, have the idea).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import optimize, stats

from robot_runner.analysis.arrays import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray


#: With so many values `scipy.stats.theilslopes` holds some 100 MB: it holds each pair several times, in both orders.
_MOST_AT_ONCE = 2_000
#: How closely a slope is looked for, as a share of that from one corner of all values to the other.
_PRECISION = 1e-18
_MOST_STEPS = 500


class TheilSen(NamedTuple):
    """The median of the slopes of all pairs of values, with its confidence interval (Sen 1968)."""

    slope: float
    low: float
    high: float


def theil_sen(places: Floats, values: Floats, level: float) -> TheilSen:
    """Return the slope as `scipy.stats.theilslopes` does, in memory that grows with the values and not their pairs.

    Args:
        places: ascending; pairs of which both are alike have no slope.
        values: as many, at least two.
        level: of the confidence interval, as in 0.95.

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
    """Return the ranks of the ends of the interval (equation 2.6 of Sen 1968), rounded as scipy rounds them."""
    n = len(values)
    alike = [float(np.sum(ties * (ties - 1) * (2 * ties + 5))) for ties in map(_ties, (places, values))]
    variance = (n * (n - 1) * (2 * n + 5) - sum(alike)) / 18
    half = float(stats.norm.ppf((1 + level) / 2)) * float(np.sqrt(variance))
    return max(round((count - half) / 2) - 1, 0), min(round((count + half) / 2), count - 1)


def _slopes_of_ranks(places: Floats, values: Floats, ranks: tuple[int, ...]) -> dict[int, float]:
    """Return the slopes of these ranks among the slopes of all pairs, from 0."""
    order = np.lexsort((values, places))  # of values at the same place none falls, whatever the line
    places, values = places[order], values[order]
    centred = values - np.median(values)  # a line would be lost in the rounding of values that are far from 0
    gaps = np.diff(places)
    rise = float(np.ptp(values)) or 1.0
    reach, precision = 2 * rise / float(gaps[gaps > 0].min()), _PRECISION * rise / float(np.ptp(places))

    def beyond(slope: float, rank: int) -> float:
        return _falling(centred - slope * places) - rank - 0.5

    found = {}
    for rank in set(ranks):
        near = optimize.brentq(beyond, -reach, reach, (rank,), xtol=precision, maxiter=_MOST_STEPS)
        # Once a line of its own slope is taken away, both values of a pair are alike, and so neighbours.
        beside = np.argsort(centred - near * places, kind="stable")
        run = np.diff(places[beside])
        slopes = np.diff(values[beside])[run != 0] / run[run != 0]
        found[rank] = float(slopes[np.argmin(np.abs(slopes - near))]) + 0.0  # and not -0.0
    return found


def _falling(values: Floats) -> int:
    """Return how many pairs of values have the larger one first, by merging sorted halves into ever larger ones."""
    size = 1 << (len(values) - 1).bit_length()
    rows: NDArray[np.intp] = np.arange(size)  # what is added behind is larger than all others
    rows[np.argsort(values, kind="stable")] = np.arange(len(values))
    found, half = 0, 1
    while half < size:
        rows = rows.reshape(-1, 2 * half)
        order = np.argsort(rows, axis=1, kind="stable")
        # The place of a value of the first half is its place there, and those of the other half that are smaller.
        moved = np.flatnonzero(order < half) % (2 * half)
        found += int(moved.sum()) - len(rows) * half * (half - 1) // 2
        rows, half = np.take_along_axis(rows, order, axis=1), 2 * half
    return found
