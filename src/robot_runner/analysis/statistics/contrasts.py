"""Tests of contrasts of means with unequal variances: t, Welch-James, ANOVA-type and within blocks.

All functions take arrays with any number of leading axes, one entry for each experiment, so that their error rates can
be simulated (`python -m benchmarks statistics`).

Sources: Welch, The generalization of Student's problem when several different population variances are involved
(Biometrika 34, 1947) and On the comparison of several mean values (Biometrika 38, 1951); Johansen, The Welch-James
approximation to the distribution of the residual sum of squares in a weighted linear regression (Biometrika 67, 1980);
Brunner, Dette and Munk, Box-type approximations in nonparametric factorial designs (JASA 92, 1997); Geisser and
Greenhouse, An extension of Box's results (Annals of Mathematical Statistics 29, 1958); Huynh and Feldt, Estimation of
the Box correction (Journal of Educational Statistics 1, 1976); Krishnamoorthy, Lu and Mathew, A parametric bootstrap
approach for ANOVA with unequal variances (Computational Statistics and Data Analysis 51, 2007); Vovk and Wang,
Combining p-values via averaging (Biometrika 107, 2020).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.tested import Interval

#: The number of bootstrap draws: the standard error of p-values near 0.05 is then about 0.002.
DRAWS = 9999
#: The most values that are drawn at once, to limit memory.
_AT_ONCE = 2_000_000

#: The most blocks for sign flips, which then have 8,192 patterns.
MOST_FLIPPED = 14
#: Sums of squares whose relative difference is less are equal, except for rounding.
_SAME = 1e-9

#: A fixed seed, so that p-values are reproducible.
_SEED = 20210525

#: The fewest degrees of freedom per contrast for the F approximation: below, by simulation, it has 7 % (six groups of
#: five runs) to 11 % (eight groups of three runs) false positives at 5 %.
_FEWEST_FREEDOM = 2.3

#: The order of the power mean of p-values, chosen by simulation: lower orders have too many false positives (-1, the
#: harmonic mean: 7 % at 5 %), and higher ones have less power (0, the geometric mean).
_ORDER = -1 / 3

#: The most contrasts for a bootstrap: larger matrices take too long to invert thousands of times.
_MOST_INVERTED = 12

#: The degrees of freedom, per contrast and group, with one less than which Huynh and Feldt's correction holds its level
#: (4 to 6.7 % at 5 %; with fewer 6.9 to 7.7 %), by simulation.
FREEDOM_A_CONTRAST = 2

#: A variance below this share of the one that independent cells would have is rounding; so is a weight below this share
#: of the largest.
_ROUNDED = 1e-13
#: The relative difference, some units in the last place, up to which two means are those of the same values.
_LAST_PLACES = 1e-15

#: The largest ratio of standard deviations of contrasts: above it the smaller is 0, as two or more cells do not vary.
_SINGULAR = 1e6


class Moments(NamedTuple):
    """The means of cells and their covariance.

    Attributes:
        means: (..., groups, cells within a group).
        errors: the covariance of these means, (..., groups, cells, cells); groups are independent.
        freedom: degrees of freedom of the covariance, one for each group.
    """

    means: Floats
    errors: Floats
    freedom: Floats


class Contrast(NamedTuple):
    """A difference of means with its standard error and Satterthwaite's degrees of freedom."""

    estimate: Floats
    error: Floats
    freedom: Floats

    @property
    def t_value(self) -> Floats:
        """The estimate divided by its standard error."""
        return np.asarray(self.estimate / self.error)

    @property
    def p_value(self) -> Floats:
        """The two-sided p-value."""
        return np.asarray(2 * stats.t.sf(np.abs(self.t_value), self.freedom))

    def reach(self, alpha: float) -> float:
        """Return the half-width of the confidence interval of level 1 - alpha."""
        return float(self.error) * float(stats.t.ppf(1 - alpha / 2, float(self.freedom)))

    def interval(self, alpha: float) -> Interval:
        """Return the confidence interval of level 1 - alpha."""
        estimate, reach = float(self.estimate), self.reach(alpha)
        return Interval(estimate - reach, estimate + reach, 1 - alpha, "t distribution")


