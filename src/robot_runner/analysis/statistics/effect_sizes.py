"""Effect sizes with their confidence intervals, and the word for their magnitude."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import optimize, special, stats

from robot_runner.analysis.statistics.descriptive import bootstrap_interval
from robot_runner.analysis.statistics.tested import EffectSize, Interval, Magnitude

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = [
    "cliffs_delta",
    "cohens_d",
    "correlation_magnitude",
    "eta_squared",
    "eta_squared_of_ranks",
    "kendalls_w",
    "paired_d",
    "paired_rank_biserial",
    "two_group_effects",
    "vargha_delaney",
]

_LEVEL = 0.95
_LEAST_FOR_SPREAD = 2
_NONCENTRAL_T = "noncentral t"
_NONCENTRAL_F = "noncentral F"


@dataclass(frozen=True, slots=True)
class _Thresholds:
    """From where on an effect is small, medium, large; and whose thresholds these are."""

    limits: tuple[float, float, float]
    source: str

    def magnitude(self, value: float) -> Magnitude:
        return tuple(Magnitude)[bisect_right(self.limits, abs(value))]

    def size(self, name: str, value: float, interval: Interval | None, *, neutral: float = 0.0) -> EffectSize:
        """Return an effect size, whose magnitude is its distance from the value that stands for no effect."""
        return EffectSize(name, value, interval, self.magnitude(value - neutral), self.source)


_COHEN_D = _Thresholds((0.2, 0.5, 0.8), "Cohen, Statistical Power Analysis for the Behavioral Sciences, 1988")
_COHEN_R = _Thresholds((0.1, 0.3, 0.5), _COHEN_D.source)
_COHEN_ETA = _Thresholds((0.01, 0.06, 0.14), _COHEN_D.source)
_ROMANO = _Thresholds((0.147, 0.33, 0.474), "Romano et al., Appropriate statistics for ordinal level data, 2006")
# Distances from 0.5 of 0.56, 0.64 and 0.71.
_VARGHA = _Thresholds((0.06, 0.14, 0.21), "Vargha and Delaney, A Critique and Improvement of the CL, 2000")


def two_group_effects(
    first: NDArray[np.float64], second: NDArray[np.float64], *, by_ranks: bool
) -> tuple[EffectSize, ...]:
    """Return Cohen's d, Cliff's delta and Vargha-Delaney's A12 of two independent groups, the fitting one first."""
    of_ranks = [cliffs_delta(first, second), vargha_delaney(first, second)]
    of_means = [effect] if (effect := cohens_d(first, second)) else []
    return tuple([*of_ranks, *of_means] if by_ranks else [*of_means, *of_ranks])


def cohens_d(first: NDArray[np.float64], second: NDArray[np.float64]) -> EffectSize | None:
    """Return Cohen's d: the difference of the means in pooled standard deviations.

    Its interval comes from the noncentral t distribution (Cumming and Finch 2001). None where there is no variation.
    """
    n, m = len(first), len(second)
    freedom = n + m - 2
    if min(n, m) < _LEAST_FOR_SPREAD:
        return None
    pooled = math.sqrt(((n - 1) * np.var(first, ddof=1) + (m - 1) * np.var(second, ddof=1)) / freedom)
    if pooled == 0:
        return None
    value = float(np.mean(first) - np.mean(second)) / pooled
    scale = math.sqrt(1 / n + 1 / m)
    return _COHEN_D.size("Cohen's d", value, _of_t(value / scale, freedom, scale))


def paired_d(differences: NDArray[np.float64]) -> EffectSize | None:
    """Return Cohen's d of paired values: the mean of the differences in their standard deviations."""
    n = len(differences)
    spread = float(np.std(differences, ddof=1)) if n >= _LEAST_FOR_SPREAD else 0.0
    if spread == 0:
        return None
    value = float(np.mean(differences)) / spread
    interval = _of_t(value * math.sqrt(n), n - 1, 1 / math.sqrt(n))
    return _COHEN_D.size("Cohen's d (paired)", value, interval)


def cliffs_delta(first: NDArray[np.float64], second: NDArray[np.float64]) -> EffectSize:
    """Return Cliff's delta: how much more often the first group's value is the larger of a pair than the smaller.

    Its interval is the asymmetric one of Feng and Cliff (Monte Carlo Evaluation of Ordinal d with Improved Confidence
    Interval, 2004), with their bound for groups that do not overlap.

    Example:
        >>> round(cliffs_delta(np.array([10.0, 20.0]), np.array([20.0, 30.0])).value, 3)
        -0.75
    """
    dominance = np.sign(first[:, None] - second[None, :])
    value = float(dominance.mean())
    return _ROMANO.size("Cliff's delta", value, _delta_interval(dominance, value))


def vargha_delaney(first: NDArray[np.float64], second: NDArray[np.float64]) -> EffectSize:
    """Return Vargha and Delaney's A12: how probably a value of the first group is larger than one of the second.

    It is Cliff's delta on another scale, and so is its interval.
    """
    delta = cliffs_delta(first, second)
    interval = delta.interval
    if interval is not None:
        interval = Interval((interval.low + 1) / 2, (interval.high + 1) / 2, interval.level, interval.method)
    return _VARGHA.size("Vargha-Delaney A12", (delta.value + 1) / 2, interval, neutral=0.5)


