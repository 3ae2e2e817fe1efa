"""Means adjusted for covariates: the analysis of covariance, with standard errors that allow unequal variances.

Each combination has a mean, and each covariate one slope. Independent runs have a variance for each combination. With
blocks, differences within blocks are compared, and the error is their variation between blocks. Without covariates the
tests of single differences are Welch's t test, and the paired t test with blocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData
from robot_runner.analysis.statistics.cell_moments import SpreadPart
from robot_runner.analysis.statistics.contrasts import Contrast, Tested, rounding_of
from robot_runner.analysis.statistics.covariate_design import AdjustmentError, Covariate, CovariateDesign
from robot_runner.analysis.statistics.effect_coding import Factors
from robot_runner.analysis.statistics.tested import EffectTest, NotComputed, NoVariation, TestMethod
from robot_runner.core.design.analysis_plan import Estimand, Statistic

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.robust_covariance import RobustFit

#: The names of the tests.
HOTELLING, BOX = "approximate Hotelling", "ANOVA-type"
WITHIN, T = "Huynh-Feldt", "t of adjusted means"


@dataclass(frozen=True, eq=False, slots=True)
class AdjustedMeans:
    """The adjusted means of all combinations, at the mean of the covariates, and the tests of effects.

    Attributes:
        design: its columns. If all factors differ within blocks, block means are subtracted from them.
        fit: the model: the mean of all combinations (without blocks only), effects, covariates, batches.
        covariates: those whose slope can be estimated, in the model's order.
        centre: the mean of all runs, at the mean of their covariates.
        spread: the standard deviation that standardises differences: that of unadjusted values.
        residual_spread: the standard deviation of the model's residuals.
        spread_parts: the components of the variance `spread` squared within blocks; none for independent runs, where
            it is known as precisely as differences are.
        slopes_p_value: of the test that slopes are the same for all treatments; None where it cannot be computed.
        adjusted: the value of each run, adjusted to the mean of the covariates.
    """

    design: CovariateDesign
    fit: RobustFit
    covariates: tuple[Covariate, ...]
    centre: float
    spread: float
    residual_spread: float
    spread_parts: tuple[SpreadPart, ...]
    slopes_p_value: float | None
    adjusted: Floats
    statistic: Statistic

    @property
    def factors(self) -> Factors:
        """The factors, with their treatments."""
        return self.design.factors

    @property
    def method(self) -> TestMethod:
        """The name of the tests in a paper."""
        return TestMethod.COVARIANCE

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each effect."""
        cells = math.prod(map(len, self.factors.values()))
        start = 0 if self.design.is_within else 1
        for factors in self.design.terms:
            count = self.factors.size(factors)
            place = np.arange(start, start + count)
            start += count
            squares, beta = self.factors.squares(factors), self.fit.beta[place]
            variance = float(beta @ squares @ beta)
            weights = np.zeros((count, len(self.fit.beta)))
            weights[:, place] = np.linalg.cholesky(cells * squares).T  # orthonormal contrasts of cells
            if count == 1:
                found = self.fit.contrast(weights[0])
                yield EffectTest(factors, T, "t", found.t_value, (found.freedom,), found.p_value, variance)
                continue
            name, (f_value, *freedom, p_value) = self._several(weights)
            yield EffectTest(factors, name, "F", f_value, tuple(freedom), p_value, variance)

    def _several(self, weights: Floats) -> tuple[str, Tested]:
        if self.design.is_within:
            return WITHIN, self.fit.box(weights, is_repeated=True)
        found = self.fit.hotelling(weights) if self.statistic is not Statistic.ANOVA_TYPE else None
        return (BOX, self.fit.box(weights)) if found is None else (HOTELLING, found)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means, with equal weights for all combinations.

        Where block means are subtracted, the standard error is valid only if the weights sum up to 0.
        """
        skipped = 1 if self.design.is_within else 0  # the mean of all combinations
        row = np.sum([weight * self.factors.row(self.design.terms, of)[skipped:] for of, weight in weights], axis=0)
        found = self.fit.contrast(np.pad(row, (0, len(self.fit.beta) - len(row))))
        total = sum(weight for _, weight in weights) if self.design.is_within else 0.0
        return found._replace(estimate=found.estimate + total * self.centre)

    def slope(self, covariate: Covariate) -> Contrast:
        """Return the slope of a covariate: the change of the measure per unit."""
        weights = np.zeros(len(self.fit.beta))
        weights[self.design.base.shape[1] + self.covariates.index(covariate)] = 1 / covariate.scale
        return self.fit.contrast(weights)

    def adjusted_data(self, data: MeasureData) -> MeasureData:
        """Return the data of a measure with its values replaced by the adjusted ones."""
        frame = data.frame.assign(**{VALUE: self.adjusted})
        return replace(data, frame=frame, every=frame, covariates=())


def fit_adjusted(data: MeasureData, estimand: Estimand, statistic: Statistic) -> AdjustedMeans | NotComputed:
    """Fit the analysis of covariance of a measure, or return why this is not possible.

    With ranks, covariates are ranked as well (Conover and Iman, Analysis of covariance using the rank transformation,
    1982).
    """
    try:
        return _fitted(CovariateDesign.of_data(data, estimand), statistic)
    except AdjustmentError as problem:
        return NotComputed("the test", str(problem))


def _fitted(design: CovariateDesign, statistic: Statistic) -> AdjustedMeans | NoVariation:
    covariates, values = design.covariates, design.values
    fit = design.fit(design.columns)
    unadjusted = design.fit(design.columns[:, :0])
    spread, left = design.spread(unadjusted), design.spread(fit)
    if not (math.isfinite(spread) and math.isfinite(left)):
        raise AdjustmentError("there are too few runs for the number of treatments and covariates.")
    if left <= rounding_of(values):
        why = "treatments and covariates explain all values, so that there is no variation to test against."
        return NoVariation("the test", why)
    adjusted = values - design.columns @ fit.beta[design.base.shape[1] :]
    first, count = (0 if design.is_within else 1), design.effects.shape[1] - 1
    return AdjustedMeans(
        design,
        fit,
        covariates,
        float(np.mean(adjusted - design.effects[:, 1:] @ fit.beta[first : first + count])),
        spread,
        left,
        design.spread_parts(unadjusted) if design.is_within else (),
        _equal_slopes(design),
        adjusted,
        statistic,
    )


def _equal_slopes(design: CovariateDesign) -> float | None:
    """Return the p-value of the test that no covariate's slope differs between the treatments of any factor."""
    crossed = design.crossed()
    if crossed is None:
        return None
    fit = design.fit(np.column_stack([design.columns, crossed]))
    if not math.isfinite(design.spread(fit)):
        return None
    weights = np.eye(len(fit.beta))[-crossed.shape[1] :]
    found = fit.contrast(weights[0]) if len(weights) == 1 else fit.hotelling(weights)
    p_value = math.nan if found is None else float(found.p_value)
    return p_value if math.isfinite(p_value) else None
