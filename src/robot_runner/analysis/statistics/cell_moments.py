"""Means or trimmed means of the cells of a layout, with their squared standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.contrasts import Moments
from robot_runner.core.design.analysis_plan import Estimand

#: The standard deviation of standard normal values after winsorising a fifth at either end (Algina, Keselman and
#: Penfield, An alternative to Cohen's standardized mean difference effect size, 2005).
WINSORISED = 0.642

#: The share that a trimmed mean cuts off at either end (Wilcox, Introduction to Robust Estimation, 2012).
_TRIMMED = 0.2

#: Singular values of batch columns within units below this are rounding.
_ROUNDING = 1e-9


def trimmed_from(size: int) -> int:
    """Return how many of `size` values a trimmed mean cuts off at either end."""
    return int(_TRIMMED * size)


def moments_of_runs(values: Floats, sizes: Numbers, estimand: Estimand) -> Moments:
    """Return the moments of independent runs, sorted by cell."""
    starts = np.cumsum(sizes) - sizes
    if estimand is not Estimand.TRIMMED_MEAN:
        means = np.add.reduceat(values, starts, axis=-1) / sizes
        squares = np.add.reduceat((values - np.repeat(means, sizes, axis=-1)) ** 2, starts, axis=-1)
        errors = squares / ((sizes - 1) * sizes)
        return Moments(means[..., None], errors[..., None, None], np.asarray(sizes - 1.0))
    found = [_trimmed(values[..., start : start + size]) for start, size in zip(starts, sizes, strict=True)]
    means, errors = (np.stack([each[part] for each in found], axis=-1) for part in (0, 1))
    left = np.array([size - 2 * trimmed_from(int(size)) for size in sizes], dtype=np.float64)
    return Moments(means[..., None], errors[..., None, None], left - 1)


def moments_of_strata(values: Floats, counts: Numbers, shares: Floats, estimand: Estimand) -> Moments:
    """Return the moments of independent runs, sorted by cell and batch; a cell has the same variance in all batches."""
    ends = np.cumsum(counts).reshape(counts.shape)
    found = [
        _stratum(values[..., end - size : end], estimand) for end, size in zip(ends.flat, counts.flat, strict=True)
    ]
    centres, squares = (np.stack([each[part] for each in found], axis=-1) for part in (0, 1))
    shape = (*values.shape[:-1], *counts.shape)
    left = left_of(counts) if estimand is Estimand.TRIMMED_MEAN else counts
    freedom = np.sum(left - 1.0, axis=1)
    means = centres.reshape(shape) @ shares
    errors = squares.reshape(shape).sum(axis=-1) / freedom * np.sum(shares**2 / left, axis=1)
    return Moments(means[..., None], errors[..., None, None], freedom)


class SpreadPart(NamedTuple):
    """An independent component of the variance of a run, with its degrees of freedom."""

    variance: float
    freedom: float


def freedom_of(parts: Sequence[SpreadPart]) -> float:
    """Return the degrees of freedom of the sum of the components (Satterthwaite 1946)."""
    return sum(part.variance for part in parts) ** 2 / sum(part.variance**2 / part.freedom for part in parts)


class AveragedOut(NamedTuple):
    """The part of the variance of a run that the means of units average out: 1 - 1 / n of that within a unit.

    It is added so that effects are in standard deviations of runs, whatever the number of runs in a unit.
    """

    variance: Floats
    freedom: float

    def beside(self, *own: SpreadPart) -> tuple[SpreadPart, ...]:
        """Return the components of the variance of a run, given those of the means of units."""
        return (*own, SpreadPart(float(self.variance), self.freedom)) if self.variance else own


#: For runs that are not averaged.
NOT_AVERAGED = AveragedOut(np.zeros(()), 1.0)


def averaged_out(
    values: Floats, unit: Numbers, weights: Floats | None = None, batches: Numbers | None = None
) -> AveragedOut:
    """Return the part of the variance of a run that the means of units average out.

    It is 0 if all units have a single run, or if batches explain all differences within units.

    Args:
        values: of the runs, (..., runs).
        unit: of each run, from 0.
        weights: of each run in the mean of its unit; equal if left out.
        batches: of each run, if there are several; each may have a shift, which is removed.
    """
    order, sizes = np.argsort(unit, kind="stable"), np.bincount(unit)
    starts = np.cumsum(sizes) - sizes

    def within(of: Floats) -> Floats:
        return np.asarray(of - np.repeat(np.add.reduceat(of, starts, axis=-1) / sizes, sizes, axis=-1))

    rest, freedom = within(values[..., order]), len(unit) - len(sizes)
    if batches is not None:
        shifts = within((np.unique(batches)[:, None] == batches[order]).astype(np.float64))
        directions, lengths, _ = np.linalg.svd(shifts.T, full_matrices=False)
        basis = directions[:, lengths > _ROUNDING]
        rest, freedom = rest - (rest @ basis) @ basis.T, freedom - basis.shape[1]
    if freedom < 1:
        return NOT_AVERAGED
    shares = 1 / sizes if weights is None else np.bincount(unit, weights**2)
    return AveragedOut(np.asarray(np.sum(rest**2, axis=-1) / freedom * (1 - shares.mean())), float(freedom))


def left_of(counts: Numbers) -> Numbers:
    """Return how many of `counts` values are left after trimming."""
    return np.asarray(counts - 2 * np.vectorize(trimmed_from)(counts), dtype=np.intp)


def _stratum(values: Floats, estimand: Estimand) -> tuple[Floats, Floats]:
    """Return the estimate of a cell within a batch, and its sum of squares."""
    size = values.shape[-1]
    if estimand is Estimand.TRIMMED_MEAN and trimmed_from(size):
        left = size - 2 * trimmed_from(size)
        mean, error = _trimmed(values)
        return mean, error * left * (left - 1)
    mean = values.mean(axis=-1)
    return mean, np.sum((values - mean[..., None]) ** 2, axis=-1)


def winsorised_sizes(sizes: Numbers) -> Floats:
    """Return the factors from squared errors of trimmed means to the variance of a single normal value."""
    left = np.array([size - 2 * trimmed_from(int(size)) for size in sizes])
    return np.asarray(left * (left - 1) / (sizes.astype(np.float64) - 1) / WINSORISED**2)


def _trimmed(values: Floats) -> tuple[Floats, Floats]:
    """Return the trimmed mean and its squared standard error, which the winsorised values yield (Yuen 1974)."""
    size = values.shape[-1]
    cut = trimmed_from(size)
    ordered = np.sort(values, axis=-1)
    left = size - 2 * cut
    winsorised = np.clip(ordered, ordered[..., [cut]], ordered[..., [size - cut - 1]])
    squares = np.var(winsorised, axis=-1, ddof=1) * (size - 1)
    return ordered[..., cut : size - cut].mean(axis=-1), squares / (left * (left - 1))


def moments_of_units(values: Floats, sizes: Numbers) -> Moments:
    """Return the moments of units, each with all cells and sorted by group: (..., units, cells)."""
    ends = np.cumsum(sizes)
    means, errors = [], []
    for start, end in zip(ends - sizes, ends, strict=True):
        mine = values[..., start:end, :]
        mean = mine.mean(axis=-2)
        rest = mine - mean[..., None, :]
        means.append(mean)
        errors.append(np.einsum("...uc,...ud->...cd", rest, rest) / ((end - start - 1) * (end - start)))
    return Moments(np.stack(means, axis=-2), np.stack(errors, axis=-3), np.asarray(sizes - 1.0))
