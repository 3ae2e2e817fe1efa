"""Effect sizes with their confidence intervals, and the word for their magnitude.

All differences of means of a measure are divided by the same standard deviation, and so are the effects of factors with
more than two treatments, so that the sizes of a comparison agree in all tables.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
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
_MOST_STEPS = 1000  # each twice as long as the one before: beyond the largest floating-point number
#: By how much degrees of freedom that are equal may differ, relative to them.
_ROUNDING = 1e-9
#: For a larger F, or square of t, scipy's noncentral distributions return NaN, and take long: half a minute for 1e18.
_MOST_NONCENTRAL = 1e11
_LEAST_FOR_SPREAD = 2
#: For a larger sum of squares, in standard errors, Student's interval of its root agrees to five digits.
_MOST_BY_QUADRATURE = 1e5
#: Quantiles of the normal distribution; the probability beyond them is negligible.
_NORMAL = np.linspace(-8.0, 8.0, 161)


@dataclass(frozen=True, slots=True)
class _Thresholds:
    """The thresholds from which on an effect is small, medium or large, and their source."""

    limits: tuple[float, float, float]
    source: str

    def magnitude(self, value: float) -> Magnitude:
        return tuple(Magnitude)[bisect_right(self.limits, abs(value))]

    def size(self, name: str, value: float, interval: Interval | None, *, neutral: float = 0.0) -> EffectSize:
        """Return an effect size; its magnitude follows from its distance from the neutral value, that of no effect."""
        return EffectSize(name, value, interval, self.magnitude(value - neutral), self.source)


_COHEN_D = _Thresholds((0.2, 0.5, 0.8), "Cohen, Statistical Power Analysis for the Behavioral Sciences, 1988")
_COHEN_R = _Thresholds((0.1, 0.3, 0.5), _COHEN_D.source)
#: Cohen's f of 0.1, 0.25 and 0.4 as shares of variance; so no factor's effect is larger than its largest difference.
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

    If the standard deviation is known as precisely as the difference, the interval inverts the noncentral t
    distribution at the t-test of the difference (Cumming and Finch 2001; with unequal variances Delacre et al., Why
    Hedges' g*s based on the non-pooled standard deviation should be reported with Welch's t-test, 2021). Else it
    combines the intervals of the difference and of the standard deviation. Both exclude 0 if and only if the test is
    significant. The error and the degrees of freedom are those of the difference. The parts are the components of the
    variance, `spread` squared; there are none if it is known as precisely as the difference. The result is None
    without variation, and has no interval where that is beyond floating-point numbers.

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
    """Return omega squared: the share of an effect in the variance of effect and error, corrected for bias.

    The effect is on the means of all combinations, with equal weights. If the standard deviation is known as precisely
    as effects are, the interval inverts the noncentral F distribution at the test of the effect (Steiger 2004); else it
    is computed like that of Cohen's d. Its level is 1 - 2 alpha, so it excludes 0 if and only if the test, which is
    one-sided, is significant. F is infinite if its p-value is 0 in floating-point numbers, and `variance` is the mean
    of the squared effects on all combinations; for the parts see `cohens_d`. A partial one disregards the effects of
    other factors.
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
    """Return the F with this p-value, however small that is.

    It is computed with the beta distribution: scipy's `f.isf` subtracts p-values from 1, so that those of 1e-12 lose
    digits, and those below 1e-16 are lost.

    Example:
        >>> f_of_p_value(1e-30, (3, 40))
        443.946...
    """
    share = float(special.betaincinv(freedom[1] / 2, freedom[0] / 2, p_value))
    return freedom[1] * (1 - share) / (freedom[0] * share) if share > 0 else math.inf


def _is_known_apart(parts: Sequence[SpreadPart], freedom: float) -> bool:
    """Return whether a standard deviation has another precision than the difference that is divided by it."""
    telling = [part for part in parts if part.variance > 0]
    # Degrees of freedom that are equal, as where runs of one treatment alone vary, may differ by rounding.
    return len(telling) > 1 or any(part.freedom > freedom * (1 + _ROUNDING) for part in telling)


