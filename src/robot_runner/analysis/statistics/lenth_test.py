"""Effects of a fraction whose combinations were executed once each: Lenth's pseudo standard error.

Where nothing was repeated, chance is measured by the effects themselves, of which most are taken to be none. P-values
come from the distribution that the statistic has where no effect is there, by simulation: that of Student's t with a
third of the effects as degrees of freedom, which Lenth proposed, finds 2 % at 5 %.

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

#: What the test is called.
LENTH = "Lenth's t"

#: A standard deviation in medians of absolute normal values, and beyond how many such medians an effect is set aside
#: (Lenth 1989).
_MEDIAN, _ACTIVE = 1.5, 2.5
#: Experiments without effects that are simulated: a p-value of 0.05 is known to 0.0007.
_DRAWS = 100_000
_SEED = 20210525
#: With fewer effects the error is hardly known: four combinations have three.
_LEAST = 7
_TWO = 2
#: Sizes that are the same but for rounding: that of the median effect is 2/3 in each experiment.
_SAME = 1e-9
#: Effects that explain one another less than this are orthogonal.
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
def _none_there(count: int) -> Floats:
    """Return the sizes of Lenth's t of one of so many effects where none is there, in ascending order."""
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
        """Of both sides, by simulation."""
        none = _none_there(round(3 * float(np.max(self.freedom))))
        beyond = len(none) - np.searchsorted(none, np.abs(self.t_value) * (1 - _SAME))
        return np.asarray((1 + beyond) / (1 + len(none)))

    def reach(self, alpha: float) -> float:
        """Return how far an interval of 1 - alpha reaches to either side of the difference."""
        none = _none_there(round(3 * float(self.freedom)))
        return float(self.error) * float(np.quantile(none, 1 - alpha))


@dataclass(frozen=True, eq=False)
class LenthModel:
    """The effects of single runs of a fraction of two treatments each.

    Attributes:
        factors: the factors, with their treatments.
        terms: the effects that are tested, main effects first.
        columns: of all effects, orthogonal, of 1 and -1; those of `terms` are the first.
        values: (..., runs).
        reason: why this test, in a sentence.
        notes: what a reader has to know besides.
    """

    factors: Factors
    terms: tuple[Term, ...]
    columns: Floats
    values: Floats
    reason: str
    notes: tuple[str, ...] = ()

    @property
    def method(self) -> TestMethod:
        """What a paper calls the tests."""
        return TestMethod.LENTH

    @property
    def spread(self) -> Floats:
        """Nothing: no run was repeated, so that no standard deviation of runs is known."""
        return np.full(self.values.shape[:-1], math.nan)

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """Nothing, as there is no spread."""
        return ()

    @property
    def _halves(self) -> Floats:
        """Half of each effect, (..., effects): how far a treatment's mean is from that of all."""
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
        """Estimate a weighted sum of marginal means; of a pair of treatments it has an error."""
        rows = [weight * self.factors.row(self.terms, treatments)[1:] for treatments, weight in weights]
        row = np.sum(rows, axis=0)
        found = self._contrast(self._halves[..., : len(row)] @ row)
        is_one = np.count_nonzero(row) == 1
        return found._replace(error=found.error * float(np.abs(row).max()) / 2 if is_one else found.error * math.nan)

    def _contrast(self, estimate: Floats) -> LenthContrast:
        freedom = np.full(estimate.shape, self.columns.shape[1] / 3)
        return LenthContrast(np.asarray(estimate), self.error, freedom)


def fit_lenth(
    factors: Factors, codes: Mapping[str, Numbers], terms: Sequence[Term], values: Floats
) -> LenthModel | NotComputed | None:
    """Return the effects of a fraction whose combinations have one value each; None where that is not what it is."""
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
            return None  # the runs that have a value are not orthogonal
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
    with quiet():  # NaN where most effects are exactly 0
        if not np.any(found.error > rounding_of(values)):
            return NotComputed("the test", "most effects are none at all, so that chance has no measure.")
    return found
