"""Least squares in one stratum, with what its estimates are compared with: runs, or the responses of units to factors.

Where each unit (a subject, a whole plot) has each combination of its factors once, it tells its response to each of
them. An effect is then compared with how units vary in it: the strata of `Error(unit / (A * B))` in R's `aov`. So units
may respond differently to one factor without false positives, and without hiding the other effects. Estimates are those
of least squares from all runs in any case: they are unbiased, and the contrasts of one factor alone could not tell it
apart from the periods and the previous treatments of a crossover.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.contrasts import unbiased_squares

#: Singular values, and shares of a variance, below this are rounding.
_ROUNDING = 1e-9


class Variation(NamedTuple):
    """The variation that estimates are compared with: of runs, or of units in their response to some factors.

    Attributes:
        shares: the products of the weights of each two coefficients, (columns, columns, contrasts, contrasts).
        covariance: of the contrasts of a unit, (..., contrasts, contrasts); of runs, their variance.
        freedom: the degrees of freedom of each contrast.
    """

    shares: Floats
    covariance: Floats
    freedom: float

    @property
    def contrasts(self) -> int:
        """The number of contrasts."""
        return int(self.covariance.shape[-1])

    @property
    def mean_square(self) -> Floats:
        """The mean variance of the contrasts."""
        return np.asarray(np.trace(self.covariance, axis1=-2, axis2=-1) / self.contrasts)

    def part(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return the variance of weighted contrasts, and how many contrasts of equal variance tell it as well.

        This is Box's number, with the correction of Huynh and Feldt where units are enough, else with that of Geisser
        and Greenhouse. By simulation the first has 4 to 5 % false positives at 5 % where units respond alike, 6 to 8 %
        where they respond to one treatment by several standard deviations; the second 1 to 3 % of either. The products
        of the weights are summed over units, (contrasts, contrasts).
        """
        product = weights @ self.covariance
        total, squares = (np.trace(each, axis1=-2, axis2=-1) for each in (product, product @ product))
        squared = total**2
        if 1 < self.contrasts <= self.freedom:
            squares = unbiased_squares(total, squares, np.asarray(self.freedom), self.contrasts)
            squared = squared - 2 * squares / self.freedom
        number = np.where(squares > 0, squared / np.where(squares > 0, squares, 1.0), 1.0)
        return np.asarray(total), np.clip(number, 1.0, self.contrasts)


