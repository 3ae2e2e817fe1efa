"""The analysis of variance by strata: least squares with blocks, and for split plots within and between whole plots.

Blocks (rows, columns, periods, subjects) have fixed effects that are adjusted for. If some factors change only between
whole plots, their effects are compared with the variation of whole plots, and the others with that of runs within whole
plots: the strata of Nelder (The analysis of randomized experiments with orthogonal block structure, Proceedings of the
Royal Society A 283, 1965), as in R's `aov(... + Error(plot))`. Each stratum has one variance, unless its units
(subjects, whole plots) tell how they respond to each factor: then each effect is compared with how units vary in it, as
in R's `aov(... + Error(unit / (A * B)))`. Values may have leading axes, one entry for each experiment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.cell_moments import NOT_AVERAGED, AveragedOut, SpreadPart
from robot_runner.analysis.statistics.contrasts import Contrast, rounding_of
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.stratum_fit import StratumFit, added, fit_stratum
from robot_runner.analysis.statistics.tested import EffectTest, NotComputed, NoVariation, TestMethod

#: The rest of a column below this share of it is rounding.
_ROUNDING = 1e-9

#: A function that projects columns on a stratum.
_Projection = Callable[[Floats], Floats]


class Hypothesis(NamedTuple):
    """A tested effect: the null hypothesis is that the coefficients of its columns are 0.

    Attributes:
        columns: (runs, degrees of freedom).
        spread: the mean over all combinations of the products of the columns.
    """

    columns: Floats
    spread: Floats


@dataclass(frozen=True, eq=False)
class StrataModel:
    """A fitted model, and the tests of its effects.

    Attributes:
        hypotheses: the tested effects, by their factors.
        stratum_of: the index in `fits` of each effect.
        fits: one, or those between and within whole plots.
        plot_size: the number of runs in a whole plot; 1 without whole plots.
        averaged_out: the part of the variance of a run that is averaged out if the values are means of runs.
        left_out: the runs of units that lack a combination, by their index.
        is_of_units: whether effects within units are compared with how units respond to them, by the mean of each
            combination in each unit.
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
    left_out: tuple[int, ...] = ()
    is_of_units: bool = False

    @property
    def terms(self) -> tuple[Term, ...]:
        """The factors of each effect, main effects first."""
        return tuple(self.hypotheses)

    @property
    def spread(self) -> Floats:
        """The standard deviation of a run: between and within whole plots together."""
        return np.asarray(np.sqrt(sum(each for each, _ in self._components) + self.averaged_out.variance))

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """The components of the variance `spread` squared."""
        return self.averaged_out.beside(*(SpreadPart(float(each), freedom) for each, freedom in self._components))

    @property
    def _components(self) -> list[tuple[Floats, float]]:
        within, (first, *_) = list(self.fits[-1].components), self.fits
        if len(self.fits) == 1 or first.freedom < 1:
            return within
        share = 1 - 1 / self.plot_size
        return [(first.mean_square / self.plot_size, first.freedom), *((share * of, freedom) for of, freedom in within)]

    @property
    def has_responses(self) -> bool:
        """Whether each effect within units is compared with how these vary in it."""
        return bool(self.fits[-1].responses)

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each effect."""
        for term, hypothesis in self.hypotheses.items():
            fit, place = self.fits[self.stratum_of[term]], self._places[term]
            f_value, freedom, p_value = fit.wald(place)
            beta = fit.beta[..., place]
            variance = np.einsum("...a,ab,...b->...", beta, hypothesis.spread, beta)
            yield EffectTest(term, self.method.value, "F", f_value, freedom, p_value, variance)

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of marginal means whose weights sum up to zero."""
        row = np.sum([weight * self.factors.row(self.terms, treatments)[1:] for treatments, weight in weights], axis=0)
        estimate: Floats = np.zeros(self.fits[0].beta.shape[:-1])
        parts: list[tuple[Floats, Floats]] = []
        start = 0
        own = {number: np.zeros(fit.beta.shape[-1]) for number, fit in enumerate(self.fits)}
        for term, hypothesis in self.hypotheses.items():
            count = hypothesis.columns.shape[1]
            own[self.stratum_of[term]][self._places[term]] = row[start : start + count]
            start += count
        for number, mine in own.items():
            if np.any(mine):
                estimate = estimate + self.fits[number].beta @ mine
                parts += self.fits[number].error(mine)
        if not parts:
            return Contrast(*map(np.asarray, (0.0, math.nan, math.nan)))
        variance, freedom = added(parts)
        return Contrast(np.asarray(estimate), np.sqrt(variance), freedom)

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
    responses: Sequence[Floats] = (),
) -> StrataModel | NotComputed | None:
    """Fit the model.

    Args:
        factors: the factors, with their treatments.
        hypotheses: the tested effects, main effects first.
        values: of the runs, (..., runs).
        blocks: the nuisance columns, without the constant.
        plots: the whole plot of each run, from 0; None without whole plots.
        told: `method`, `reason` and `notes` of the model.
        responses: as for `fit_stratum`, of the stratum within whole plots.

    Returns:
        None if whole plots are unequal, so that some effects are in no single stratum.
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
        own = responses if number == len(strata) - 1 else ()
        fit = fit_stratum(columns, project(blocks), project(values.T).T, rank, own)
        if fit is None:
            why = "factors, blocks and covariates go together so closely that effects cannot be told apart."
            return NotComputed("the test", why)
        # A mean square that is rounding is not an estimate of error: with 0, nothing is tested in the stratum.
        least = rounding_of(values)
        known = [
            each._replace(covariance=_beyond(each.covariance, each.mean_square[..., None, None], least))
            for each in fit.responses
        ]
        fits.append(fit._replace(mean_square=_beyond(fit.mean_square, fit.mean_square, least), responses=tuple(known)))
    if fits[-1].freedom < 1:
        return NotComputed(
            "the test",
            "there are too few runs for the number of effects, so that there is no variation to test against.",
        )
    if not np.any(fits[-1].mean_square):
        return NoVariation(
            "the test", "apart from the effects all values are equal, so that there is no variation to test against."
        )
    size = 1 if plots is None else len(plots) // (int(plots.max()) + 1)
    return StrataModel(factors, hypotheses, stratum_of, tuple(fits), size, *told)


def _beyond(variances: Floats, mean_square: Floats, least: float) -> Floats:
    """Return variances, with 0 for those whose mean square is rounding."""
    return np.where(np.sqrt(mean_square) <= least, 0.0, variances)


def _strata(plots: Numbers | None, runs: int) -> list[tuple[_Projection, int]] | None:
    """Return the projection on each stratum and its dimensions; None if whole plots are unequal."""
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
    """Return the index of the stratum that contains an effect; None if there is none."""
    whole = float(np.sum(columns**2))
    for place, (project, _) in enumerate(strata):
        if float(np.sum((columns - project(columns)) ** 2)) <= _ROUNDING * whole:
            return place
    return None