class Tested(NamedTuple):
    """An F statistic with its degrees of freedom."""

    f_value: Floats
    between: Floats
    within: Floats
    p_value: Floats


def rounding_of(values: Floats) -> float:
    """Return how large residuals can be by rounding alone, given the values, (..., values).

    The limit is relative to the range of the values, and to the values themselves, which may be far from 0.
    """
    range_of = float(np.max(np.abs(values - values.mean(axis=-1, keepdims=True))))
    return max(1e-10 * range_of, 1e-13 * float(np.max(np.abs(values))), 1e-300)


def beyond_rounding(variances: Floats, independent: Floats) -> Floats:
    """Return the variances of sums of cells, with 0 for those that are rounding alone: all units respond alike.

    They are compared with the variances if the cells were independent.
    """
    return np.where(variances <= _ROUNDED * independent, 0.0, variances)


def without_rounding(weights: Floats) -> Floats:
    """Return weights of cells, (..., cells), with 0 for those that are rounding alone.

    If no other cell of a contrast varies, such weights alone would determine its standard error.
    """
    return np.where(np.abs(weights) <= _ROUNDED * np.max(np.abs(weights)), 0.0, weights)


def contrast(moments: Moments, weights: Floats, *, is_corrected: bool = False) -> Contrast:
    """Estimate a weighted sum of means (Welch 1947; with Satterthwaite's degrees of freedom).

    The weights of the cells are (groups, cells within a group). If `is_corrected`, degrees of freedom are a ratio of
    unbiased estimates, and no more than for equal variances: with two runs each, by simulation, Satterthwaite's have
    2 % false positives at 5 %, and these 4 to 5 % (up to 9 % where one combination varies four times as much, and less
    where one has most of the weight).
    """
    weights = without_rounding(weights)
    estimate = np.einsum("gc,...gc->...", weights, moments.means)
    size = np.einsum("gc,...gc->...", np.abs(weights), np.abs(moments.means))
    estimate = np.where(np.abs(estimate) <= _LAST_PLACES * size, 0.0, estimate)  # of the same values in another order
    parts = np.einsum("gc,...gcd,gd->...g", weights, moments.errors, weights)
    parts = beyond_rounding(parts, np.einsum("gc,...gcc->...g", weights**2, moments.errors))
    variance = parts.sum(axis=-1)
    freedom = variance**2 / np.sum(parts**2 / moments.freedom, axis=-1)
    if is_corrected:
        told = np.sum(parts**2 / (moments.freedom + 2), axis=-1)
        alike = np.sum(weights**2, axis=-1) / (moments.freedom + 1)
        most = np.sum(alike) ** 2 / np.sum(alike**2 / moments.freedom)
        freedom = np.clip((variance**2 - 2 * told) / told, moments.freedom.min(), most)
    return Contrast(estimate, np.sqrt(variance), freedom)


def along(moments: Moments, within: Floats) -> Moments:
    """Return the moments of one weighted sum of the cells within each group, with weights of (cells,)."""
    errors = np.einsum("c,...gcd,d->...g", within, moments.errors, within)
    return Moments((moments.means @ within)[..., None], errors[..., None, None], moments.freedom)


def welch_james(moments: Moments, between: Floats) -> Tested | None:
    """Test several contrasts at once, with a separate variance for each group (Johansen 1980).

    For the groups of one factor it is Welch's ANOVA of 1951, and for a single contrast the square of Welch's t. The
    contrasts are of groups of one cell each, (contrasts, groups).

    Returns:
        None if it is not defined, because two or more groups do not vary.
    """
    means, variances = moments.means[..., 0], moments.errors[..., 0, 0]
    found = _wald(means, variances, between)
    if found is None:
        return None
    wald, shares = found
    count = len(between)
    a = np.sum(shares**2 / moments.freedom, axis=-1)
    freedom = count * (count + 2) / (3 * a)
    f_value = wald / (count + 2 * a - 6 * a / (count + 2))
    return Tested(f_value, np.full_like(f_value, count), freedom, np.asarray(stats.f.sf(f_value, count, freedom)))