class StratumFit(NamedTuple):
    """A model fitted by least squares in one stratum.

    Attributes:
        beta: the coefficients, (..., columns).
        inverse: of the cross products of the columns, adjusted for blocks.
        mean_square: of the residuals, (...).
        freedom: its degrees of freedom.
        residuals: (..., runs).
        responses: how units vary in their response to factors; none where one variance serves all effects.
    """

    beta: Floats
    inverse: Floats
    mean_square: Floats
    freedom: float
    residuals: Floats
    responses: tuple[Variation, ...] = ()

    @property
    def variations(self) -> tuple[Variation, ...]:
        """What estimates are compared with."""
        of_runs = Variation(self.inverse[..., None, None], self.mean_square[..., None, None], self.freedom)
        return self.responses or (of_runs,)

    @property
    def components(self) -> Iterator[tuple[Floats, float]]:
        """Yield the components of the variance of a run within the stratum, with their degrees of freedom."""
        whole = sum(each.contrasts for each in self.variations)
        for each in self.variations:
            yield each.mean_square * (each.contrasts / whole), each.freedom * each.contrasts

    def error(self, row: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield the parts of the variance of a weighted sum of coefficients, with their degrees of freedom."""
        for each in self.variations:
            weights = np.einsum("i,ijde,j->de", row, each.shares, row)
            if np.trace(weights) > _ROUNDING * float(row @ self.inverse @ row):
                variance, number = each.part(weights)
                yield variance, each.freedom * number

    def wald(self, place: slice | Sequence[int]) -> tuple[Floats, tuple[Floats, Floats], Floats]:
        """Return the F statistic that some coefficients are zero, its degrees of freedom and its p-value.

        The statistic and the p-value are NaN without error freedom.
        """
        beta = self.beta[..., place]
        middle = np.linalg.inv(self.inverse[place][:, place])
        count, found, most = beta.shape[-1], [], 0.0
        between: Floats = np.asarray(float(count))
        for each in self.variations:
            weights = np.einsum("ij,jide->de", middle, each.shares[place][:, place])
            share = float(np.trace(weights)) / count
            if share > _ROUNDING:
                variance, number = each.part(weights)
                found.append((variance, each.freedom * number))
                if share > most:  # the response to the effect itself; others are there where blocks are not balanced
                    most, between = share, np.clip(count * number / each.contrasts, 1.0, count)
        variance, within = added(found)
        f_value = np.einsum("...a,ab,...b->...", beta, middle, beta) / variance
        f_value = np.asarray(f_value if self.freedom >= 1 else np.full_like(f_value, math.nan))
        return f_value, (between, within), np.asarray(stats.f.sf(f_value, between, within))


def added(parts: Iterable[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Return the sum of independent variances, with its degrees of freedom (Satterthwaite 1946)."""
    variances, freedoms = (np.stack(np.broadcast_arrays(*each)) for each in zip(*parts, strict=True))
    whole = variances.sum(axis=0)
    if len(variances) == 1:
        return whole, freedoms[0]
    return whole, whole**2 / np.sum(variances**2 / np.maximum(freedoms, 1.0), axis=0)


def fit_stratum(
    columns: Floats, blocks: Floats, values: Floats, rank: int, responses: Sequence[Floats] = ()
) -> StratumFit | None:
    """Fit columns adjusted for blocks; None if the columns are collinear.

    Args:
        columns: (runs, columns), projected on the stratum.
        blocks: the nuisance columns, including the constant, projected as well; of any rank.
        values: (..., runs), projected as well.
        rank: the dimensions of the stratum.
        responses: the contrasts of each unit for each response to factors, (units, contrasts, runs), orthonormal.
            Coefficients are the same with them, and what they are compared with is not.
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
    found = [_response(each, np.column_stack([blocks, columns]), rest, left @ inverse) for each in responses]
    known = tuple(each for each in found if each is not None)
    # One variance errs less in the response to one factor (7 to 10 %) than in those to several (14 % and more), and an
    # own error of fewer degrees of freedom than contrasts finds a third of what it does.
    is_told = len(known) == len(found) and (len(known) > 1 or all(each.freedom >= each.contrasts for each in known))
    return StratumFit(beta, inverse, np.asarray(square), freedom, residuals, known if is_told else ())


def _response(contrasts: Floats, columns: Floats, values: Floats, weights: Floats) -> Variation | None:
    """Return how units vary in their response to some factors; None if too few do.

    All columns are fitted again, to the contrasts alone: so the variation is apart from that in other responses.
    """
    units, count = contrasts.shape[:2]
    flat = contrasts.reshape(units * count, -1)
    basis = _basis(flat @ columns, least=1.0)
    rest = values @ flat.T
    rest = (rest - (rest @ basis) @ basis.T).reshape(*values.shape[:-1], units, count)
    freedom = units - basis.shape[1] / count
    if freedom < 1:
        return None
    own = contrasts @ weights
    covariance = np.einsum("...ud,...ue->...de", rest, rest) / freedom
    return Variation(np.einsum("udi,uej->ijde", own, own), covariance, freedom)


def _basis(columns: Floats, least: float = 1e-300) -> Floats:
    """Return an orthonormal basis of the columns, of which those far smaller than the largest, or `least`, are none."""
    if not columns.size:
        return np.empty((len(columns), 0))
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, sizes > _ROUNDING * max(float(sizes[0]), least)], dtype=np.float64)
