"""Effects of an unreplicated fraction, by Lenth's pseudo standard error.

Without replicates, the error is estimated from the effects themselves, most of which are assumed to be 0. P-values come
from the simulated distribution of the statistic without effects: Student's t with a third of the effects as degrees of
freedom, which Lenth proposed, has 2 % false positives at 5 %.

Sources: Lenth, Quick and easy analysis of unreplicated factorials (Technometrics 31, 1989); Ye and Hamada, Critical
values of the Lenth method for unreplicated factorial designs (Journal of Quality Technology 32, 2000).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.cell_moments import SpreadPart
from robot_runner.analysis.statistics.contrasts import Contrast, rounding_of
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.tested import EffectTest, NotComputed, TestMethod

#: The name of the test.
LENTH = "Lenth's t"

#: The standard deviation in medians of absolute normal values, and the number of preliminary standard errors beyond
#: which an effect is set aside (Lenth 1989).
_MEDIAN, _ACTIVE = 1.5, 2.5
#: The number of simulated experiments without effects: a p-value of 0.05 is then known to 0.0007.
_DRAWS = 100_000
_SEED = 20210525
#: The fewest effects: with fewer, the error is hardly known; four combinations have three.
_LEAST = 7
_TWO = 2
#: Statistics whose relative difference is less are equal: that of the median effect is 2/3 in every experiment.
_SAME = 1e-9
#: Effects whose correlation is below this are orthogonal.
_ROUNDING = 1e-9


def pseudo_error(effects: Floats) -> Floats:
    """Return the pseudo standard error of effects, (..., effects).

    Example:
        >>> round(float(pseudo_error(np.array([0.1, -0.3, 0.2, 8.0, -0.4, 0.5, 0.25]))), 3)
        0.413
    """
    sizes = np.abs(effects)
    first = _MEDIAN * np.median(sizes, axis=-1, keepdims=True)
    left = np.where(sizes < _ACTIVE * first, sizes, np.nan)
    return np.asarray(_MEDIAN * np.nanmedian(left, axis=-1))


@lru_cache(maxsize=16)
def _null_statistics(count: int) -> Floats:
    """Return simulated absolute values of Lenth's t for one of `count` effects that are all 0, in ascending order."""
    random = np.random.default_rng((_SEED, count))
    found = []
    for _ in range(math.ceil(_DRAWS * count / 2_000_000)):  # so many numbers at once
        effects = random.normal(size=(min(_DRAWS, 2_000_000 // count), count))
        found.append(np.abs(effects[:, 0]) / pseudo_error(effects))
    return np.sort(np.concatenate(found))


class LenthContrast(Contrast):
    """A difference of means with its pseudo standard error, and a third of the number of effects in `freedom`."""

    @property
    def p_value(self) -> Floats:
        """The two-sided p-value, by simulation."""
        none = _null_statistics(round(3 * float(np.max(self.freedom))))
        beyond = len(none) - np.searchsorted(none, np.abs(self.t_value) * (1 - _SAME))
        return np.asarray((1 + beyond) / (1 + len(none)))

    def reach(self, alpha: float) -> float:
        """Return the half-width of the confidence interval of level 1 - alpha."""
        none = _null_statistics(round(3 * float(self.freedom)))
        return float(self.error) * float(np.quantile(none, 1 - alpha))


@dataclass(frozen=True, eq=False)
class LenthModel:
    """The effects of an unreplicated two-level fraction.

    Attributes:
        terms: the tested effects, main effects first.
        columns: the orthogonal columns of all effects, of 1 and -1; those of `terms` come first.
        values: (..., runs).
    """

    factors: Factors
    terms: tuple[Term, ...]
    columns: Floats
    values: Floats
    reason: str
    notes: tuple[str, ...] = ()

    @property
    def method(self) -> TestMethod:
        """The name of the tests in a paper."""
        return TestMethod.LENTH

    @property
    def spread(self) -> Floats:
        """NaN: without replicates the standard deviation of runs is unknown."""
        return np.full(self.values.shape[:-1], math.nan)

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """Empty, as the spread is unknown."""
        return ()

    @property
    def _halves(self) -> Floats:
        """Half of each effect, (..., effects): the distance of a treatment's mean from the overall mean."""
        return np.asarray(self.values @ self.columns / len(self.columns))

    @property
    def error(self) -> Floats:
        """The pseudo standard error of each effect."""
        return pseudo_error(2 * self._halves)

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each effect."""
        for place, term in enumerate(self.terms):
            found = self._contrast(2 * self._halves[..., place])
            variance = self._halves[..., place] ** 2
            yield EffectTest(term, LENTH, "t", found.t_value, (found.freedom,), found.p_value, variance)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means; its standard error is NaN unless it is a pair of treatments."""
        row = np.sum([weight * self.factors.row(self.terms, treatments)[1:] for treatments, weight in weights], axis=0)
        found = self._contrast(self._halves[..., : len(row)] @ row)
        is_one = np.count_nonzero(row) == 1
        return found._replace(error=found.error * float(np.abs(row).max()) / 2 if is_one else found.error * math.nan)

    def _contrast(self, estimate: Floats) -> LenthContrast:
        freedom = np.full(estimate.shape, self.columns.shape[1] / 3)
        return LenthContrast(np.asarray(estimate), self.error, freedom)


def fit_lenth(
    factors: Factors, codes: Mapping[str, Numbers], terms: Sequence[Term], values: Floats
) -> LenthModel | NotComputed | None:
    """Return the effects of an unreplicated two-level fraction; None for any other design."""
    count = values.shape[-1]
    if (
        factors.conditions
        or any(len(levels) != _TWO for levels in factors.values())
        or count - 1 < max(_LEAST, len(terms))
    ):
        return None
    signs = {name: 1.0 - 2.0 * codes[name] for name in factors}
    every = (each for size in range(1, len(factors) + 1) for each in combinations(factors, size))
    columns: list[Floats] = []
    for term in (*terms, *every):
        column = np.prod([signs[name] for name in term], axis=0)
        told = [abs(float(column @ each)) / count for each in (*columns, np.ones(count))]
        if max(told) < _ROUNDING:
            columns.append(column)
        elif len(columns) < len(terms):
            return None  # the runs with a value are not orthogonal
        if len(columns) == count - 1:
            break
    if len(columns) < count - 1:
        return None
    reason = (
        f"Each combination was executed once: {count - 1} effects are compared with the pseudo standard error of those "
        "that look like chance, and p-values are simulated."
    )
    notes = ("Lenth's method takes most effects to be none. Confirm what it finds in runs that are repeated.",)
    found = LenthModel(factors, tuple(terms), np.stack(columns, axis=1), values, reason, notes)
    with quiet():  # NaN if most effects are exactly 0
        if not np.any(found.error > rounding_of(values)):
            return NotComputed(
                "the test", "most effects are none at all, so that there is no variation to test against."
            )
    return found
