"""Linear models for combinations with too few runs, and for incomplete blocks.

Independent runs have a common variance (least squares). Blocks have random means (linear mixed model, REML), and the
response is the mean of a combination within a block, so that repeated runs of a block do not count as independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from scipy import optimize, stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, MeasureData
from robot_runner.analysis.statistics.cell_layout import MOST_CELLS, MOST_FACTORS
from robot_runner.analysis.statistics.cell_moments import NOT_AVERAGED, AveragedOut, SpreadPart, averaged_out
from robot_runner.analysis.statistics.contrasts import Contrast, rounding_of
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.analysis.statistics.tested import EffectTest, NotComputed, NoVariation, TestMethod
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from numpy.typing import NDArray


#: The fewest factors that can be confounded with each other.
_PAIR = 2
_BLOCK = " block"
#: Singular values below this share of the largest are rounding.
_ROUNDING = 1e-9
#: The prefix of nuisance columns; names of factors never begin with a space.
_TAKEN = " taken out "

#: The search grid for the ratio of the variance of blocks to that within them, as logarithms.
_RATIOS = np.log(10.0) * np.arange(-10.0, 10.5, 0.5)
#: The tolerance of the logarithm: estimates then agree with R's nlme to six digits.
_PRECISION = 1e-9


class _Fit(NamedTuple):
    """Generalised least squares for a given ratio of the variance of blocks to that within them.

    Attributes:
        deviance: -2 times the restricted log-likelihood, up to a constant.
        scale: the variance within blocks.
    """

    deviance: float
    ratio: float
    beta: Floats
    covariance: Floats
    scale: float


@dataclass(frozen=True)
class FittedModel:
    """A fitted model with effects of type III: combinations have equal weights.

    Attributes:
        blocks: the block of each value; None without blocks.
        exog: the design matrix, one row for each value.
        beside: how many of the last columns of the design matrix are nuisance columns, such as those of batches.
        note: why interactions are left out; empty where they are not.
        averaged_out: the part of the variance of a run that the means of combinations in blocks average out.
    """

    factors: Factors
    terms: tuple[Term, ...]
    blocks: NDArray[np.str_] | None
    exog: Floats
    fit: _Fit
    note: str
    beside: int = 0
    averaged_out: AveragedOut = NOT_AVERAGED

    @property
    def method(self) -> TestMethod:
        """The kind of model."""
        return TestMethod.LINEAR_MODEL if self.blocks is None else TestMethod.MIXED_MODEL

    @property
    def spread(self) -> float:
        """The residual standard deviation of a run.

        If factors differ between blocks, it includes the variance of blocks, by which those of one treatment differ.
        """
        ratio = self.fit.ratio if self._has_between else 0.0
        return math.sqrt(self.fit.scale * (1 + ratio) + float(self.averaged_out.variance))

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """The components of the variance `spread` squared; none without degrees of freedom."""
        every = self.exog if self.blocks is None else self._with_blocks
        within = SpreadPart(self.fit.scale, float(len(self.exog) - np.linalg.matrix_rank(every)))
        if not self._has_between:
            return self.averaged_out.beside(within)
        if min(within.freedom, self._freedom_between) < 1:
            return ()
        share = float(np.mean(1 / np.unique(np.asarray(self.blocks), return_counts=True)[1]))
        of_means = SpreadPart(self.fit.scale * (self.fit.ratio + share), self._freedom_between)
        return self.averaged_out.beside(of_means, within._replace(variance=within.variance * (1 - share)))

    @cached_property
    def _has_between(self) -> bool:
        return self.blocks is not None and any(map(self._is_between_blocks, self.terms))

    def effects(self) -> Iterator[EffectTest]:
        """Yield the Wald test of each effect as an F test, with degrees of freedom by containment."""
        for factors in self.terms:
            place = self._place(factors)
            beta, covariance = self.fit.beta[place], self.fit.covariance[place, place]
            wald = float(beta @ np.linalg.solve(covariance, beta))
            freedom = (float(len(beta)), self._freedom(factors))
            f_value = wald / freedom[0]
            p_value = float(stats.f.sf(f_value, *freedom)) if freedom[1] > 0 else math.nan
            variance = float(beta @ self.factors.squares(factors) @ beta)
            yield EffectTest(factors, self.method.value, "F", f_value, freedom, p_value, variance)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means."""
        rows = [weight * self.factors.row(self.terms, treatments) for treatments, weight in weights]
        row = np.pad(np.sum(rows, axis=0), (0, self.beside))
        error = math.sqrt(max(0.0, float(row @ self.fit.covariance @ row)))
        named = {name for treatments, _ in weights for name in treatments}
        freedom = min(self._freedom(factors) for factors in self.terms if set(factors) <= named)
        return Contrast(*map(np.asarray, (row @ self.fit.beta, error, freedom)))

    def _place(self, factors: Sequence[str]) -> slice:
        """Return the columns of an effect in the design matrix, whose first column is the mean of all combinations."""
        before = self.terms[: self.terms.index(tuple(factors))]
        start = 1 + sum(map(self.factors.size, before))
        return slice(start, start + self.factors.size(factors))

    def _freedom(self, factors: Sequence[str]) -> float:
        """Return the error degrees of freedom of an effect.

        They are those between blocks if the effect cannot be estimated fully within blocks, else those within
        (containment, as in R's nlme: Pinheiro and Bates, Mixed-Effects Models in S and S-PLUS, 2000, section 2.4.2).
        """
        if self.blocks is None:
            return float(len(self.exog) - self.exog.shape[1])
        if not self._is_between_blocks(factors):
            return float(len(self.exog) - np.linalg.matrix_rank(self._with_blocks))
        return self._freedom_between

    @cached_property
    def _freedom_between(self) -> float:
        assert self.blocks is not None  # noqa: S101 - degrees of freedom between blocks were asked for
        between = sum(self.factors.size(each) for each in self.terms if self._is_between_blocks(each))
        return float(len(set(self.blocks)) - self._taken_between - between)

    @cached_property
    def _taken_between(self) -> int:
        """The degrees of freedom between blocks that the mean and the nuisance columns take."""
        assert self.blocks is not None  # noqa: S101 - degrees of freedom between blocks were asked for
        taken = np.column_stack([self.exog[:, :1], self.exog[:, self.exog.shape[1] - self.beside :]])
        every = np.column_stack([taken, pd.get_dummies(self.blocks).to_numpy(dtype=np.float64)])
        within = np.linalg.matrix_rank(every) - len(set(self.blocks))
        return int(np.linalg.matrix_rank(taken) - within)

    @cached_property
    def _with_blocks(self) -> Floats:
        return np.column_stack([self.exog, pd.get_dummies(self.blocks).to_numpy(dtype=np.float64)])

    def _is_between_blocks(self, factors: Sequence[str]) -> bool:
        place = self._place(factors)
        others = np.delete(self._with_blocks, np.arange(place.start, place.stop), axis=1)
        told = np.linalg.matrix_rank(self._with_blocks) - np.linalg.matrix_rank(others)
        return bool(told < self.factors.size(factors))


