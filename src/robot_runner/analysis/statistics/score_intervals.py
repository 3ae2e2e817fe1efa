"""Score intervals of shares from 0 to 1: Wilson's of one, Newcombe's of a difference, and those of weighted sums."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from scipy import optimize

#: The weights of a difference.
DIFFERENCE = (1.0, -1.0)
#: The largest half-width of an interval, in standard deviations, in the search for a score.
_FURTHEST = 1e4


class Share(NamedTuple):
    """A share from 0 to 1, and its effective number of runs."""

    value: float
    runs: float


def score_ends(share: float, n: float, z: float) -> tuple[float, float]:
    """Return the ends of Wilson's score interval (Wilson 1927), as shares from 0 to 1."""
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(0.0, min(share, centre - half)), min(1.0, max(share, centre + half))  # despite rounding


def sum_of(shares: Sequence[Share], weights: Sequence[float]) -> float:
    """Return a weighted sum of shares."""
    return sum(weight * share.value for share, weight in zip(shares, weights, strict=True))


def sum_ends(shares: Sequence[Share], weights: Sequence[float], z: float) -> tuple[float, float]:
    """Return the ends of the interval of a weighted sum of independent shares.

    Of a difference it is method 10 of Newcombe, Statistics in Medicine 17, 1998, of other sums that of Zou, Huang and
    Zhang, Computational Statistics and Data Analysis 53, 2009. The half-width `z` is in standard deviations.
    """
    below = above = 0.0
    for share, weight in zip(shares, weights, strict=True):
        low, high = (weight * (end - share.value) for end in score_ends(*share, z))
        below, above = math.hypot(below, min(low, high)), math.hypot(above, max(low, high))
    total = sum_of(shares, weights)
    return total - below, total + above


def score_of(shares: Sequence[Share], weights: Sequence[float], null: float = 0.0) -> float:
    """Return the z score of a weighted sum: the signed half-width of the interval that ends at the null value."""
    total = sum_of(shares, weights)
    if total == null:
        return 0.0
    end, sign = (0, 1.0) if total > null else (1, -1.0)

    def left(z: float) -> float:
        return sign * (sum_ends(shares, weights, z)[end] - null)

    return sign * (math.inf if left(_FURTHEST) >= 0 else float(optimize.brentq(left, 0.0, _FURTHEST)))
