"""The design matrix of an analysis of covariance: the columns of effects, batches and covariates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.cell_layout import relative_ranks
from robot_runner.analysis.statistics.cell_moments import AveragedOut, SpreadPart, averaged_out
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.linear_model import estimable_terms
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.analysis.statistics.robust_covariance import RobustFit, fit_robustly
from robot_runner.core.design.analysis_plan import ELAPSED, Estimand
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import MeasureData

#: A column is collinear with the others if they leave less than this share of its sum of squares.
_COLLINEAR = 1e-9

_PAIR = 2


class AdjustmentError(Exception):
    """A measure cannot be adjusted for its covariates; the text says why."""


class Covariate(NamedTuple):
    """A covariate of the model.

    Attributes:
        centre: its mean over the runs, to which means are adjusted.
        scale: its standard deviation, by which it is divided.
        inflation: the variance inflation factor of its slope, due to treatments, blocks and other covariates.
    """

    name: str
    centre: float
    scale: float
    inflation: float


@dataclass(frozen=True, eq=False)
class CovariateDesign:
    """The columns of the model.

    If all factors differ within blocks, block means are subtracted from all columns, and from the values.

    Attributes:
        note: why interactions are left out; empty where they are not.
        effects: the columns of the mean of all combinations and of effects, coded to sum up to zero.
        raw: the covariates, (runs, covariates), with the names `names`.
        batches: the dummy columns of batches; none for a single batch.
        cell: the combination of each run.
        units: the block of each run, where there are blocks.
    """

    factors: Factors
    terms: tuple[Term, ...]
    note: str
    effects: Floats
    values: Floats
    raw: Floats
    names: tuple[str, ...]
    batches: Floats
    cell: Numbers
    units: Numbers | None

    @classmethod
    def of_data(cls, data: MeasureData, estimand: Estimand) -> CovariateDesign:
        """Return the design of a measure.

        Raises:
            AdjustmentError: a covariate has no numbers, or there are too few runs.
        """
        unknown = [name for name in data.covariates if not np.isfinite(data.covariate(name)).all()]
        if unknown:
            lacking = "; time stamps lack, the clock was set between runs, or machines have different times"
            why = lacking if ELAPSED in unknown else ""
            raise AdjustmentError(f"the covariate {enumerated(unknown)} has no number in any run{why}.")
        factors = data.treatments
        texts = data.frame[list(factors)].astype(str)
        units = np.unique(data.blocks, return_inverse=True)[1] if data.is_blocked else None
        number = data.batches if data.is_extended else np.zeros(len(texts), dtype=np.intp)
        batches = pd.get_dummies(number, drop_first=True).to_numpy(dtype=np.float64)
        raw = np.stack([data.covariate(name) for name in data.covariates], axis=1)
        taken = raw.shape[1] + batches.shape[1] + (0 if units is None else int(units.max()))
        terms, note = estimable_terms(factors, texts, taken)
        if not terms:
            raise AdjustmentError("there are too few runs for the number of treatments and covariates.")
        cell = np.asarray(texts.groupby(list(factors), sort=False).ngroup(), dtype=np.intp)
        effects = np.column_stack([np.ones(len(cell)), *factors.columns(codes_of(texts, factors), terms).values()])
        values = data.values  # noqa: PD011 - no data frame
        if estimand is Estimand.RANK:
            values, raw = relative_ranks(values, number), relative_ranks(raw.T, number).T
        return cls(factors, terms, note, effects, values, raw, data.covariates, batches, cell, units)

    @cached_property
    def is_within(self) -> bool:
        """Whether all factors differ within blocks, so that block means are subtracted."""
        effects = self.effects[:, 1:]
        return self.units is not None and _rank(_swept(effects, self.units)) == effects.shape[1]

    @property
    def _sweep(self) -> Numbers | None:
        return self.units if self.is_within else None

    @cached_property
    def base(self) -> Floats:
        """The columns besides covariates: effects, and those of batches that are not collinear with the others.

        Raises:
            AdjustmentError: the factors are collinear.
        """
        base = _swept(self.effects[:, 1:], self._sweep) if self.is_within else self.effects
        if _rank(base) < base.shape[1]:
            raise AdjustmentError("the factors go together so closely that their effects cannot be told apart.")
        for column in _swept(self.batches, self._sweep).T:
            wider = np.column_stack([base, column])
            base = wider if _rank(wider) > _rank(base) else base
        return base

    @cached_property
    def constant(self) -> tuple[str, ...]:
        """The covariates that are constant over all runs, or within all blocks: they need no adjustment."""
        left = np.sum(_swept(self._standardised, self._sweep) ** 2, axis=0)
        return tuple(name for name, each in zip(self.names, left, strict=True) if each <= _COLLINEAR * len(self.values))

    @cached_property
    def covariates(self) -> tuple[Covariate, ...]:
        """The covariates that have a slope.

        Raises:
            AdjustmentError: one is collinear with the treatments or with the others.
        """
        columns = _swept(self.columns, self._sweep)
        found = []
        kept = [place for place, name in enumerate(self.names) if name not in self.constant]
        for place, which in enumerate(kept):
            others = np.column_stack([self.base, np.delete(columns, place, axis=1)])
            rest = columns[:, place] - others @ np.linalg.lstsq(others, columns[:, place])[0]
            share = float(np.sum(rest**2) / np.sum(columns[:, place] ** 2))
            if share < _COLLINEAR:
                raise AdjustmentError(
                    f"the covariate {self.names[which]} is told by treatments or other covariates completely, so that "
                    "effects cannot be told apart."
                )
            mine = self.raw[:, which]
            found.append(Covariate(self.names[which], float(mine.mean()), float(mine.std(ddof=1)), 1 / share))
        return tuple(found)

    @cached_property
    def columns(self) -> Floats:
        """The covariates that have a slope, standardised."""
        return self._standardised[:, [name not in self.constant for name in self.names]]

    @property
    def _standardised(self) -> Floats:
        scales = self.raw.std(axis=0, ddof=1)
        flat = scales <= _COLLINEAR * np.max(np.abs(self.raw), axis=0)
        return np.asarray(np.where(flat, 0.0, (self.raw - self.raw.mean(axis=0)) / np.where(flat, 1.0, scales)))

    @property
    def _variances(self) -> Numbers | None:
        """The combination of each run, if each combination has a separate variance; else None."""
        is_full = self.effects.shape[1] == int(self.cell.max()) + 1
        has_any = self.units is None and is_full and int(np.bincount(self.cell).min()) >= _PAIR
        return self.cell if has_any else None

    def fit(self, columns: Floats) -> RobustFit:
        """Fit the model with these columns in addition to the base."""
        exog = np.column_stack([self.base, _swept(columns, self._sweep)])
        return fit_robustly(exog, _swept(self.values, self._sweep), self.units, self._variances)

    def spread(self, fit: RobustFit) -> float:
        """Return the root of the mean variance of combinations, or of the residuals; NaN for too few runs."""
        freedom = len(fit.residuals) - len(fit.beta) - self._swept_blocks
        if freedom < 1:
            return math.nan
        if self._variances is not None:
            return float(np.sqrt(np.mean(fit.working[np.unique(self.cell, return_index=True)[1]])))
        if self._unit is not None:
            own, _, beyond = self._of_units(fit, self._unit)
            return math.sqrt(own + float(beyond.variance))
        return float(np.sqrt(np.sum(fit.residuals**2) / freedom))

    def spread_parts(self, fit: RobustFit) -> tuple[SpreadPart, ...]:
        """Return the components of the variance within blocks."""
        if self._unit is None:
            return (SpreadPart(self.spread(fit) ** 2, float(len(fit.residuals) - len(fit.beta) - self._swept_blocks)),)
        own, freedom, beyond = self._of_units(fit, self._unit)
        return beyond.beside(SpreadPart(own, freedom))

    def _of_units(self, fit: RobustFit, unit: Numbers) -> tuple[float, float, AveragedOut]:
        """Return the variance of the means of runs that share block and combination, its freedom, and the rest.

        Such runs are not independent: they share the response of the block to the treatment.
        """
        residuals = np.empty(len(unit))
        residuals[np.argsort(np.asarray(self.units), kind="stable")] = fit.residuals
        sizes, first = np.bincount(unit), np.unique(unit, return_index=True)[1]
        rows = [np.bincount(unit, column) / sizes for column in (residuals, *self.batches.T)]
        blocks = None if self._sweep is None else self._sweep[first]
        columns = np.column_stack([self.effects[first, int(self.is_within) :], *rows[1:]])
        columns, means = _swept(columns, blocks), _swept(rows[0][:, None], blocks)[:, 0]
        left = means - columns @ np.linalg.lstsq(columns, means)[0]
        freedom = max(1.0, float(len(sizes) - _rank(columns) - self._swept_blocks))  # < 1: two blocks, and batches
        return float(np.sum(left**2) / freedom), freedom, averaged_out(residuals, unit)

    @cached_property
    def _unit(self) -> Numbers | None:
        """The combination within its block of each run; None if each has a single run, or there are no blocks."""
        if self.units is None:
            return None
        _, unit = np.unique(np.stack([self.units, self.cell]), axis=1, return_inverse=True)
        return None if int(unit.max()) + 1 == len(self.cell) else np.asarray(unit.ravel(), dtype=np.intp)

    @property
    def _swept_blocks(self) -> int:
        return 0 if self._sweep is None else int(self._sweep.max()) + 1

    def crossed(self) -> Floats | None:
        """Return the products of covariates and main effects, for unequal slopes; None if runs are too few."""
        main = self.effects[:, 1 : 1 + sum(len(levels) - 1 for levels in self.factors.values())]
        crossed = (self.columns[:, :, None] * main[:, None, :]).reshape(len(self.values), -1)
        exog = np.column_stack([self.base, _swept(np.column_stack([self.columns, crossed]), self._sweep)])
        return crossed if crossed.shape[1] and _rank(exog) == exog.shape[1] else None


def _swept(columns: Floats, units: Numbers | None) -> Floats:
    """Return columns with the mean of each unit subtracted."""
    if units is None or not columns.size:
        return columns
    means = pd.DataFrame(columns).groupby(units).transform("mean").to_numpy(dtype=np.float64)
    return np.asarray(columns - means.reshape(columns.shape))


def _rank(columns: Floats) -> int:
    return int(np.linalg.matrix_rank(columns)) if columns.size else 0