def fit_model(
    data: MeasureData, response: Floats | None = None, beside: Floats | None = None
) -> FittedModel | NotComputed:
    """Fit the largest model for which there are enough runs.

    The response replaces the values, for example by their ranks; `beside` are further nuisance columns, (runs,
    columns).
    """
    response = response if response is not None else data.values  # noqa: PD011 - no data frame
    taken = np.empty((len(response), 0)) if beside is None else beside
    frame, unit = _means_in_blocks(data, {VALUE: response} | {f"{_TAKEN}{at}": each for at, each in enumerate(taken.T)})
    factors = data.treatments
    blocks = frame[_BLOCK].to_numpy(dtype=str) if data.is_blocked else None
    taken = frame[[name for name in frame if str(name).startswith(_TAKEN)]].to_numpy(dtype=np.float64)
    if data.is_extended:
        taken = np.column_stack([taken, pd.get_dummies(frame[BATCH], drop_first=True).to_numpy(dtype=np.float64)])
    taken = _independent(taken)
    count = taken.shape[1]
    terms, note = estimable_terms(factors, frame, count + (0 if blocks is None else len(set(blocks)) - 1))
    if not terms:
        return NotComputed("the test", "there are too few runs for the number of treatments.")
    exog = np.column_stack([np.ones(len(frame)), *factors.columns(codes_of(frame, factors), terms).values(), taken])
    values = frame[VALUE].to_numpy(dtype=np.float64)
    if np.linalg.matrix_rank(exog) < exog.shape[1]:
        return NotComputed("the test", _confounded_in_words(frame, factors))
    every = exog if blocks is None else np.column_stack([exog, pd.get_dummies(blocks).to_numpy(dtype=np.float64)])
    left = values - every @ np.linalg.lstsq(every, values)[0]
    if np.max(np.abs(left)) <= rounding_of(values) and np.linalg.matrix_rank(every) < len(values):
        of = "within each combination all values are equal" if blocks is None else "all blocks respond alike"
        return NoVariation("the test", f"{of}, so that there is no variation to test against.")
    beyond = averaged_out(response, unit)
    return FittedModel(factors, terms, blocks, exog, _fitted(values, exog, blocks), note, count, beyond)


def _independent(columns: Floats) -> Floats:
    """Return a basis of the columns without their means: columns of batches may coincide with those of replicates."""
    vectors, sizes, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
    return np.asarray(vectors[:, sizes > _ROUNDING * np.max(sizes, initial=0.0)], dtype=np.float64)


def _fitted(values: Floats, exog: Floats, blocks: NDArray[np.str_] | None) -> _Fit:
    """Return the estimates of a model whose first column, the mean of all combinations, is 1 in each row."""
    centre = float(values.mean())  # for values far from 0, rounding would hide their differences
    found = _best_fit(values - centre, exog, blocks)
    return found._replace(beta=np.append(found.beta[0] + centre, found.beta[1:]))