def combined(p_values: Sequence[Floats]) -> Floats:
    """Combine several p-values of the same hypothesis by their power mean of order -1/3 (Vovk and Wang 2020).

    Equal p-values are returned as they are, and the result is never below the smallest. So two tests together have at
    most twice the error rate of each, whatever their dependence. With equal variances they agree, and little power is
    lost.

    Example:
        >>> [round(float(combined(np.array(each))), 3) for each in ([0.04, 0.04], [0.01, 0.5])]
        [0.04, 0.039]
    """
    with np.errstate(divide="ignore"):
        return np.asarray(np.mean(np.power(np.stack(p_values), _ORDER), axis=0) ** (1 / _ORDER))


def _wald(means: Floats, variances: Floats, between: Floats) -> tuple[Floats, Floats] | None:
    """Return Wald's statistic, and the leverage of each group."""
    if len(between) == means.shape[-1] - 1 and np.all(variances > 0):
        # All contrasts of the groups at once: no decomposition is needed.
        inverses = 1 / variances
        total = inverses.sum(axis=-1, keepdims=True)
        centre = np.sum(inverses * means, axis=-1, keepdims=True) / total
        return np.sum(inverses * (means - centre) ** 2, axis=-1), 1 - inverses / total
    # Decompose contrasts times standard deviations: their covariance would have the square of the condition number.
    scaled = between * np.sqrt(variances)[..., None, :]
    if not np.isfinite(scaled).all():
        return None
    left, sizes, right = np.linalg.svd(scaled, full_matrices=False)
    if not np.all(sizes[..., 0] < _SINGULAR * sizes[..., -1]):
        return None
    differences = np.einsum("...as,...a->...s", left, means @ between.T) / sizes
    return np.sum(differences**2, axis=-1), np.sum(right**2, axis=-2)


def can_be_bootstrapped(between: Floats) -> bool:
    """Return whether a bootstrap is fast enough, given the size of the matrices to invert."""
    return len(between) == between.shape[1] - 1 or len(between) <= _MOST_INVERTED


def is_crowded(freedom: Floats, between: Floats) -> bool:
    """Return whether groups are too many for their runs, so that Johansen's approximation is too liberal.

    This depends on the numbers of runs alone: on the degrees of freedom under equal variances.
    """
    count = len(between)
    found = _wald(np.zeros(len(freedom)), 1 / (freedom + 1), between)
    if found is None:
        return True
    a = float(np.sum(found[1] ** 2 / freedom))
    return count * (count + 2) / (3 * a) < _FEWEST_FREEDOM * count


