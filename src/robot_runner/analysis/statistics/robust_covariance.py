"""Least squares with standard errors for unequal variances, and degrees of freedom for few runs.

The covariance is bias-reduced (CR2; HC2 for independent runs). Without covariates it yields a separate variance for
each combination, so that the test of a difference is Welch's t test. With blocks it is clustered by block, and without
covariates the test of a difference is the paired t test. Degrees of freedom are Satterthwaite's; for several contrasts
those of the approximate Hotelling test, both under working variances.

Sources: MacKinnon and White, Some heteroskedasticity-consistent covariance matrix estimators with improved finite
sample properties (Journal of Econometrics 29, 1985); Bell and McCaffrey, Bias reduction in standard errors for linear
regression with multi-stage samples (Survey Methodology 28, 2002); Tipton and Pustejovsky, Small-sample adjustments for
tests of moderators and model fit using robust variance estimation in meta-regression (Journal of Educational and
Behavioral Statistics 40, 2015); Pustejovsky and Tipton, Small-sample methods for cluster-robust variance estimation
(Journal of Business and Economic Statistics 36, 2018).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.contrasts import Contrast, Tested

#: A run whose residual has less than this share of the error variance is fitted exactly, and does not inform the error.
_NO_FREEDOM = 1e-8
#: Eigenvalues below this share of the largest are rounding.
_SINGULAR = 1e-12


class RobustFit(NamedTuple):
    """A model fitted by least squares.

    Attributes:
        beta: the coefficients.
        residuals: of each run, sorted by unit.
        exog: the design matrix, sorted by unit, (runs, coefficients).
        inverse: of its cross products.
        scaled: the design matrix, each unit multiplied by the matrix that corrects the bias of its residuals.
        starts: the index of the first run of each unit.
        working: the working variance of each run, for degrees of freedom.
    """

    beta: Floats
    residuals: Floats
    exog: Floats
    inverse: Floats
    scaled: Floats
    starts: Numbers
    working: Floats

    @property
    def covariance(self) -> Floats:
        """The covariance of the coefficients."""
        scores = np.add.reduceat(self.scaled * self.residuals[:, None], self.starts, axis=0) @ self.inverse
        return np.asarray(scores.T @ scores, dtype=np.float64)

    def contrast(self, weights: Floats) -> Contrast:
        """Estimate a weighted sum of coefficients, with Satterthwaite's degrees of freedom."""
        expected, told = self._moments(weights[None, :])
        spread = float(weights @ self.covariance @ weights)
        freedom = 2 * expected[0, 0] ** 2 / told if told > 0 else np.nan
        return Contrast(*map(np.asarray, (weights @ self.beta, np.sqrt(max(0.0, spread)), freedom)))

    def hotelling(self, weights: Floats) -> Tested | None:
        """Test several sums at once, with weights of (sums, coefficients); None for too few runs.

        This is the approximate Hotelling test of Tipton and Pustejovsky (2015).
        """
        count = len(weights)
        values, vectors = np.linalg.eigh(self._moments(weights)[0])
        if not values[0] > _SINGULAR * values[-1]:
            return None
        root = vectors / np.sqrt(values) @ vectors.T
        _, told = self._moments(root @ weights)
        freedom = count * (count + 1) / told if told > 0 else np.nan
        spread = weights @ self.covariance @ weights.T
        within = freedom - count + 1
        if not within > 1 or np.linalg.matrix_rank(spread, hermitian=True) < count:
            return None
        sums = weights @ self.beta
        f_value = float(sums @ np.linalg.solve(spread, sums)) * within / (freedom * count)
        return Tested(*map(np.asarray, (f_value, float(count), within, stats.f.sf(f_value, count, within))))

    def box(self, weights: Floats, *, is_repeated: bool = False) -> Tested:
        """Test several sums by the sum of their squares, with Box's degrees of freedom.

        Args:
            weights: orthonormal contrasts of cells, (sums, coefficients).
            is_repeated: whether cells are repeated within units: with the correction of Huynh and Feldt, or of Geisser
                and Greenhouse if there are fewer units than twice the cells.
        """
        count = len(weights)
        spread = weights @ self.covariance @ weights.T
        expected, told = self._moments(weights, is_sum=True)
        within = 2 * float(np.trace(expected)) ** 2 / told
        between = float(np.trace(spread) ** 2 / np.sum(spread**2))
        if is_repeated:
            blocks = within / count
            if len(self.starts) >= 2 * (count + 1):
                above, below = (blocks + 1) * between - 2, count * (blocks - between)
                between = float(np.clip(above / below if below > 0 else 1.0, 1 / count, 1.0)) * count
            within = between * blocks
        f_value = float(np.sum((weights @ self.beta) ** 2) / np.trace(spread))
        return Tested(*map(np.asarray, (f_value, between, within, stats.f.sf(f_value, between, within))))

    def _moments(self, weights: Floats, *, is_sum: bool = False) -> tuple[Floats, float]:
        """Return the expected covariance of sums under the working variances, and its variance.

        The covariance of sums is a sum over units s of (w_s'e)(w_s'e)'. The covariances of w_s'e and w_t'e have low
        rank except for s = t, so that no matrix of runs by runs is needed. The second number is the sum of the
        variances of all elements; with `is_sum`, the variance of the trace.
        """
        rows = self.scaled @ self.inverse @ weights.T
        of_working = self.exog * self.working[:, None]
        middle = self.inverse @ (self.exog.T @ of_working) @ self.inverse
        none = np.zeros_like(middle)
        low = np.block([[middle, -self.inverse], [-self.inverse, none]])
        both = np.concatenate([self.exog, of_working], axis=1)
        own = np.add.reduceat(rows[:, :, None] * (rows * self.working[:, None])[:, None, :], self.starts, axis=0)
        parts = np.add.reduceat(rows[:, :, None] * both[:, None, :], self.starts, axis=0)
        shared = np.einsum("ska,ab,slb->skl", parts, low, parts, optimize=True)
        crossed = np.einsum("ab,skb,slc->kalc", low, parts, parts, optimize=True)

        def pairs(of: Floats) -> float:
            if is_sum:
                return 2 * float(np.einsum("skl,skl->", of, of))
            return float(np.sum(np.einsum("skk->s", of) ** 2) + np.einsum("skl,slk->", of, of))

        if is_sum:
            every = 2 * float(np.einsum("kakc,lcla->", crossed, crossed, optimize=True))
        else:
            every = float(
                np.einsum("kalc,lcka->", crossed, crossed, optimize=True)
                + np.einsum("kalc,kcla->", crossed, crossed, optimize=True)
            )
        return np.asarray((own + shared).sum(axis=0)), every + pairs(own + shared) - pairs(shared)