def _best_fit(values: Floats, exog: Floats, blocks: NDArray[np.str_] | None) -> _Fit:
    """Return the least-squares estimates; with blocks, those of restricted maximum likelihood.

    The latter minimise the deviance over one number, the ratio of the two variances (Bates, Maechler, Bolker and
    Walker, Fitting linear mixed-effects models using lme4, Journal of Statistical Software 67, 2015, section 3.4).
    `MixedLM` of statsmodels is not used: if blocks do not differ, so that the best ratio is 0, its search fails or ends
    above 0.
    """
    if blocks is None:
        return _fit_at(0.0, values, exog, np.zeros(len(values), dtype=np.intp))
    _, codes = np.unique(blocks, return_inverse=True)

    def at(logarithm: float) -> _Fit:
        return _fit_at(math.exp(logarithm), values, exog, codes)

    none, nearest = _fit_at(0.0, values, exog, codes), min(map(at, _RATIOS), key=lambda each: each.deviance)
    around, step = math.log(nearest.ratio), _RATIOS[1] - _RATIOS[0]
    found = optimize.minimize_scalar(
        lambda logarithm: at(logarithm).deviance,
        bounds=(around - step, around + step),
        method="bounded",
        options={"xatol": _PRECISION},
    )
    return min((none, at(found.x)), key=lambda each: each.deviance)


def _fit_at(ratio: float, values: Floats, exog: Floats, codes: Numbers) -> _Fit:
    """Fit by least squares after subtracting a share of the block mean from values and columns."""
    sizes = np.bincount(codes)
    shares = 1 - 1 / np.sqrt(1 + ratio * sizes)
    both = np.column_stack([exog, values])
    sums = np.zeros((len(sizes), both.shape[1]))
    np.add.at(sums, codes, both)
    both = both - (shares / sizes)[codes, None] * sums[codes]
    orthogonal, triangle = np.linalg.qr(both[:, :-1])
    beta = np.linalg.solve(triangle, orthogonal.T @ both[:, -1])
    inverse = np.linalg.inv(triangle)
    freedom = len(values) - exog.shape[1]
    scale = float(np.sum((both[:, -1] - both[:, :-1] @ beta) ** 2)) / freedom
    determinants = np.sum(np.log1p(ratio * sizes)) + 2 * np.sum(np.log(np.abs(np.diag(triangle))))
    deviance = float(freedom * math.log(scale) + determinants) if scale > 0 else -math.inf
    return _Fit(deviance, ratio, beta, scale * inverse @ inverse.T, scale)


def _confounded_in_words(frame: pd.DataFrame, factors: Iterable[str]) -> str:
    """Return why the model cannot be fitted: which factors are confounded, as each loses rank beside the others."""
    columns = {each: pd.get_dummies(frame[each].astype(str), drop_first=True, dtype=np.float64) for each in factors}
    rank = np.linalg.matrix_rank(_with_mean(columns.values(), len(frame)))
    close = [
        name
        for name, own in columns.items()
        if rank - np.linalg.matrix_rank(_with_mean((columns[each] for each in columns if each != name), len(frame)))
        < own.shape[1]
    ]
    if len(close) < _PAIR:
        return "the factors go together so closely that their effects cannot be told apart."
    which = f"the factors {enumerated(close)} go together so closely that their effects cannot be told apart"
    return f"{which}: take one of them, or {'both' if len(close) == _PAIR else 'all'} as one factor."


def _with_mean(columns: Iterable[pd.DataFrame], count: int) -> Floats:
    return np.column_stack([np.ones(count), *(each.to_numpy() for each in columns)])


def _means_in_blocks(data: MeasureData, numbers: Mapping[str, Floats]) -> tuple[pd.DataFrame, Numbers]:
    """Return the data of the model and each run's row: with blocks, means of combinations in blocks, else all runs."""
    frame = data.frame[list(data.factors)].astype(str).assign(**numbers)
    if data.is_extended:
        frame[BATCH] = data.batches
    if not data.is_blocked:
        return frame, np.arange(len(frame))
    frame[_BLOCK] = data.blocks
    units = [_BLOCK, BATCH] if data.is_extended else [_BLOCK]
    runs = frame.groupby([*units, *data.factors], sort=False)
    return runs[list(numbers)].mean().reset_index(), runs.ngroup().to_numpy(dtype=np.intp)


def estimable_terms(factors: Factors, frame: pd.DataFrame, blocks: int) -> tuple[tuple[Term, ...], str]:
    """Return the effects that can be estimated from the runs, and a note on why others are left out."""
    names = tuple(factors)
    cells, possible = frame.groupby(list(names)).ngroups, factors.count
    if cells == possible <= MOST_CELLS and len(frame) - blocks > cells:
        most = min(len(names), MOST_FACTORS)
        note = "" if most == len(names) else f"Interactions of more than {most} factors are left out."
        return factors.terms(most), note
    if len(frame) - blocks <= 1 + sum(len(levels) - 1 for levels in factors.values()):
        return (), ""
    why = "some combinations have no run" if cells < possible else "there are too few runs a combination"
    if cells > MOST_CELLS:
        why = f"there are {cells:,} combinations"
    note = f"Interactions cannot be estimated: {why}." if len(names) > 1 else ""
    return tuple((name,) for name in names), note