def bootstrapped(test: Callable[[Moments], Floats], moments: Moments, draws: int = DRAWS) -> Floats:
    """Return the parametric-bootstrap p-value of a test (Krishnamoorthy, Lu and Mathew 2007).

    It is the share of simulated experiments without an effect whose p-value is at most the observed one. They have the
    estimated variances, so the p-value does not depend on an approximation by an F distribution. The test returns the
    p-value of an effect, given the moments of groups of one cell each.
    """
    random = np.random.default_rng(_SEED)
    p_value, variances = test(moments), moments.errors[..., 0, 0]
    smaller = np.zeros(variances.shape[:-1])
    for count in _parts(draws, max(1, _AT_ONCE // max(1, variances.size))):
        shape = (count, *variances.shape)
        means = random.normal(size=shape) * np.sqrt(variances)
        errors = variances * random.chisquare(np.broadcast_to(moments.freedom, shape)) / moments.freedom
        again = test(Moments(means[..., None], errors[..., None, None], moments.freedom))
        smaller += np.sum(again <= p_value, axis=0)
    return np.asarray(np.minimum(1.0, (1 + smaller) / (1 + draws)))


def _parts(total: int, size: int) -> Iterator[int]:
    while total > 0:
        yield min(size, total)
        total -= size


def box(moments: Moments, between: Floats, within: Floats, *, is_corrected: bool = False) -> Tested:
    """Test several contrasts by the sum of their squares, with Box's degrees of freedom.

    For independent runs this is the ANOVA-type statistic of Brunner, Dette and Munk (1997). Within blocks it is the
    analysis of variance with the correction of Greenhouse and Geisser.

    Args:
        moments: of the cells.
        between: the contrasts of groups, orthonormal, (contrasts, groups).
        within: the contrasts of the cells within each group, orthonormal, (contrasts, cells).
        is_corrected: whether degrees of freedom are a ratio of unbiased estimates, as those of Huynh and Feldt within
            one group of blocks: less conservative, and nearer to alpha.
    """
    differences = np.einsum("ag,...gc,bc->...ab", between, moments.means, within)
    spread = np.einsum("ac,...gcd,bd->...gab", within, moments.errors, within)
    shares = between.T @ between
    alone = np.einsum("ac,...gcc->...g", within**2, moments.errors)
    traces = np.diag(shares) * beyond_rounding(np.einsum("...gaa->...g", spread), alone)
    squares = np.diag(shares) ** 2 * np.einsum("...gab,...gba->...g", spread, spread)
    own = traces.sum(axis=-1)
    total, crossed = own**2, np.einsum("gh,...gab,...hba->...", shares**2, spread, spread)
    if is_corrected:
        unbiased = unbiased_squares(traces, squares, moments.freedom, len(within))
        total = total - 2 * np.sum(unbiased / moments.freedom, axis=-1)
        crossed = crossed + np.sum(unbiased - squares, axis=-1)
        squares = unbiased
    with np.errstate(divide="ignore"):
        freedom, rest = total / crossed, total / np.sum(squares / moments.freedom, axis=-1)
    if is_corrected:  # the bounds of the true degrees of freedom
        freedom = np.clip(freedom, 1.0, len(between) * len(within))
        rest = np.clip(rest, moments.freedom.min(), moments.freedom.sum() * len(within))
    f_value = np.sum(differences**2, axis=(-2, -1)) / own
    return Tested(f_value, freedom, rest, np.asarray(stats.f.sf(f_value, freedom, rest)))


def sign_flipped(contrasts: Floats) -> Floats:
    """Return the p-value of several contrasts within blocks by sign flips of the blocks, in all patterns.

    Without an effect, the contrasts of a block are as probable with the opposite sign if their distribution is
    symmetric about 0, whatever the covariances. This is so for normal values, and for treatments that are exchangeable
    within blocks. So the share of patterns whose sum is at least as far from 0 is an exact p-value (Fisher, The Design
    of Experiments, 1935; for vectors: Chung and Fraser, Randomization tests for a multivariate two-sample problem, JASA
    53, 1958). The contrasts of each block are orthonormal, (..., blocks, contrasts).
    """
    blocks = contrasts.shape[-2]
    observed = np.sum(contrasts.sum(axis=-2) ** 2, axis=-1) * (1 - _SAME)
    observed -= _SAME**2 * np.sum(contrasts**2, axis=(-2, -1))  # a sum of 0 is none by rounding
    as_far = np.zeros(observed.shape)
    for pattern in range(2 ** (blocks - 1)):  # the opposite pattern has the same sums of squares
        signs = np.array([1.0, *(1.0 - 2 * (pattern >> place & 1) for place in range(blocks - 1))])
        as_far += np.sum(np.einsum("b,...bc->...c", signs, contrasts) ** 2, axis=-1) >= observed
    return np.asarray(as_far / 2 ** (blocks - 1))


def unbiased_squares(traces: Floats, squares: Floats, freedom: Floats, count: int) -> Floats:
    """Return unbiased estimates of the traces of squared covariances (Huynh and Feldt 1976, from Wishart's moments).

    Args:
        traces: of the covariances of each group.
        squares: the traces of their squares.
        freedom: their degrees of freedom.
        count: their order; for order 1, the square of a trace is the trace of the square.
    """
    if count == 1:
        return squares * freedom / (freedom + 2)
    return freedom * (freedom * squares - traces**2) / ((freedom + 2) * (freedom - 1))