def _ratio_ends(limits: tuple[float, float, float], parts: Sequence[SpreadPart], level: float) -> tuple[float, float]:
    """Return the interval of a difference divided by a standard deviation that is independent of it.

    The limits of both are combined by the method of variance estimates recovery for ratios (Donner and Zou, Closed-form
    confidence intervals for functions of the normal mean and standard deviation, Statistical Methods in Medical
    Research 21, 2012); those of the variance, a sum, are modified large-sample ones (Graybill and Wang, Confidence
    intervals on nonnegative linear combinations of variances, JASA 75, 1980). `limits` are the low end of the
    interval of the difference, the difference, and the high end.
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
    """Return the interval of the norm of several contrasts, in standard errors: low end, median, high end.

    It inverts the distribution of F for a norm that is fixed in units of the measure, whereas a noncentrality is in
    units of the unknown standard error. For a single contrast it is Student's interval, with its distance from 0.
    """
    count, rest = freedom
    tail = (1 - level) / 2
    if f_value * count > _MOST_BY_QUADRATURE:
        middle, reach = math.sqrt(f_value * count - count + 1), float(stats.t.isf(tail, rest))
        return middle - reach, middle, middle + reach
    variance = stats.chi2.ppf(stats.norm.cdf(_NORMAL), rest) / rest  # divided by its true value, at quantiles
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
    """Return the confidence interval of the noncentrality of a t; None if it cannot be computed."""
    if t_value < 0:
        mirrored = noncentralities_of_t(-t_value, freedom, level)
        return None if mirrored is None else (-mirrored[1], -mirrored[0])
    if t_value**2 > _MOST_NONCENTRAL:
        return None
    tail = (1 - level) / 2
    step = math.sqrt(1 + t_value**2 / (2 * freedom))  # about the standard error of the noncentrality

    def at(share: float) -> float | None:
        # Far from the root scipy returns NaN, as for t = -2, 18 degrees of freedom and 30: the bracket begins at t.
        least = 0.0 if stats.t.cdf(t_value, freedom) > share else -math.inf
        return _root(lambda nc: float(stats.nct.cdf(t_value, freedom, nc)) - share, t_value, step, least)

    low, high = at(1 - tail), at(tail)
    return None if low is None or high is None else (low, high)


def noncentralities_of_f(f_value: float, freedom: tuple[float, float], level: float) -> tuple[float, float] | None:
    """Return the confidence interval of the noncentrality of an F; None if it cannot be computed."""
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
    """Return the root of a decreasing function, by a bracket that grows from a guess; None if there is none."""
    way = 1.0 if function(start) > 0 else -1.0
    near = start
    for _ in range(_MOST_STEPS):
        far = max(least, near + way * step)
        found = function(far) * way
        if math.isnan(found):
            return None
        if found <= 0:
            with suppress(ValueError):  # NaN inside the bracket
                return float(optimize.brentq(function, near, far))
            return None
        if far == least:
            return None
        near, step = far, 2 * step
    return None


def cliffs_delta(pairs: Sequence[tuple[Floats, Floats]], level: float = _LEVEL) -> EffectSize | None:
    """Return Cliff's delta: the share of pairs whose first value is larger, minus that of pairs where it is smaller.

    Its interval is that of its Fisher's z (of half the logit of A12) by t, with the variance and the degrees of freedom
    of Brunner and Munzel (The Nonparametric Behrens-Fisher Problem, Biometrical Journal 42, 2000): such limits stay in
    range, and hold for groups of unequal sizes and spreads (Konietschke, Hothorn and Brunner, Rank-based multiple test
    procedures and simultaneous confidence intervals, Electronic Journal of Statistics 6, 2012). Groups that do not
    overlap have the bound of Feng and Cliff (Monte Carlo Evaluation of Ordinal d, 2004). Delta is the mean over
    the combinations of the other factors, for each of which there is a pair of groups.

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
    """Return Vargha and Delaney's A12: the probability that a value of the first group is larger than of the second.

    It is Cliff's delta on another scale, with its interval.
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
    """Return for each value the share of others that are smaller, minus the share of those that are larger.

    It is computed by ranks: a table of all pairs would take gigabytes for thousands of runs.
    """
    others = np.sort(over)
    above, not_below = (np.searchsorted(others, of, side) for side in ("left", "right"))
    return (above - (len(others) - not_below)) / len(others)


def _exact_delta(one: Floats, other: Floats) -> Fraction:
    """Return delta as a fraction: in floating point, -1/6 - 2/6 + 3/6 is 1e-17, and full dominance may be below 1."""
    return Fraction(round(float(np.sum(_dominances(one, other) * len(other)))), len(one) * len(other))


def _delta_interval(pairs: Sequence[tuple[Floats, Floats]], delta: float, level: float) -> Interval | None:
    sizes = [(len(one), len(other)) for one, other in pairs]
    if min(map(min, sizes)) < _LEAST_FOR_SPREAD:
        return None
    if abs(delta) == 1:
        z = float(stats.norm.isf((1 - level) / 2))
        smaller = min(sum(size[side] for size in sizes) for side in (0, 1))
        inner = max(0.0, (smaller - z**2) / (smaller + z**2))
        return Interval(min(inner * delta, delta), max(inner * delta, delta), level, "Feng and Cliff 2004")
    parts = [tuple(_delta_parts(*pair)) for pair in pairs]
    least = [_least_variance(*pair) for pair in pairs]
    square = sum(max(one.variance + other.variance, each) for (one, other), each in zip(parts, least, strict=True))
    doubt = sum(part.variance**2 / part.freedom for both in parts for part in both)
    freedom = square**2 / doubt if doubt > 0 else min(part.freedom for both in parts for part in both)
    error = math.sqrt(square) / len(pairs)
    middle, reach = math.atanh(delta), float(stats.t.isf((1 - level) / 2, freedom)) * error / (1 - delta**2)
    return Interval(math.tanh(middle - reach), math.tanh(middle + reach), level, "Brunner and Munzel 2000, Fisher's z")


def _least_variance(one: Floats, other: Floats) -> float:
    """Return that of Cliff (Dominance statistics, Psychological Bulletin 114, 1993): few values may not vary by chance.

    Groups that do not overlap, beside others that do, count as if one pair more went the other way.
    """
    pairs = len(one) * len(other)
    delta = min(abs(float(_exact_delta(one, other))), (pairs - 1) / (pairs + 1))
    return (1 - delta**2) / (pairs - 1)


def _delta_parts(one: Floats, other: Floats) -> Iterator[SpreadPart]:
    """Yield what the values of either group add to the variance of delta."""
    for by_value in (_dominances(one, other), _dominances(other, one)):
        yield SpreadPart(float(np.var(by_value, ddof=1)) / len(by_value), len(by_value) - 1)
