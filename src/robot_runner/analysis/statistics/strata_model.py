"""The analysis of variance by strata: least squares beside blocks, and of a split-plot design within and between plots.

Blocks (rows, columns, periods, subjects) are fixed and taken out. Where some factors change from whole plot to whole
plot only, what differs between whole plots is compared with how these vary, and the rest with how runs vary within
them: the strata of Nelder (The analysis of randomized experiments with orthogonal block structure, Proceedings of the
Royal Society A 283, 1965), which R's `aov(... + Error(plot))` prints. One variance serves each stratum. Values may have
leading axes, one experiment each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.cell_moments import NOT_AVERAGED, AveragedOut, SpreadPart
from robot_runner.analysis.statistics.contrasts import Contrast, rounding_of
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.tested import EffectTest, NotComputed, NoVariation, TestMethod

#: Of a column: less than this share of it is what rounding leaves.
_ROUNDING = 1e-9

#: Takes of columns what lies in one stratum.
_Projection = Callable[[Floats], Floats]


class Hypothesis(NamedTuple):
    """An effect that is tested: that some columns of the model tell nothing.

    Attributes:
        columns: (runs, degrees of freedom).
        spread: the mean over all combinations of the products of the columns.
    """

    columns: Floats
    spread: Floats


class StratumFit(NamedTuple):
    """A model fitted by least squares in one stratum.

    Attributes:
        beta: the coefficients, (..., columns).
        inverse: of the cross products of the columns, beside blocks.
        mean_square: of what is left, (...).
        freedom: its degrees of freedom.
        residuals: (..., runs).
    """

    beta: Floats
    inverse: Floats
    mean_square: Floats
    freedom: float
    residuals: Floats

    def wald(self, place: slice | Sequence[int]) -> tuple[Floats, Floats]:
        """Return the F statistic that some coefficients are zero, and its p-value; NaN where nothing is left."""
        beta = self.beta[..., place]
        middle = np.linalg.inv(self.inverse[place][:, place])
        squares = np.einsum("...a,ab,...b->...", beta, middle, beta)
        count = beta.shape[-1]
        if self.freedom < 1:
            return np.full_like(squares, math.nan), np.full_like(squares, math.nan)
        f_value = np.asarray(squares / count / self.mean_square)
        return f_value, np.asarray(stats.f.sf(f_value, count, self.freedom))


def fit_stratum(columns: Floats, blocks: Floats, values: Floats, rank: int) -> StratumFit | None:
    """Fit columns beside blocks; None where the columns cannot be told apart.

    Args:
        columns: (runs, columns); both projected onto the stratum.
        blocks: what is taken out, the constant among it; of any rank.
        values: (..., runs), projected as well.
        rank: the dimensions of the stratum.
    """
    basis = _basis(blocks)
    left = columns - basis @ (basis.T @ columns)
    rest = values - (values @ basis) @ basis.T
    crossed = left.T @ left
    if left.shape[1] and np.linalg.matrix_rank(left, tol=_ROUNDING * len(left)) < left.shape[1]:
        return None
    inverse = np.asarray(np.linalg.inv(crossed), dtype=np.float64) if left.shape[1] else crossed
    beta = rest @ left @ inverse
    residuals = rest - beta @ left.T
    freedom = float(rank - basis.shape[1] - left.shape[1])
    square = np.sum(residuals**2, axis=-1) / freedom if freedom >= 1 else np.full(values.shape[:-1], math.nan)
    return StratumFit(beta, inverse, np.asarray(square), freedom, residuals)


def _basis(columns: Floats) -> Floats:
    """Return orthonormal columns that span the same."""
    if not columns.size:
        return np.empty((len(columns), 0))
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, sizes > _ROUNDING * max(float(sizes[0]), 1e-300)], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class StrataModel:
    """A fitted model, and the tests of its effects.

    Attributes:
        factors: the factors, with their treatments.
        hypotheses: what is tested, by its factors.
        stratum_of: in which of `fits` each effect is.
        fits: one, or that between whole plots and that within.
        plot_size: how many runs a whole plot has; 1 where there are none.
        method: what a paper calls the tests.
        reason: why this one, in a sentence.
        notes: what a reader has to know besides.
        averaged_out: what of the variance of a run is left out where what is modelled are means of runs.
    """

    factors: Factors
    hypotheses: Mapping[Term, Hypothesis]
    stratum_of: Mapping[Term, int]
    fits: tuple[StratumFit, ...]
    plot_size: int
    method: TestMethod
    reason: str
    notes: tuple[str, ...] = ()
    averaged_out: AveragedOut = NOT_AVERAGED

    @property
    def terms(self) -> tuple[Term, ...]:
        """The factors of each effect, main effects first."""
        return tuple(self.hypotheses)

    @property
    def spread(self) -> Floats:
        """The standard deviation of a run: of whole plots and of runs within them together."""
        within = self.fits[-1].mean_square
        if len(self.fits) == 1:
            return np.asarray(np.sqrt(within + self.averaged_out.variance))
        between = self.fits[0].mean_square
        share = np.where(np.isfinite(between), between + (self.plot_size - 1) * within, self.plot_size * within)
        return np.asarray(np.sqrt(share / self.plot_size + self.averaged_out.variance))

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """The parts of the variance that is `spread` squared."""
        within = SpreadPart(float(self.fits[-1].mean_square), self.fits[-1].freedom)
        between = SpreadPart(float(self.fits[0].mean_square) / self.plot_size, self.fits[0].freedom)
        if len(self.fits) == 1 or not math.isfinite(between.variance):
            return self.averaged_out.beside(within)
        left = within._replace(variance=within.variance * (1 - 1 / self.plot_size))
        return self.averaged_out.beside(between, left)

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each effect."""
        for term, hypothesis in self.hypotheses.items():
            fit, place = self.fits[self.stratum_of[term]], self._places[term]
            f_value, p_value = fit.wald(place)
            beta = fit.beta[..., place]
            variance = np.einsum("...a,ab,...b->...", beta, hypothesis.spread, beta)
            freedom = (float(beta.shape[-1]), fit.freedom)
            yield EffectTest(term, self.method.value, "F", f_value, freedom, p_value, variance)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means whose weights sum up to zero.

        Args:
            weights: treatments by factor, with the weight of their mean.
        """
        rows = [weight * self.factors.row(self.terms, treatments)[1:] for treatments, weight in weights]
        row = np.sum(rows, axis=0)
        estimate: Floats = np.zeros(self.fits[0].beta.shape[:-1])
        parts: list[Floats] = []
        freedoms: list[float] = []
        start = 0
        own = {number: np.zeros(fit.beta.shape[-1]) for number, fit in enumerate(self.fits)}
        for term, hypothesis in self.hypotheses.items():
            count = hypothesis.columns.shape[1]
            own[self.stratum_of[term]][self._places[term]] = row[start : start + count]
            start += count
        for number, mine in own.items():
            if np.any(mine):
                fit = self.fits[number]
                estimate = estimate + fit.beta @ mine
                parts.append(fit.mean_square * float(mine @ fit.inverse @ mine))
                freedoms.append(fit.freedom)
        if not parts:
            return Contrast(*map(np.asarray, (0.0, math.nan, math.nan)))
        variance = sum(parts[1:], parts[0])
        told = sum(part**2 / max(freedom, 1.0) for part, freedom in zip(parts, freedoms, strict=True))
        freedom = np.full_like(variance, freedoms[0]) if len(parts) == 1 else variance**2 / told  # Satterthwaite 1946
        return Contrast(np.asarray(estimate), np.sqrt(variance), np.asarray(freedom))

    @cached_property
    def _places(self) -> dict[Term, slice]:
        """The columns of each effect among those of its stratum."""
        ends, places = [0] * len(self.fits), {}
        for term, hypothesis in self.hypotheses.items():
            number, count = self.stratum_of[term], hypothesis.columns.shape[1]
            places[term] = slice(ends[number], ends[number] + count)
            ends[number] += count
        return places


def fit_strata(
    factors: Factors,
    hypotheses: Mapping[Term, Hypothesis],
    values: Floats,
    blocks: Floats,
    plots: Numbers | None,
    told: tuple[TestMethod, str, tuple[str, ...]],
) -> StrataModel | NotComputed | None:
    """Fit the model.

    Args:
        factors: the factors, with their treatments.
        hypotheses: what is tested, main effects first.
        values: of the runs, (..., runs).
        blocks: the columns that are taken out, without the constant.
        plots: the whole plot of each run, from 0; None where there are none.
        told: what a paper calls the tests, why this one, and what a reader has to know besides.

    Returns:
        None where whole plots are unequal, so that effects do not lie in one stratum each.
    """
    blocks = np.column_stack([np.ones(values.shape[-1]), blocks])
    strata = _strata(plots, values.shape[-1])
    if strata is None:
        return None
    stratum_of: dict[Term, int] = {}
    for term, each in hypotheses.items():
        place = _stratum_of(each.columns, strata)
        if place is None:
            return None
        stratum_of[term] = place
    fits = []
    for number, (project, rank) in enumerate(strata):
        mine = [each.columns for term, each in hypotheses.items() if stratum_of[term] == number]
        columns = project(np.column_stack(mine)) if mine else np.empty((values.shape[-1], 0))
        fit = fit_stratum(columns, project(blocks), project(values.T).T, rank)
        if fit is None:
            why = "the factors go together so closely with each other or with blocks that effects cannot be told apart."
            return NotComputed("the test", why)
        # What rounding leaves is no measure of chance: beside a mean square of 0, nothing is tested in a stratum.
        is_rounding = np.sqrt(fit.mean_square) <= rounding_of(values)
        fits.append(fit._replace(mean_square=np.where(is_rounding, 0.0, fit.mean_square)))
    if fits[-1].freedom < 1:
        return NotComputed(
            "the test", "there are too few runs for the number of effects, so that chance has no measure."
        )
    if not np.any(fits[-1].mean_square):
        return NoVariation("the test", "beside the effects all values are equal, so that chance has no measure.")
    size = 1 if plots is None else len(plots) // (int(plots.max()) + 1)
    return StrataModel(factors, hypotheses, stratum_of, tuple(fits), size, *told)


def _strata(plots: Numbers | None, runs: int) -> list[tuple[_Projection, int]] | None:
    """Return what projects columns onto each stratum, and its dimensions; None where whole plots are unequal."""
    if plots is None:
        return [(lambda columns: columns, runs)]
    sizes = np.bincount(plots)
    if sizes.min() != sizes.max():
        return None
    belongs = np.eye(len(sizes))[plots]

    def of_plots(columns: Floats) -> Floats:
        return np.tensordot(belongs, np.tensordot(belongs.T, columns, axes=1) / sizes[0], axes=1)

    return [(of_plots, len(sizes)), (lambda columns: columns - of_plots(columns), runs - len(sizes))]


def _stratum_of(columns: Floats, strata: Sequence[tuple[_Projection, int]]) -> int | None:
    """Return in which stratum an effect lies wholly; None where in none."""
    whole = float(np.sum(columns**2))
    for place, (project, _) in enumerate(strata):
        if float(np.sum((columns - project(columns)) ** 2)) <= _ROUNDING * whole:
            return place
    return None
