"""The means of combinations compared, each with a variance of its own; of blocks, with a covariance of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.statistics.contrasts import (
    DRAWS,
    Contrast,
    Moments,
    bootstrapped,
    box,
    can_be_bootstrapped,
    contrast,
    is_crowded,
    welch_james,
)
from robot_runner.analysis.statistics.tested import EffectTest, TestMethod
from robot_runner.core.design.analysis_plan import Estimand, Statistic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.cell_layout import EffectContrast, Layout

    Floats = NDArray[np.float64]

__all__ = ["CellMeans"]

#: Errors smaller than this, beside the values, are what rounding leaves behind.
_ROUNDING = 1e-12

#: The same of standard deviations, which are differences of such.
_NO_VARIATION = 1e-10

_PAIR = 2

#: What each kind of test is called.
WELCH_T, WELCH_ANOVA, WELCH_JAMES = "Welch's t", "Welch's ANOVA", "Welch-James"
ANOVA_TYPE, BOOTSTRAP = "ANOVA-type", "Welch-James, parametric bootstrap"
BLOCK_T, GREENHOUSE_GEISSER, HUYNH_FELDT = "t within blocks", "Greenhouse-Geisser", "Huynh-Feldt"
BLOCK_MEANS = "of blocks"


@dataclass(frozen=True)
class CellMeans:
    """The estimates of all combinations, and the tests of effects among them.

    Everything may have leading axes, one experiment each.

    Attributes:
        layout: of the experiment.
        moments: of the combinations.
        estimand: what is estimated of each.
        statistic: which tests several contrasts at once.
        draws: of the bootstrap.
    """

    layout: Layout
    moments: Moments
    estimand: Estimand = Estimand.MEAN
    statistic: Statistic = Statistic.WELCH_JAMES
    draws: int = DRAWS

    @classmethod
    def of_values(
        cls,
        layout: Layout,
        values: Floats,
        estimand: Estimand = Estimand.MEAN,
        statistic: Statistic = Statistic.WELCH_JAMES,
        draws: int = DRAWS,
    ) -> CellMeans:
        """Estimate the means of all combinations from the values of all runs."""
        found = layout.moments(values, estimand)
        largest = np.max(np.abs(found.means), axis=(-2, -1))[..., None, None, None]
        errors = np.where(np.abs(found.errors) <= (_ROUNDING * largest) ** 2, 0.0, found.errors)
        return cls(layout, found._replace(errors=errors), estimand, statistic, draws)

    @property
    def method(self) -> TestMethod:
        """What a paper calls the tests."""
        count, several = len(self.layout.factors), self.layout.cells > _PAIR
        if self.layout.is_blocked:
            return TestMethod.BLOCKS if count > 1 or several or self.layout.between else TestMethod.PAIRED_T
        if count > 1:
            return TestMethod.WELCH_JAMES
        if not several:
            return TestMethod.WELCH_T
        return TestMethod.WELCH_ANOVA if self.statistic is Statistic.WELCH_JAMES else TestMethod.ANOVA_TYPE

    @property
    def has_variation(self) -> bool:
        """Whether chance has a measure, in some combination at least; of blocks, in how they respond to treatments."""
        return bool(np.all(self.spread > _NO_VARIATION * np.max(np.abs(self.moments.means), axis=(-2, -1))))

    @property
    def spread(self) -> Floats:
        """The standard deviation that differences are divided by, the same for all of them.

        Of independent runs the root of the mean variance within combinations; of blocks that of what is left once their
        means are taken away; and where factors differ between blocks, that of blocks within combinations.
        """
        sizes = self.layout.variance_per_error(self.estimand)
        covariances = self.moments.errors * sizes[:, None, None]
        count = covariances.shape[-1]
        if count > 1 and not self.layout.between:
            own = np.einsum("...gcc->...", covariances) - np.einsum("...gcd->...", covariances) / count
            return np.asarray(np.sqrt(np.maximum(own, 0.0) / ((count - 1) * len(sizes))))
        return np.asarray(np.sqrt(np.einsum("...gcc->...", covariances) / (len(sizes) * count)))

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each effect."""
        for effect in self.layout.effects:
            yield self._test(effect)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means, in which each combination counts the same.

        Args:
            weights: treatments by factor, with the weight of their mean.
        """
        return contrast(self.moments, np.sum([each * self.layout.weights(dict(of)) for of, each in weights], axis=0))

    def _test(self, effect: EffectContrast) -> EffectTest:
        differences = np.einsum("ag,...gc,bc->...ab", effect.between, self.moments.means, effect.within)
        variance = np.sum(differences**2, axis=(-2, -1)) / self.layout.cells
        if len(effect.between) == len(effect.within) == 1:
            found = contrast(self.moments, np.outer(effect.between[0], effect.within[0]))
            name = BLOCK_T if self.layout.is_blocked else WELCH_T
            return EffectTest(effect.factors, name, "t", found.t_value, (found.freedom,), found.p_value, variance)
        name, f_value, between, within, p_value = self._several(effect)
        return EffectTest(effect.factors, name, "F", f_value, (between, within), p_value, variance)

    def _several(self, effect: EffectContrast) -> tuple[str, Floats, Floats, Floats, Floats]:
        if len(effect.within) > 1:
            return self._within_units(effect)
        of_units = f" {BLOCK_MEANS}" if self.layout.is_blocked else ""
        found = None
        crowded = is_crowded(self.moments.freedom, effect.between)
        if self.statistic is Statistic.WELCH_JAMES and (not crowded or can_be_bootstrapped(effect.between)):
            found = welch_james(self.moments, effect.between, effect.within[0])
        if found is None:
            return ANOVA_TYPE + of_units, *box(self.moments, effect.between, effect.within)
        if crowded:
            p_value = bootstrapped(self.moments, effect.between, effect.within[0], self.draws)
            return BOOTSTRAP + of_units, *found._replace(p_value=p_value)
        is_plain = len(self.layout.factors) == 1
        return (WELCH_ANOVA if is_plain else WELCH_JAMES) + of_units, *found

    def _within_units(self, effect: EffectContrast) -> tuple[str, Floats, Floats, Floats, Floats]:
        """Test contrasts of several cells within units, whose covariance is not known."""
        count = self.moments.means.shape[-1]
        is_corrected = len(self.layout.sizes) == 1 and int(self.layout.sizes[0]) >= _PAIR * count
        name = HUYNH_FELDT if is_corrected else GREENHOUSE_GEISSER
        return name, *box(self.moments, effect.between, effect.within, is_corrected=is_corrected)