def fit_robustly(exog: Floats, values: Floats, units: Numbers | None = None, cells: Numbers | None = None) -> RobustFit:
    """Fit a model by least squares.

    Args:
        exog: the design matrix, of full rank, (runs, coefficients). With blocks, block means are subtracted if needed.
        values: of the runs, treated like `exog`.
        units: the block of each run; None if each run is a unit.
        cells: the combination of each run, for a separate working variance each; None for a common one.
    """
    order = np.arange(len(values)) if units is None else np.argsort(units, kind="stable")
    exog, values = exog[order], values[order]
    starts = order if units is None else np.flatnonzero(np.diff(units[order], prepend=-1))
    inverse: Floats = np.asarray(np.linalg.pinv(exog.T @ exog, hermitian=True), dtype=np.float64)
    beta = inverse @ (exog.T @ values)
    residuals = values - exog @ beta
    leverage = np.einsum("ia,ab,ib->i", exog, inverse, exog)
    working = np.ones(len(values))
    if cells is not None:
        _, cell = np.unique(cells[order], return_inverse=True)
        left = np.bincount(cell, 1 - leverage)
        variances = np.bincount(cell, residuals**2) / np.maximum(left, _NO_FREEDOM)
        working = np.maximum(variances, _NO_FREEDOM * max(float(variances.max()), 1e-300))[cell]
    if units is None:
        left = 1 - leverage
        scaled = exog * np.where(left > _NO_FREEDOM, 1 / np.sqrt(np.maximum(left, _NO_FREEDOM)), 0.0)[:, None]
    else:
        scaled = np.concatenate([_unbiased(each, inverse) for each in np.split(exog, starts[1:])])
    return RobustFit(beta, residuals, exog, inverse, scaled, starts, working)


def _unbiased(exog: Floats, inverse: Floats) -> Floats:
    """Return the design matrix of a unit multiplied by the inverse square root of its residual maker (CR2)."""
    values, vectors = np.linalg.eigh(np.eye(len(exog)) - exog @ inverse @ exog.T)
    roots = np.where(values > _NO_FREEDOM, 1 / np.sqrt(np.maximum(values, _NO_FREEDOM)), 0.0)
    return np.asarray((vectors * roots) @ vectors.T @ exog, dtype=np.float64)
