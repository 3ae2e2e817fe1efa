"""Effect sizes with their confidence intervals, and the word for their magnitude.

Differences of means are divided by one standard deviation for the whole measure, and so are the effects of factors with
more treatments: sizes of one comparison agree, whichever table they stand in.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy import optimize, special, stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.cell_moments import SpreadPart
from robot_runner.analysis.statistics.descriptive import bootstrap_interval
from robot_runner.analysis.statistics.tested import EffectSize, Interval, Magnitude

_LEVEL = 0.95
_MOST_STEPS = 1000  # each twice as long as the one before: past the largest number there is
#: Of a larger F, or square of t, scipy's noncentral distributions are no number, and take the longer for it: of 1e18
#: half a minute.
_MOST_NONCENTRAL = 1e11
_LEAST_FOR_SPREAD = 2
#: Of a larger sum of squares, in standard errors, Student's interval of its root agrees to five digits.
_MOST_BY_QUADRATURE = 1e5
#: Quantiles of the normal distribution; beyond, nothing is left.
_NORMAL = np.linspace(-8.0, 8.0, 161)


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
#: Of Cohen's f 0.1, 0.25 and 0.4, as shares of variance; so no factor's effect is larger than its largest difference.
_COHEN_OMEGA = _Thresholds((0.0099, 0.0588, 0.1379), _COHEN_D.source)
_ROMANO = _Thresholds((0.147, 0.33, 0.474), "Romano et al., Appropriate statistics for ordinal level data, 2006")
# Distances from 0.5 of 0.56, 0.64 and 0.71.
_VARGHA = _Thresholds((0.06, 0.14, 0.21), "Vargha and Delaney, A Critique and Improvement of the CL, 2000")


def cohens_d(
    difference: float,
    error: float,
    freedom: float,
    spread: float,
    parts: Sequence[SpreadPart] = (),
    *,
    level: float = _LEVEL,
    name: str = "Cohen's d",
) -> EffectSize | None:
    """Return a difference in standard deviations.

    Where the standard deviation is as well known as the difference, the interval inverts the noncentral t distribution
    at the t-test of the difference (Cumming and Finch 2001; with unequal spreads Delacre et al., Why Hedges' g*s based
    on the non-pooled standard deviation should be reported with Welch's t-test, 2021). Else it is made of the interval
    of the difference and that of the standard deviation. Either way it leaves out 0 exactly where the test is
    significant.

    Args:
        difference: of two means.
        error: its standard error.
        freedom: the degrees of freedom of that.
        spread: the standard deviation.
        parts: what its square is the sum of; none where it is as well known as the difference is.
        level: the confidence.
        name: what it is called.

    Returns:
        None where there is no variation; without an interval where that is beyond floating-point numbers.

    Example:
        >>> round(cohens_d(2.0, 0.5, 18, 1.0).interval.low, 2)
        0.81
    """
    if not (spread > 0 and error > 0 and math.isfinite(freedom)):
        return None
    if not _is_known_apart(parts, freedom):
        ends = noncentralities_of_t(difference / error, freedom, level)
        scale = error / spread
        interval = None if ends is None else Interval(ends[0] * scale, ends[1] * scale, level, "noncentral t")
    else:
        reach = error * float(stats.t.isf((1 - level) / 2, freedom))
        limits = (difference - reach, difference, difference + reach)
        interval = Interval(*_ratio_ends(limits, parts, level), level, "MOVER-R")
    return _COHEN_D.size(name, difference / spread, interval)


def omega_squared(
    f_value: float,
    freedom: tuple[float, float],
    variance: float,
    spread: float,
    parts: Sequence[SpreadPart] = (),
    *,
    alpha: float,
    is_partial: bool,
) -> EffectSize | None:
    """Return omega squared: the share of an effect in the variance of the effect and of chance, freed of its bias.

    The effect is that on the means of all combinations, each of which counts the same. Where the standard deviation is
    as well known as effects are, the interval inverts the noncentral F distribution at the test of the effect (Steiger
    2004); else it is made as that of Cohen's d is. It is one of 1 - 2 alpha: so it leaves out 0 exactly where the test,
    which looks at one side, is significant.

    Args:
        f_value: of the test; infinite where its p-value is 0 in floating-point numbers.
        freedom: its degrees of freedom.
        variance: the mean of the squared effects on all combinations.
        spread: the standard deviation.
        parts: what its square is the sum of; none where it is as well known as effects are.
        alpha: the level of significance.
        is_partial: whether other factors' effects are left out of account.
    """
    if not (spread > 0 and f_value > 0 and variance > 0):
        return None
    ratio = variance / spread**2
    level = 1 - 2 * alpha
    ends, method = None, "noncentral F"
    if not _is_known_apart(parts, freedom[1]):
        noncentralities = noncentralities_of_f(f_value, freedom, level)
        ends = noncentralities and tuple(end * ratio / (f_value * freedom[0]) for end in noncentralities)
    elif math.isfinite(f_value):
        scale = math.sqrt(variance / (f_value * freedom[0]))
        low, middle, high = (scale * each for each in _norm_limits(f_value, freedom, level))
        ends, method = tuple(end**2 for end in _ratio_ends((low, middle, high), parts, level)), "MOVER-R"
    shares = None if ends is None else [end / (1 + end) for end in ends]
    interval = None if shares is None else Interval(shares[0], shares[1], level, method)
    value = max(0.0, 1 - 1 / f_value) * ratio
    name = "partial omega squared" if is_partial else "omega squared"
    return _COHEN_OMEGA.size(name, value / (1 + value), interval)


def f_of_p_value(p_value: float, freedom: tuple[float, float]) -> float:
    """Return the F that has this p-value, however small that is.

    It comes from the beta distribution: scipy's `f.isf` takes p-values from 1, so that those of 1e-12 lose digits, and
    of those below 1e-16 nothing is left.

    Example:
        >>> f_of_p_value(1e-30, (3, 40))
        443.946...
    """
    share = float(special.betaincinv(freedom[1] / 2, freedom[0] / 2, p_value))
    return freedom[1] * (1 - share) / (freedom[0] * share) if share > 0 else math.inf


def _is_known_apart(parts: Sequence[SpreadPart], freedom: float) -> bool:
    """Return whether a standard deviation is known otherwise than what is divided by it, and not only as well."""
    telling = [part for part in parts if part.variance > 0]
    return len(telling) > 1 or any(part.freedom > freedom for part in telling)


def _ratio_ends(limits: tuple[float, float, float], parts: Sequence[SpreadPart], level: float) -> tuple[float, float]:
    """Return the interval of a difference over a standard deviation, which is independent of it.

    Limits of both are put together by the method of variance estimates recovery for ratios (Donner and Zou,
    Closed-form confidence intervals for functions of the normal mean and standard deviation, Statistical Methods in
    Medical Research 21, 2012); those of the variance, a sum, are modified large-sample ones (Graybill and Wang,
    Confidence intervals on nonnegative linear combinations of variances, JASA 75, 1980).

    Args:
        limits: the interval of the difference, with the difference in its middle.
        parts: the independent parts of the variance.
        level: the confidence.
    """
    tail = (1 - level) / 2
    square = sum(part.variance for part in parts)
    above = [part.variance * (part.freedom / float(stats.chi2.ppf(tail, part.freedom)) - 1) for part in parts]
    below = [part.variance * (1 - part.freedom / float(stats.chi2.isf(tail, part.freedom))) for part in parts]
    spread, largest, smallest = map(math.sqrt, (square, square + math.hypot(*above), square - math.hypot(*below)))

    def low_end(difference: float, low: float) -> float:
        product = difference * spread
        limit = largest if low > 0 else smallest
        steepness, height = limit * (2 * spread - limit), low * (2 * difference - low)
        root = math.sqrt(max(0.0, product**2 - steepness * height))
        return height / (product + root) if difference > 0 else (product - root) / steepness

    low, difference, high = limits
    return low_end(difference, low), -low_end(-difference, -high)


def _norm_limits(f_value: float, freedom: tuple[float, float], level: float) -> tuple[float, float, float]:
    """Return the interval of the size of several contrasts together, in standard errors, with the median in its middle.

    It inverts the distribution of F for a size that is fixed in units of the measure, where a noncentrality is one in
    units of the unknown error: of a single contrast it is Student's interval, as far from 0 as that is.
    """
    count, rest = freedom
    tail = (1 - level) / 2
    if f_value * count > _MOST_BY_QUADRATURE:
        middle, reach = math.sqrt(f_value * count - count + 1), float(stats.t.isf(tail, rest))
        return middle - reach, middle, middle + reach
    variance = stats.chi2.ppf(stats.norm.cdf(_NORMAL), rest) / rest  # over its true value, at quantiles
    weights = stats.norm.pdf(_NORMAL) * (_NORMAL[1] - _NORMAL[0])

    def at(share: float) -> float:
        if stats.f.cdf(f_value, *freedom) <= share:
            return 0.0  # even without any effect so large an F is likely enough

        def below(size: float) -> float:
            chances = stats.ncx2.cdf(f_value * count * variance, count, size**2 * variance)
            return float(weights @ chances) - share

        start = math.sqrt(f_value * count)
        found = _root(below, start, 1.0, least=0.0)
        return start if found is None else found

    return at(1 - tail), at(0.5), at(tail)


def noncentralities_of_t(t_value: float, freedom: float, level: float) -> tuple[float, float] | None:
    """Return between which noncentralities a t lies with this confidence; None where that cannot be computed."""
    if t_value < 0:
        mirrored = noncentralities_of_t(-t_value, freedom, level)
        return None if mirrored is None else (-mirrored[1], -mirrored[0])
    if t_value**2 > _MOST_NONCENTRAL:
        return None
    tail = (1 - level) / 2
    step = math.sqrt(1 + t_value**2 / (2 * freedom))  # how well the noncentrality is known

    def at(share: float) -> float | None:
        # Far from its root the distribution is NaN, as of -2 at 18 degrees of freedom and 30: the bracket begins at t.
        least = 0.0 if stats.t.cdf(t_value, freedom) > share else -math.inf
        return _root(lambda nc: float(stats.nct.cdf(t_value, freedom, nc)) - share, t_value, step, least)

    low, high = at(1 - tail), at(tail)
    return None if low is None or high is None else (low, high)


def noncentralities_of_f(f_value: float, freedom: tuple[float, float], level: float) -> tuple[float, float] | None:
    """Return between which noncentralities an F lies with this confidence; None where that cannot be computed."""
    tail = (1 - level) / 2
    if f_value * freedom[0] > _MOST_NONCENTRAL:
        return None

    def at(share: float) -> float | None:
        if stats.f.cdf(f_value, *freedom) <= share:
            return 0.0  # even without any effect so large an F is likely enough
        start = f_value * freedom[0]
        return _root(lambda nc: float(stats.ncf.cdf(f_value, *freedom, nc)) - share, start, 1 + start, least=0.0)

    low, high = at(1 - tail), at(tail)
    return None if low is None or high is None else (low, high)


def _root(function: Callable[[float], float], start: float, step: float, least: float = -math.inf) -> float | None:
    """Return where a falling function crosses zero, from a bracket that grows from a guess; None where none is."""
    way = 1.0 if function(start) > 0 else -1.0
    near = start
    for _ in range(_MOST_STEPS):
        far = max(least, near + way * step)
        found = function(far) * way
        if math.isnan(found):
            return None
        if found <= 0:
            with suppress(ValueError):  # not a number somewhere between
                return float(optimize.brentq(function, near, far))
            return None
        if far == least:
            return None
        near, step = far, 2 * step
    return None


def cliffs_delta(pairs: Sequence[tuple[Floats, Floats]], level: float = _LEVEL) -> EffectSize | None:
    """Return Cliff's delta: how much more often the first group's value is the larger of a pair than the smaller.

    Its interval is the asymmetric one of Feng and Cliff (Monte Carlo Evaluation of Ordinal d with Improved Confidence
    Interval, 2004), with their bound for groups that do not overlap.

    Args:
        pairs: the values of the first and the second group, once for each combination of the other factors; delta is
            the mean over these.
        level: the confidence.

    Example:
        >>> round(cliffs_delta([(np.array([10.0, 20.0]), np.array([20.0, 30.0]))]).value, 3)
        -0.75
    """
    pairs = [(one, other) for one, other in pairs if len(one) and len(other)]
    if not pairs:
        return None
    value = float(sum(_exact_delta(*pair) for pair in pairs) / len(pairs))
    return _ROMANO.size("Cliff's delta", value, _delta_interval(pairs, value, level))


def vargha_delaney(delta: EffectSize) -> EffectSize:
    """Return Vargha and Delaney's A12: how probably a value of the first group is larger than one of the second.

    It is Cliff's delta on another scale, and so is its interval.
    """
    interval = delta.interval
    if interval is not None:
        interval = Interval((interval.low + 1) / 2, (interval.high + 1) / 2, interval.level, interval.method)
    return _VARGHA.size("Vargha-Delaney A12", (delta.value + 1) / 2, interval, neutral=0.5)


def paired_rank_biserial(differences: Floats, level: float = _LEVEL) -> EffectSize | None:
    """Return the matched-pairs rank-biserial correlation (Kerby, The Simple Difference Formula, 2014)."""
    nonzero = differences[differences != 0]
    if not len(nonzero):
        return None

    def share(of: Floats, axis: int = -1) -> Any:
        ranks = stats.rankdata(np.abs(of), axis=axis)
        return np.sum(ranks * np.sign(of), axis=axis) / np.sum(ranks, axis=axis)

    interval = bootstrap_interval(nonzero, share, level)
    return _COHEN_R.size("rank-biserial correlation", float(share(nonzero)), interval)


def correlation_magnitude(value: float) -> Magnitude:
    """Return the word for a coefficient of correlation."""
    return _COHEN_R.magnitude(value)


def _dominances(of: Floats, over: Floats) -> Floats:
    """Return for each value how many others it is above less how many it is below, as a share of them.

    By ranks: the table of all pairs would take gigabytes for thousands of runs.
    """
    others = np.sort(over)
    above, not_below = (np.searchsorted(others, of, side) for side in ("left", "right"))
    return (above - (len(others) - not_below)) / len(others)


def _exact_delta(one: Floats, other: Floats) -> Fraction:
    """Return the share of pairs: summed as decimals, -1/6 - 2/6 + 3/6 would be 1e-17, and all of them less than 1."""
    return Fraction(round(float(np.sum(_dominances(one, other) * len(other)))), len(one) * len(other))


def _delta_interval(pairs: Sequence[tuple[Floats, Floats]], delta: float, level: float) -> Interval | None:
    method = "Feng and Cliff 2004"
    sizes = [(len(one), len(other)) for one, other in pairs]
    if min(map(min, sizes)) < _LEAST_FOR_SPREAD:
        return None
    z = float(stats.norm.isf((1 - level) / 2))
    if abs(delta) == 1:
        smaller = min(sum(size[side] for size in sizes) for side in (0, 1))
        inner = max(0.0, (smaller - z**2) / (smaller + z**2))
        return Interval(min(inner * delta, delta), max(inner * delta, delta), level, method)
    t = float(stats.t.isf((1 - level) / 2, sum(n + m - 2 for n, m in sizes)))
    variance = sum(_delta_variance(*pair) for pair in pairs) / len(pairs) ** 2
    root = t * math.sqrt(variance) * math.sqrt((1 - delta**2) ** 2 + t**2 * variance)
    scale = 1 - delta**2 + t**2 * variance
    return Interval((delta - delta**3 - root) / scale, (delta - delta**3 + root) / scale, level, method)


def _delta_variance(one: Floats, other: Floats) -> float:
    n, m = len(one), len(other)
    by_row, by_column = _dominances(one, other), -_dominances(other, one)
    delta = float(by_row.mean())
    others = np.sort(other)
    ties = int(np.sum(np.searchsorted(others, one, "right") - np.searchsorted(others, one, "left")))
    rows, columns = (float(np.sum((each - delta) ** 2)) for each in (by_row, by_column))
    cells = n * m * (1 - delta**2) - ties  # each pair's dominance is -1, 0 or 1
    variance = (m**2 * rows + n**2 * columns - cells) / (n * m * (n - 1) * (m - 1))
    return float(max(variance, (1 - delta**2) / (n * m - 1)))
