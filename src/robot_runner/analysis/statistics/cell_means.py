"""Comparison of the means of combinations with a separate variance each; with blocks, an unrestricted covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.cell_layout import ALONE
from robot_runner.analysis.statistics.cell_moments import NOT_AVERAGED, AveragedOut, SpreadPart
from robot_runner.analysis.statistics.contrasts import (
    DRAWS,
    FREEDOM_A_CONTRAST,
    MOST_FLIPPED,
    Contrast,
    Moments,
    Tested,
    along,
    beyond_rounding,
    bootstrapped,
    box,
    can_be_bootstrapped,
    combined,
    contrast,
    is_crowded,
    sign_flipped,
    welch_james,
)
from robot_runner.analysis.statistics.tested import EffectTest, TestMethod
from robot_runner.core.design.analysis_plan import Estimand, Statistic

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.cell_layout import EffectContrast, Layout
    from robot_runner.analysis.statistics.effect_coding import Factors

#: Standard errors smaller than this, relative to the values, are rounding.
_ROUNDING = 1e-12

_PAIR = 2

#: Eight blocks have 128 patterns of signs, so the smallest p-value is 0.008; with fewer blocks, a family of tests has
#: hardly any power.
_FEWEST_FLIPPED = 8

#: The names of the tests.
WELCH_T, WELCH_ANOVA, WELCH_JAMES = "Welch's t", "Welch's ANOVA", "Welch-James"
ANOVA_TYPE, BOOTSTRAP = "ANOVA-type", ", parametric bootstrap"
BLOCK_T, GREENHOUSE_GEISSER, HUYNH_FELDT = "t within blocks", "Greenhouse-Geisser", "Huynh-Feldt"
BLOCK_MEANS = "of blocks"
SIGN_FLIPS = ", sign flips"


@dataclass(frozen=True)
class CellMeans:
    """The estimated means of all combinations, and the tests of effects.

    All arrays may have leading axes, one entry for each simulated experiment.

    Attributes:
        units: the means of cells in each block, (..., blocks, cells); None for independent runs.
        averaged_out: the part of the variance of a run that is averaged out in the means of cells in blocks.
    """

    layout: Layout
    moments: Moments
    estimand: Estimand = Estimand.MEAN
    statistic: Statistic = Statistic.COMBINED
    draws: int = DRAWS
    units: Floats | None = None
    averaged_out: AveragedOut = NOT_AVERAGED

    @classmethod
    def of_values(
        cls,
        layout: Layout,
        values: Floats,
        estimand: Estimand = Estimand.MEAN,
        statistic: Statistic = Statistic.COMBINED,
        draws: int = DRAWS,
    ) -> CellMeans:
        """Estimate the means of all combinations from the values of all runs.

        For ranks, the combined statistic is the ANOVA-type one alone (Brunner, Dette and Munk 1997): the ranks of a
        small group may hardly vary by chance, and Welch-James then has false positives, by simulation 9 % (twelve
        groups of four runs) to 18 % (sixty groups) at 5 %.
        """
        if estimand is Estimand.RANK and statistic is Statistic.COMBINED:
            statistic = Statistic.ANOVA_TYPE
        found = layout.moments(values, estimand)
        largest = np.max(np.abs(found.means), axis=(-2, -1))[..., None, None, None]
        errors = np.where(np.abs(found.errors) <= (_ROUNDING * largest) ** 2, 0.0, found.errors)
        units = layout.units(values, estimand) if layout.is_blocked else None
        beyond = layout.averaged_out(values, estimand) if layout.is_replicated else NOT_AVERAGED
        return cls(layout, found._replace(errors=errors), estimand, statistic, draws, units, beyond)

    @property
    def factors(self) -> Factors:
        """The factors, with their treatments."""
        return self.layout.factors

    @property
    def method(self) -> TestMethod:
        """The name of the tests in a paper."""
        count, several = len(self.layout.factors), self.layout.cells > _PAIR
        if self.layout.is_blocked:
            return TestMethod.BLOCKS if count > 1 or several or self.layout.between else TestMethod.PAIRED_T
        if count == 1 and not several:
            return TestMethod.WELCH_T
        if any(len(each.between) > 1 for each in self.layout.effects) and self.statistic is not Statistic.WELCH_JAMES:
            return TestMethod.COMBINED if self.statistic is Statistic.COMBINED else TestMethod.ANOVA_TYPE
        return TestMethod.WELCH_JAMES if count > 1 else TestMethod.WELCH_ANOVA

    @property
    def has_variation(self) -> NDArray[np.bool_]:
        """Whether the error variance is above 0 in at least one combination; with blocks, that of their response."""
        return np.asarray(self._unit_variance > 0)

    @property
    def spread(self) -> Floats:
        """The standard deviation of a run, which standardises all differences.

        For independent runs it is the root of the mean variance within combinations. With blocks it is that of the
        residuals from block means, or, where factors differ between blocks, that of blocks within combinations.
        """
        return np.asarray(np.sqrt(self._unit_variance + self.averaged_out.variance))

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """The components of the variance `spread` squared; none where it is known as precisely as differences are.

        This is so for two combinations of independent runs. Trimmed means and ranks have none either: their components
        are not simulated.
        """
        if not self.layout.is_blocked:
            if len(self.layout.sizes) <= _PAIR or self.estimand is not Estimand.MEAN:
                return ()
            variances = self.moments.errors[:, 0, 0] * self.layout.variance_per_error(self.estimand)
            shares = zip(variances / len(variances), self.moments.freedom, strict=True)
            return tuple(SpreadPart(float(share), float(freedom)) for share, freedom in shares)
        cells, freedom = self.moments.errors.shape[-1], float(np.sum(self.layout.sizes - 1))
        whole = float(self._unit_variance)
        if cells == 1:
            return self.averaged_out.beside(SpreadPart(whole, freedom))
        if not self.layout.between:
            return self.averaged_out.beside(SpreadPart(whole, (cells - 1) * freedom))
        # The cells of a block share the block effect.
        sizes = self.layout.variance_per_error(self.estimand)
        of_blocks = float(np.mean(np.einsum("gcd->g", self.moments.errors) * sizes)) / cells**2
        rest = SpreadPart(max(0.0, whole - of_blocks), (cells - 1) * freedom)
        return self.averaged_out.beside(SpreadPart(of_blocks, freedom), rest)

    @property
    def _unit_variance(self) -> Floats:
        """The variance of independent runs, or of the means of cells in blocks."""
        sizes = self.layout.variance_per_error(self.estimand)
        covariances = self.moments.errors * sizes[:, None, None]
        count = covariances.shape[-1]
        if count > 1 and not self.layout.between:
            whole = np.einsum("...gcc->...", covariances)
            own = beyond_rounding(whole - np.einsum("...gcd->...", covariances) / count, whole)
            return np.asarray(own / ((count - 1) * len(sizes)))
        return np.asarray(np.einsum("...gcc->...", covariances) / (len(sizes) * count))

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each effect."""
        return map(self._test, self.layout.effects)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means, with equal weights for all combinations."""
        return self._contrast(np.sum([each * self.layout.weights(dict(of)) for of, each in weights], axis=0))

    def _contrast(self, weights: Floats) -> Contrast:
        is_few = self.layout.has_gaps and int(self.layout.sizes.min()) == _PAIR
        return contrast(self.moments, weights, is_corrected=is_few)

    def _test(self, effect: EffectContrast) -> EffectTest:
        differences = np.einsum("ag,...gc,bc->...ab", effect.between, self.moments.means, effect.within)
        variance = np.sum(differences**2, axis=(-2, -1)) / self.layout.cells
        if len(effect.between) == len(effect.within) == 1:
            found = self._contrast(np.outer(effect.between[0], effect.within[0]))
            name = BLOCK_T if self.layout.is_blocked else WELCH_T
            return EffectTest(effect.factors, name, "t", found.t_value, (found.freedom,), found.p_value, variance)
        name, tests, p_value = self._several(effect)
        parts = tuple((each, of.f_value, (of.between, of.within), of.p_value) for each, of in tests.items())
        statistic, freedom = parts[0][1:3]
        told = parts if len(parts) > 1 else ()
        return EffectTest(effect.factors, name, "F", statistic, freedom, p_value, variance, told)

    def _several(self, effect: EffectContrast) -> tuple[str, dict[str, Tested], Floats]:
        """Return the name of the joint test of several contrasts, its parts by name, and the p-value."""
        if len(effect.within) > 1:
            name, within_units = self._within_units(effect)
            return name, {name: within_units}, within_units.p_value
        moments, of_units = along(self.moments, effect.within[0]), f" {BLOCK_MEANS}" if self.layout.is_blocked else ""
        is_approximate = not is_crowded(moments.freedom, effect.between)
        tests = self._tests(moments, effect.between)
        if WELCH_JAMES in tests and not is_approximate and not can_be_bootstrapped(effect.between):
            tests = {ANOVA_TYPE: box(moments, effect.between, ALONE)}
        if is_approximate or WELCH_JAMES not in tests:
            is_plain = len(self.layout.factors) == 1 and list(tests) == [WELCH_JAMES]
            return (WELCH_ANOVA if is_plain else " and ".join(tests)) + of_units, tests, _joint_p_value(tests)
        p_value = bootstrapped(lambda drawn: _joint_p_value(self._tests(drawn, effect.between)), moments, self.draws)
        return " and ".join(tests) + BOOTSTRAP + of_units, tests, p_value

    def _tests(self, moments: Moments, between: Floats) -> dict[str, Tested]:
        """Return the tests of several contrasts of groups; they depend on the values only if two groups do not vary."""
        weighed = None if self.statistic is Statistic.ANOVA_TYPE else welch_james(moments, between)
        if weighed is None:
            return {ANOVA_TYPE: box(moments, between, ALONE)}
        if self.statistic is Statistic.WELCH_JAMES:
            return {WELCH_JAMES: weighed}
        return {WELCH_JAMES: weighed, ANOVA_TYPE: box(moments, between, ALONE, is_corrected=True)}

    def _within_units(self, effect: EffectContrast) -> tuple[str, Tested]:
        """Test contrasts of several cells within units, whose covariance is unknown."""
        least = FREEDOM_A_CONTRAST * len(self.layout.sizes) * len(effect.within)
        freedom = float(self.moments.freedom.min())
        flipped = self.units if self._can_be_flipped and freedom < least else None
        is_corrected = freedom >= least - 1 and flipped is None
        found = box(self.moments, effect.between, effect.within, is_corrected=is_corrected)
        if flipped is not None:
            return GREENHOUSE_GEISSER + SIGN_FLIPS, found._replace(p_value=sign_flipped(flipped @ effect.within.T))
        return HUYNH_FELDT if is_corrected else GREENHOUSE_GEISSER, found

    @property
    def _can_be_flipped(self) -> bool:
        """Whether there is one group of blocks, with enough sign patterns for the 5 % level and not too many."""
        return len(self.layout.sizes) == 1 and _FEWEST_FLIPPED <= int(self.layout.sizes[0]) <= MOST_FLIPPED


def _joint_p_value(tests: Mapping[str, Tested]) -> Floats:
    several = [each.p_value for each in tests.values()]
    return several[0] if len(several) == 1 else combined(several)
