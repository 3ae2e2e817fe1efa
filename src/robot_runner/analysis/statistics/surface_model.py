"""Response surfaces: a polynomial of degree two in numeric factors.

Sources: Box and Wilson, On the experimental attainment of optimum conditions (Journal of the Royal Statistical Society
B 13, 1951); Myers, Montgomery and Anderson-Cook, Response Surface Methodology, 4th ed., 2016, chapters 2 and 6 (coded
variables, lack of fit, canonical analysis); standard errors of eigenvalues: Bisgaard and Ankenman, Standard errors for
the eigenvalues in second-order response surface models (Technometrics 38, 1996). A factor is tested by all its terms
together, as in SAS's RSREG.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.cell_moments import SpreadPart
from robot_runner.analysis.statistics.contrasts import Contrast, rounding_of
from robot_runner.analysis.statistics.stratum_fit import StratumFit, fit_stratum
from robot_runner.analysis.statistics.tested import EffectTest, Interval, NotComputed, TestMethod

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.effect_coding import Term

_THREE = 3
_LEVEL = 0.95
#: The edge of the explored region, in coded units, plus rounding.
_EDGE = 1 + 1e-9


class Coefficient(NamedTuple):
    """A coefficient of the polynomial of coded factors.

    Attributes:
        term: the factors of the product: one, one twice (its square), or two; empty for the constant.
        estimate: in the measure's unit.
        interval: at 1 - alpha.
        statistic, p_value: of the t-test against zero.
    """

    term: Term
    estimate: float
    interval: Interval
    statistic: float
    p_value: float

    @property
    def label(self) -> str:
        """The term in words, as in `Speed^2` or `Speed x Load`."""
        if len(self.term) == 2 and self.term[0] == self.term[1]:  # noqa: PLR2004 - a square
            return f"{self.term[0]}^2"
        return " x ".join(self.term) or "constant"


class LackOfFit(NamedTuple):
    """The test for lack of fit: the residuals of the surface compared with the variation of repeated runs."""

    f_value: float
    freedom: tuple[float, float]
    p_value: float


class StationaryPoint(NamedTuple):
    """The stationary point of the surface, where its gradient is zero.

    Attributes:
        at: its coordinates, in the units of the factors.
        value: of the measure there.
        kind: `minimum`, `maximum`, `saddle point`, or `ridge` if the interval of a curvature includes 0.
        curvatures: the eigenvalues, in the measure's unit for coded factors, with their intervals.
    """

    at: Mapping[str, float]
    value: float
    kind: str
    curvatures: tuple[tuple[float, Interval], ...]
    is_inside: bool


@dataclass(frozen=True, slots=True)
class Surface:
    """A response surface, for the report.

    Attributes:
        coding: the centre and half the range of each factor, in its unit; coded values are from -1 to 1.
        coefficients: the constant first.
        lack_of_fit: None if no combination was repeated, or the surface has as many terms as combinations.
        r_squared: the share of the variance that it explains.
        stationary: None if the surface has no curvature, or no squares of all factors.
        others: the factors that are not numeric, over which the surface is averaged.
    """

    coding: Mapping[str, tuple[float, float]]
    coefficients: tuple[Coefficient, ...]
    lack_of_fit: LackOfFit | None
    r_squared: float
    stationary: StationaryPoint | None
    others: tuple[str, ...] = field(default=())

    def at(self, numbers: Mapping[str, Floats]) -> Floats:
        """Return the value of the surface at some values of each factor, in its unit."""
        coded = {name: (numbers[name] - middle) / half for name, (middle, half) in self.coding.items()}
        total = np.zeros(np.broadcast_shapes(*(np.shape(each) for each in coded.values())))
        for each in self.coefficients:
            product = np.ones_like(total)
            for name in each.term:
                product = product * coded[name]
            total = total + each.estimate * product
        return total


@dataclass(frozen=True, eq=False)
class SurfaceModel:
    """A fitted surface, and the tests of its factors and their interactions.

    Attributes:
        coding: see `Surface`.
        terms: of the polynomial, without the constant.
        others: the factors that are not numeric, with the indices of their columns.
        columns: of all terms, (runs, coefficients).
        blocks: the nuisance columns, including the constant.
        cells: the combination of each run.
        values: (..., runs).
    """

    factors: Mapping[str, Sequence[str]]
    coding: Mapping[str, tuple[float, float]]
    terms: tuple[Term, ...]
    others: Mapping[str, tuple[int, ...]]
    columns: Floats
    blocks: Floats
    cells: Numbers
    fit: StratumFit
    values: Floats
    notes: tuple[str, ...] = ()

    @property
    def method(self) -> TestMethod:
        """The name of the tests in a paper."""
        return TestMethod.SURFACE

    @property
    def reason(self) -> str:
        """A sentence on why this model is used."""
        return (
            "Factors that are numbers: a polynomial of degree two is fitted by least squares, and a factor is tested "
            "by all its terms together. One variance serves all runs."
        )

    @property
    def spread(self) -> Floats:
        """The residual standard deviation."""
        return np.sqrt(self.fit.mean_square)

    @property
    def spread_parts(self) -> tuple[SpreadPart, ...]:
        """Empty: the spread is known as precisely as effects are."""
        return ()

    def effects(self) -> Iterator[EffectTest]:
        """Yield the test of each factor, by all its terms, then of each interaction."""
        for term, places in self._hypotheses():
            f_value, freedom, p_value = self.fit.wald(places)
            mine = self.columns[:, places] - self.columns[:, places].mean(axis=0)
            told = self.fit.beta[..., places] @ mine.T
            variance = np.mean(told**2, axis=-1)
            yield EffectTest(term, TestMethod.SURFACE.value, "F", f_value, freedom, p_value, variance)

    def _hypotheses(self) -> Iterator[tuple[Term, list[int]]]:
        for name in self.factors:
            if name in self.others:
                yield (name,), list(self.others[name])
            else:
                yield (name,), [place for place, term in enumerate(self.terms) if name in term]
        for place, term in enumerate(self.terms):
            if len(set(term)) > 1:
                yield term, [place]

    def difference(self, weights: Sequence[tuple[Mapping[str, str], float]]) -> Contrast:
        """Estimate a weighted sum of the surface's values at treatments, with the other factors at their centre.

        The weights must sum up to zero.
        """
        row = np.zeros(self.columns.shape[1])
        for treatments, weight in weights:
            numbers = dict.fromkeys(self.coding, 0.0)
            for name, text in treatments.items():
                if name not in self.coding:
                    return Contrast(*map(np.asarray, (0.0, math.nan, math.nan)))
                middle, half = self.coding[name]
                numbers[name] = (float(text) - middle) / half
            row[: len(self.terms)] += weight * np.array([math.prod(numbers[name] for name in t) for t in self.terms])
        error = np.sqrt(self.fit.mean_square * float(row @ self.fit.inverse @ row))
        freedom = np.full(np.shape(error), self.fit.freedom)
        return Contrast(np.asarray(self.fit.beta @ row), np.asarray(error), freedom)

    def surface(self, alpha: float) -> Surface:
        """Return the surface for the report; only for a single experiment."""
        middle = self.columns.mean(axis=0)
        count, runs = len(self.terms), len(self.values)
        constant = float(self.values.mean() - self.fit.beta @ middle)
        spread = float(self.fit.mean_square)
        errors = np.sqrt(
            spread * np.concatenate([[1 / runs + middle @ self.fit.inverse @ middle], np.diag(self.fit.inverse)])
        )
        found = []
        for term, estimate, error in zip(
            ((), *self.terms), (constant, *self.fit.beta[:count]), errors[: count + 1], strict=True
        ):
            each = self._against_zero(estimate, error)
            told = float(each.t_value), float(each.p_value)
            found.append(Coefficient(term, float(estimate), each.interval(alpha), *told))
        left = float(np.sum(self.fit.residuals**2))
        # Dummy columns of blocks are linearly dependent with the constant, so that `qr` would take out too much.
        beside = self.blocks @ np.linalg.lstsq(self.blocks, self.values)[0]
        total = float(np.sum((self.values - beside) ** 2))
        return Surface(
            self.coding,
            tuple(found),
            self._lack_of_fit(left),
            1 - left / total,
            self._stationary(constant, alpha),
            tuple(self.others),
        )

    def _lack_of_fit(self, left: float) -> LackOfFit | None:
        """Compare the residuals with the variation of runs of the same combination (and block)."""
        _, cell = np.unique(np.column_stack([self.cells, self.blocks]), axis=0, return_inverse=True)
        counts = np.bincount(cell.ravel())
        means = np.bincount(cell.ravel(), self.values) / counts
        deviations = self.values - means[cell.ravel()]
        pure = float(np.sum(deviations**2))
        freedom = (self.fit.freedom - float(np.sum(counts - 1)), float(np.sum(counts - 1)))
        if min(freedom) < 1 or np.max(np.abs(deviations)) <= rounding_of(self.values):
            return None
        f_value = (left - pure) / freedom[0] / (pure / freedom[1])
        return LackOfFit(f_value, freedom, float(stats.f.sf(f_value, *freedom)))

    def _stationary(self, constant: float, alpha: float) -> StationaryPoint | None:
        names = list(self.coding)
        beta = dict(zip(self.terms, map(float, self.fit.beta), strict=False))
        if not all((name, name) in beta for name in names):
            return None
        slopes = np.array([beta[name,] for name in names])
        bend = np.diag([beta[name, name] for name in names])
        for one, other in combinations(range(len(names)), 2):
            bend[one, other] = bend[other, one] = beta.get((names[one], names[other]), 0.0) / 2
        curvatures, axes = np.linalg.eigh(bend)
        if np.min(np.abs(curvatures)) <= rounding_of(self.values):
            return None
        coded = -np.linalg.solve(bend, slopes) / 2
        intervals = self._intervals_of_curvatures(axes, curvatures, alpha)
        numbers = {
            name: self.coding[name][0] + self.coding[name][1] * float(x) for name, x in zip(names, coded, strict=True)
        }
        return StationaryPoint(
            numbers,
            constant + float(slopes @ coded) / 2,
            _kind(intervals),
            tuple(zip(map(float, curvatures), intervals, strict=True)),
            bool(np.max(np.abs(coded)) <= _EDGE),
        )

    def _intervals_of_curvatures(self, axes: Floats, curvatures: Floats, alpha: float) -> list[Interval]:
        """Return the intervals of the curvatures along the principal axes (Bisgaard and Ankenman 1996)."""
        names = list(self.coding)
        places = {term: place for place, term in enumerate(self.terms)}
        found = []
        for axis, curvature in zip(axes.T, curvatures, strict=True):
            row = np.zeros(self.columns.shape[1])
            for one, name in enumerate(names):
                row[places[name, name]] = axis[one] ** 2
            for one, other in combinations(range(len(names)), 2):
                if (names[one], names[other]) in places:
                    row[places[names[one], names[other]]] = axis[one] * axis[other]
            error = math.sqrt(float(self.fit.mean_square) * float(row @ self.fit.inverse @ row))
            found.append(self._against_zero(curvature, error).interval(alpha))
        return found

    def _against_zero(self, estimate: float, error: float) -> Contrast:
        return Contrast(*map(np.asarray, (estimate, error, self.fit.freedom)))


def _kind(intervals: Sequence[Interval]) -> str:
    rises, falls = (any(each.low > 0 for each in intervals), any(each.high < 0 for each in intervals))
    if rises and falls:
        return "saddle point"
    if all(each.low > 0 for each in intervals):
        return "minimum"
    return "maximum" if all(each.high < 0 for each in intervals) else "ridge"


def fit_surface(
    factors: Mapping[str, Sequence[str]],
    levels: Mapping[str, Sequence[str]],
    others: Mapping[str, Floats],
    blocks: Floats,
    values: Floats,
    coding: Mapping[str, tuple[float, float]],
) -> SurfaceModel | NotComputed:
    """Fit a surface of degree two, or with as many terms as the runs allow.

    Args:
        factors: the factors, with their treatments.
        levels: the treatment of each run, for each numeric factor.
        others: the columns of factors that are not numeric.
        blocks: the nuisance columns, without the constant.
        values: of the runs.
        coding: the centre and half the range of factors, if the design has them; else those of the runs are taken.
    """
    numbers = {name: np.array([float(text) for text in texts]) for name, texts in levels.items()}
    ends = {name: ((each.max() + each.min()) / 2, np.ptp(each) / 2) for name, each in numbers.items()}
    coding = {name: tuple(map(float, coding.get(name, ends[name]))) for name in numbers}  # type: ignore[misc]
    coded = {name: (each - coding[name][0]) / coding[name][1] for name, each in numbers.items()}
    blocks = np.column_stack([np.ones(values.shape[-1]), blocks])
    _, cells = np.unique(np.column_stack([*coded.values(), *others.values()]), axis=0, return_inverse=True)
    for terms, note in _polynomials(coded):
        columns = np.column_stack(
            [math.prod((coded[name] for name in term), start=1.0) for term in terms] + list(others.values())
        )
        fit = fit_stratum(columns, blocks, values, values.shape[-1])
        if fit is not None and fit.freedom >= 1:
            notes = (note,) if note else ()
            break
    else:
        return NotComputed("the test", "there are too few runs for a surface of these factors.")
    if np.all(np.sqrt(fit.mean_square) <= rounding_of(values)):
        return NotComputed(
            "the test", "the surface leaves nothing unexplained, so that there is no variation to test against."
        )
    starts = np.cumsum([len(terms), *(each.shape[1] for each in others.values())])
    places = {
        name: tuple(range(start, start + others[name].shape[1])) for name, start in zip(others, starts, strict=False)
    }
    return SurfaceModel(factors, coding, terms, places, columns, blocks, cells.ravel(), fit, values, notes)


def _polynomials(coded: Mapping[str, Floats]) -> Iterator[tuple[tuple[Term, ...], str]]:
    """Yield the terms of surfaces, the largest first, each with a note on what is left out."""
    lines: list[Term] = [(name,) for name in coded]
    squares: list[Term] = [(name, name) for name, each in coded.items() if len(set(each.tolist())) >= _THREE]
    crossed: list[Term] = list(combinations(coded, 2))
    left = "The runs do not suffice for all terms of degree two: "
    yield (*lines, *squares, *crossed), ""
    if squares:
        yield (*lines, *crossed), f"{left}squares are left out."
        yield (*lines, *squares), f"{left}interactions are left out."
    yield tuple(lines), f"{left}the surface is a plane."