def paired_rank_biserial(differences: NDArray[np.float64]) -> EffectSize | None:
    """Return the matched-pairs rank-biserial correlation (Kerby, The Simple Difference Formula, 2014)."""
    nonzero = differences[differences != 0]
    if not len(nonzero):
        return None

    def share(of: NDArray[np.float64], axis: int = -1) -> Any:
        ranks = stats.rankdata(np.abs(of), axis=axis)
        return np.sum(ranks * np.sign(of), axis=axis) / np.sum(ranks, axis=axis)

    return _COHEN_R.size("rank-biserial correlation", float(share(nonzero)), bootstrap_interval((nonzero,), share))


def eta_squared(f_value: float, freedom: tuple[float, float], *, is_partial: bool = False) -> EffectSize:
    """Return eta squared of a one-way analysis of variance from its F; partial, of one effect among several."""
    between, within = freedom
    value = f_value * between / (f_value * between + within)
    name = "partial eta squared" if is_partial else "eta squared"
    return _COHEN_ETA.size(name, value, _of_f(f_value, between, within))


def eta_squared_of_ranks(groups: Sequence[NDArray[np.float64]]) -> EffectSize:
    """Return eta squared of a Kruskal-Wallis test: (H - k + 1) / (n - k), at least 0.

    Source: Tomczak and Tomczak, The need to report effect size estimates revisited, 2014. The interval is a
    bootstrap's.
    """

    def of(*samples: NDArray[np.float64], axis: int = -1) -> Any:
        h = stats.kruskal(*samples, axis=axis).statistic
        k, n = len(samples), sum(sample.shape[axis] for sample in samples)
        return np.maximum(0.0, (h - k + 1) / (n - k))

    return _COHEN_ETA.size("eta squared (H)", float(of(*groups)), bootstrap_interval(tuple(groups), of))


def kendalls_w(chi_squared: float, blocks: int, treatments: int) -> EffectSize:
    """Return Kendall's W of a Friedman test: how much the blocks agree on the order of the treatments, 0..1."""
    return _COHEN_R.size("Kendall's W", chi_squared / (blocks * (treatments - 1)), None)


def correlation_magnitude(value: float) -> Magnitude:
    """Return the word for a coefficient of correlation."""
    return _COHEN_R.magnitude(value)


def _of_t(t_value: float, freedom: float, scale: float) -> Interval | None:
    """Return the interval of an effect by inverting the noncentral t distribution."""
    reach = 10 * (1 + abs(t_value))
    tail = (1 - _LEVEL) / 2
    try:
        low, high = (
            optimize.brentq(lambda nc, share=share: special.nctdtr(freedom, nc, t_value) - share, -reach, reach)
            for share in (1 - tail, tail)
        )
    except ValueError:  # beyond what can be computed with floating-point numbers
        return None
    return Interval(low * scale, high * scale, _LEVEL, _NONCENTRAL_T)


def _of_f(f_value: float, between: float, within: float) -> Interval | None:
    """Return the interval of eta squared by inverting the noncentral F distribution (Steiger 2004)."""
    tail = (1 - _LEVEL) / 2
    total = between + within + 1
    try:
        ends = [_noncentrality(f_value, between, within, share) for share in (1 - tail, tail)]
    except ValueError:  # as above
        return None
    return Interval(ends[0] / (ends[0] + total), ends[1] / (ends[1] + total), _LEVEL, _NONCENTRAL_F)


def _noncentrality(f_value: float, between: float, within: float, share: float) -> float:
    if stats.f.cdf(f_value, between, within) <= share:
        return 0.0  # even without any effect so large an F is likely enough
    largest = math.log(50 * f_value * between + 1000)
    found = optimize.brentq(lambda log: special.ncfdtr(between, within, math.exp(log), f_value) - share, -20, largest)
    return math.exp(found)


def _delta_interval(dominance: NDArray[np.float64], delta: float) -> Interval | None:
    n, m = dominance.shape
    method = "Feng and Cliff 2004"
    if min(n, m) < _LEAST_FOR_SPREAD:
        return None
    z = float(stats.norm.ppf(1 - (1 - _LEVEL) / 2))
    if abs(delta) == 1:
        smaller = min(n, m)
        inner = max(0.0, (smaller - z**2) / (smaller + z**2))
        return Interval(min(inner * delta, delta), max(inner * delta, delta), _LEVEL, method)
    t = float(stats.t.ppf(1 - (1 - _LEVEL) / 2, n + m - 2))
    by_row, by_column = dominance.mean(axis=1), dominance.mean(axis=0)
    rows = float(np.sum((by_row - delta) ** 2))
    columns = float(np.sum((by_column - delta) ** 2))
    cells = float(np.sum((dominance - delta) ** 2))
    variance = (m**2 * rows + n**2 * columns - cells) / (n * m * (n - 1) * (m - 1))
    variance = max(variance, (1 - delta**2) / (n * m - 1))
    root = t * math.sqrt(variance) * math.sqrt((1 - delta**2) ** 2 + t**2 * variance)
    scale = 1 - delta**2 + t**2 * variance
    return Interval((delta - delta**3 - root) / scale, (delta - delta**3 + root) / scale, _LEVEL, method)
