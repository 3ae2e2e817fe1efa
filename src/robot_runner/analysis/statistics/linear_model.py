"""Linear models of a measure: analysis of variance (type II), residuals, contrasts, and the aligned rank transform.

The transform (Wobbrock, Findlater, Gergle and Higgins, The Aligned Rank Transform for Nonparametric Factorial Analyses
Using Only ANOVA Procedures, CHI 2011) does without normal residuals: for each effect the values are aligned (stripped
of all other effects), ranked, and analysed; only that effect is read off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy import stats

from robot_runner.analysis.statistics.descriptive import quiet

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import MeasureData

__all__ = [
    "LinearFit",
    "TermTest",
    "Terms",
    "aligned",
    "aligned_ranks",
    "coded_frame",
    "fit_aligned",
    "fit_linear",
    "formula_of",
    "terms_of",
]


#: Interactions of more factors can hardly be interpreted, and use up the degrees of freedom.
_MOST_FACTORS_IN_TERM = 3

#: A mean for each of more combinations takes long to fit, and nobody can read them.
_MOST_CELLS = 500

#: Residuals smaller than this, beside the values, are what rounding leaves behind.
_NO_VARIATION = 1e-10


@dataclass(frozen=True, slots=True)
class Terms:
    """Which effects a model has.

    Attributes:
        effects: the factors of each effect, main effects first.
        note: why interactions are left out; empty where none is.
        is_full: whether each combination has a mean of its own.
    """

    effects: tuple[tuple[str, ...], ...]
    note: str
    is_full: bool


@dataclass(frozen=True, slots=True)
class TermTest:
    """The F-test of one effect."""

    f_value: float
    freedom: tuple[float, float]
    p_value: float


@dataclass(frozen=True)
class LinearFit:
    """A fitted model.

    Attributes:
        data: what it was fitted to.
        terms: the effects that it has, besides blocks.
        response: the values that were fitted, or their ranks.
        results: as statsmodels returns them.
    """

    data: MeasureData
    terms: Terms
    response: NDArray[np.float64]
    results: Any

    @property
    def residuals(self) -> NDArray[np.float64]:
        """What the model leaves unexplained."""
        return np.asarray(self.results.resid, dtype=np.float64)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return int(self.results.df_resid)

    @property
    def has_variation(self) -> bool:
        """Whether anything is left unexplained, so that effects can be compared with it."""
        scale = float(np.max(np.abs(self.response - self.response.mean()), initial=0.0))
        return self.freedom > 0 and float(np.max(np.abs(self.residuals))) > _NO_VARIATION * max(scale, 1e-300)

    @property
    def is_estimable(self) -> bool:
        """Whether the runs tell the effects from each other."""
        effects = self._exog[:, [not name.startswith("C(b)") for name in self.results.model.exog_names]]
        return bool(np.linalg.matrix_rank(effects) == effects.shape[1])

    @cached_property
    def tests(self) -> Mapping[tuple[str, ...], TermTest]:
        """The test of each effect, with sums of squares of type II."""
        return self._tests(None)

    @cached_property
    def robust_tests(self) -> Mapping[tuple[str, ...], TermTest]:
        """The same, where variances differ: with the covariance HC3 (MacKinnon and White 1985)."""
        return self._tests("hc3")

    def with_robust_covariance(self) -> LinearFit:
        """Return the fit with standard errors that hold where variances differ (HC3)."""
        return replace(self, results=self.results.get_robustcov_results("HC3"))

    def _tests(self, robust: str | None) -> Mapping[tuple[str, ...], TermTest]:
        from statsmodels.stats.anova import anova_lm  # noqa: PLC0415 - takes a second to import

        with quiet():
            table = anova_lm(self.results, typ=2, robust=robust)
        return {
            effect: TermTest(
                float(table.loc[label, "F"]),
                (float(table.loc[label, "df"]), float(self.results.df_resid)),
                float(table.loc[label, "PR(>F)"]),
            )
            for effect in self.terms.effects
            for label in [_term(effect, self.data.factors)]
        }

    def freedom_within(self, effect: Sequence[str]) -> float:
        """Return the degrees of freedom that an effect is tested with in a mixed model with a random mean per block.

        Those between blocks where differences within blocks do not tell all of the effect, else those within
        (containment, as R's nlme: Pinheiro and Bates, Mixed-Effects Models in S and S-PLUS, 2000, section 2.4.2).
        """
        if not self._is_between_blocks(effect):
            return float(self.freedom)
        between = sum(self._size(each) for each in self.terms.effects if self._is_between_blocks(each))
        return float(len(set(self.data.blocks)) - 1 - between)

    def _is_between_blocks(self, effect: Sequence[str]) -> bool:
        mine = {f"C(f{self.data.factors.index(factor)}, Sum)" for factor in effect}
        names = self.results.model.exog_names
        others = self._exog[:, [{part.partition("[")[0] for part in name.split(":")} != mine for name in names]]
        told = np.linalg.matrix_rank(self._exog) - np.linalg.matrix_rank(others)
        return bool(told < self._size(effect))

    def _size(self, effect: Sequence[str]) -> int:
        return int(np.prod([len(self.data.levels(factor)) - 1 for factor in effect]))

    def treatment_rows(self, factor: str) -> dict[str, NDArray[np.float64]]:
        """Return, for each treatment of a factor, the row of the design whose fit is its marginal mean."""
        if self.terms.is_full:
            cells = self.combination_rows()
            place = self.data.factors.index(factor)
            return {
                level: np.mean([row for treatments, row in cells.items() if treatments[place] == level], axis=0)
                for level in self.data.levels(factor)
            }
        mine = self._columns(lambda name: name.startswith(f"C(f{self.data.factors.index(factor)},"))
        exog, levels = self._exog, self.data.frame[factor].to_numpy(dtype=str)
        return {level: np.where(mine, exog[levels == level][0], 0.0) for level in self.data.levels(factor)}

    def combination_rows(self) -> dict[tuple[str, ...], NDArray[np.float64]]:
        """Return, for each combination, the row of the design whose fit is its mean, whatever the block."""
        of_blocks = self._columns(lambda name: name.startswith("C(b)"))
        exog = np.where(of_blocks, 0.0, self._exog)
        rows: dict[tuple[str, ...], NDArray[np.float64]] = {}
        treatments = self.data.frame[list(self.data.factors)].astype(str).itertuples(index=False, name=None)
        for place, combination in enumerate(treatments):
            rows.setdefault(combination, exog[place])
        return rows

    def contrast(self, difference: NDArray[np.float64]) -> Any:
        """Return statsmodels' t-test of a difference between two rows of the design."""
        with quiet():
            return self.results.t_test(difference)

    @property
    def _exog(self) -> NDArray[np.float64]:
        return np.asarray(self.results.model.exog, dtype=np.float64)

    def _columns(self, belongs: Any) -> NDArray[np.bool_]:
        return np.array([":" not in name and belongs(name) for name in self.results.model.exog_names])


def terms_of(data: MeasureData) -> Terms | None:
    """Return the effects that the runs suffice to estimate, or None where they do not even for the main effects."""
    factors = data.factors
    levels = [len(data.levels(factor)) for factor in factors]
    blocks = len(set(data.blocks)) - 1 if data.is_blocked else 0
    cells = data.frame.groupby(list(factors), observed=True).ngroups
    most = min(len(factors), _MOST_FACTORS_IN_TERM)
    everything = tuple(effect for size in range(1, most + 1) for effect in combinations(factors, size))
    possible = int(np.prod(levels))
    if cells == possible <= _MOST_CELLS and len(data.frame) - blocks > cells:
        is_full = most == len(factors)
        note = "" if is_full else f"Interactions of more than {most} factors are left out."
        return Terms(everything, note, is_full)
    if len(data.frame) - blocks <= 1 + sum(level - 1 for level in levels):
        return None
    why = "some combinations have no run" if cells < possible else "there are too few runs a combination"
    if cells > _MOST_CELLS:
        why = f"there are {cells:,} combinations"
    return Terms(tuple((factor,) for factor in factors), f"Interactions cannot be estimated: {why}.", is_full=False)


def fit_linear(data: MeasureData, terms: Terms, response: NDArray[np.float64] | None = None) -> LinearFit:
    """Fit a linear model by least squares, with a mean for each block where the design has blocks.

    Args:
        data: the measure.
        terms: the effects.
        response: takes the place of the values, as their ranks.
    """
    from statsmodels.formula.api import ols  # noqa: PLC0415 - takes a second to import

    frame = coded_frame(data, response)
    # Where each combination has runs the matrix is of full rank: a decomposition will do that takes less time.
    method = "qr" if terms.is_full and not data.is_blocked else "pinv"
    with quiet():  # a matrix without full rank: blocks that a factor is constant in
        results = ols(formula_of(data, terms.effects), frame).fit(method=method)
    return LinearFit(data, terms, frame["y"].to_numpy(), results)


def formula_of(data: MeasureData, effects: Sequence[Sequence[str]], *, with_blocks: bool = True) -> str:
    """Return a formula in which factors go by their place, as their names may hold anything."""
    parts = [_term(effect, data.factors) for effect in effects]
    return "y ~ " + " + ".join([*parts, *(["C(b)"] if data.is_blocked and with_blocks else [])])


def coded_frame(data: MeasureData, response: NDArray[np.float64] | None = None) -> pd.DataFrame:
    """Return the data under the names that formulas have for them: `y`, `f0`, `f1`, ..., `b`.

    Treatments and blocks go by their numbers, as their names may hold what formulas are made of.

    Args:
        data: the measure.
        response: takes the place of the values, as their ranks.
    """
    columns: dict[str, Any] = {"y": data.values if response is None else response}  # noqa: PD011 - no data frame
    for place, factor in enumerate(data.factors):
        levels = data.levels(factor)
        numbers = data.frame[factor].astype(str).map({level: number for number, level in enumerate(levels)})
        columns[f"f{place}"] = pd.Categorical.from_codes(
            numbers.to_numpy(), [f"l{number}" for number in range(len(levels))]
        )
    if data.is_blocked:
        columns["b"] = [f"b{number}" for number in pd.factorize(data.blocks, sort=True)[0]]
    return pd.DataFrame(columns)


def _term(effect: Sequence[str], factors: Sequence[str]) -> str:
    return ":".join(f"C(f{factors.index(factor)}, Sum)" for factor in effect)


#: Aligned values that differ by less than this, beside the largest, are ties that rounding has torn apart.
_TIE = 1e-9


def aligned(data: MeasureData, effect: Sequence[str]) -> NDArray[np.float64]:
    """Return the values aligned for one effect: the residual of the combination's mean, plus the effect's estimate.

    The estimate of an interaction is made of the means over all sets of its factors, with alternating signs.
    """
    values = pd.Series(data.values)
    columns = data.frame

    def mean_over(factors: Sequence[str]) -> NDArray[np.float64]:
        if not factors:
            return np.full(len(values), values.mean())
        keys = [columns[factor].astype(str).to_numpy() for factor in factors]
        return np.asarray(values.groupby(keys).transform("mean"), dtype=np.float64)

    estimate = np.zeros(len(values))
    for size in range(len(effect) + 1):
        sign = (-1) ** (len(effect) - size)
        for subset in combinations(effect, size):
            estimate += sign * mean_over(subset)
    return np.asarray(values - mean_over(data.factors) + estimate, dtype=np.float64)


def aligned_ranks(data: MeasureData, effect: Sequence[str]) -> NDArray[np.float64]:
    """Return the ranks of the values aligned for one effect; values that differ by rounding only are ties."""
    values = aligned(data, effect)
    step = _TIE * max(float(np.max(np.abs(values))), 1e-300)
    return np.asarray(stats.rankdata(np.round(values / step)), dtype=np.float64)


def fit_aligned(data: MeasureData, terms: Terms, effect: Sequence[str]) -> LinearFit:
    """Fit the full model to the ranks of the values aligned for one effect."""
    return fit_linear(data, terms, aligned_ranks(data, effect))
