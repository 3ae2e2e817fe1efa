"""The slope of Theil and Sen over thousands of runs, whose pairs would not fit into memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray


#: With so many values `scipy.stats.theilslopes` holds some 100 MB: it holds each pair several times, in both orders.
_MOST_AT_ONCE = 2_000
#: Pairs that tell about where a slope of a given rank lies; with so many, some 2 % of all slopes are near enough.
_DRAWN = 200_000
#: Standard errors of a drawn rank within which the rank is looked for at first.
_ERRORS = 5.0


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
    slopes = _slopes_of_ranks(places, values, count, ranks)
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


def _slopes_of_ranks(places: Floats, values: Floats, count: int, ranks: tuple[int, ...]) -> dict[int, float]:
    """Return the slopes of these ranks among the slopes of all pairs, from 0; `count` is their number."""
    drawn = _drawn_slopes(places, values)
    found: dict[int, float] = {}
    errors = _ERRORS
    while missing := [rank for rank in ranks if rank not in found]:
        around = [_bracket(drawn, rank / count, errors) for rank in missing]
        brackets = list(dict.fromkeys(around))
        counted = dict(zip(brackets, _counted(places, values, brackets), strict=True))
        for rank, bracket in zip(missing, around, strict=True):
            below, slopes, numbers = counted[bracket]
            place = int(np.searchsorted(below + np.cumsum(numbers), rank, side="right"))
            if rank >= below and place < len(slopes):
                found[rank] = float(slopes[place])
        errors *= 4  # a rank that was not there is looked for further away
    return found


def _drawn_slopes(places: Floats, values: Floats) -> Floats:
    """Return the slopes of pairs drawn at random, sorted; they only tell where to look, so that any seed will do."""
    random = np.random.default_rng(0)
    first, gap = random.integers(0, len(values), _DRAWN), random.integers(1, len(values), _DRAWN)
    second = (first + gap) % len(values)
    apart = places[second] != places[first]
    return np.sort((values[second] - values[first])[apart] / (places[second] - places[first])[apart])


def _bracket(drawn: Floats, share: float, errors: float) -> tuple[float, float]:
    """Return between which slopes that of a rank lies, which is given as a share of all."""
    reach = errors * max(np.sqrt(share * (1 - share) * len(drawn)), 1.0)
    low, high = int(share * len(drawn) - reach), int(share * len(drawn) + reach) + 1
    return (
        float(drawn[low]) if low >= 0 else -np.inf,
        float(drawn[high]) if high < len(drawn) else np.inf,
    )


def _counted(
    places: Floats, values: Floats, brackets: list[tuple[float, float]]
) -> Iterator[tuple[int, Floats, NDArray[np.int64]]]:
    """Yield for each bracket how many slopes are below it, and those within it: sorted, once each, with its number."""
    below = [0] * len(brackets)
    within: list[list[tuple[Floats, NDArray[np.int64]]]] = [[] for _ in brackets]
    for gap in range(1, len(values)):  # pairs so many values apart, all at once
        apart = places[gap:] > places[:-gap]
        slopes = (values[gap:] - values[:-gap])[apart] / (places[gap:] - places[:-gap])[apart]
        for place, (low, high) in enumerate(brackets):
            below[place] += int(np.count_nonzero(slopes < low))
            # Many slopes may be alike, as where values are whole numbers: they are held once.
            within[place].append(np.unique(slopes[(slopes >= low) & (slopes <= high)], return_counts=True))
    for number, parts in zip(below, within, strict=True):
        slopes = np.concatenate([part for part, _ in parts])
        order = np.argsort(slopes, kind="stable")
        yield number, slopes[order], np.concatenate([numbers for _, numbers in parts])[order]
