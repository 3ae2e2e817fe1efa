"""The layout of an experiment: which means are compared by which contrasts. It follows from the design alone.

Independent runs are compared directly. With blocks, the runs of a combination within a block are reduced to their mean,
so that blocks are the units: the variation between blocks, in their response to treatments as well, is the error.

Fractions, covering arrays and incomplete factorials do not have all combinations of the factors, so their combinations
are listed. Effects are then the least-squares estimates from the means of combinations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.batch_strata import batch_shares, run_counts, weights_in_blocks
from robot_runner.analysis.statistics.cell_moments import (
    WINSORISED,
    AveragedOut,
    averaged_out,
    left_of,
    moments_of_runs,
    moments_of_strata,
    moments_of_units,
    winsorised_sizes,
)
from robot_runner.analysis.statistics.contrasts import without_rounding
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.core.design.analysis_plan import Estimand

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.analysed_design import MeasureData
    from robot_runner.analysis.statistics.contrasts import Moments

#: The most factors of an interaction: larger ones can hardly be interpreted.
MOST_FACTORS = 3

#: The most combinations that get a mean each: more take long to compute, and nobody can read them.
MOST_CELLS = 500

#: The share of blocks that must be complete if the others are to be left out.
COMPLETE = 0.75

_PAIR = 2

#: The fewest runs per treatment for tests of ranks, for two treatments and for more. By simulation, false positives at
#: 5 % are then up to 8 %, and with fewer runs up to 21 %: with two and three runs, all of one treatment are above those
#: of the other in a fifth of experiments.
_FEWEST_RANKED = (4, 3)

#: One weighted sum of each group's cells.
ALONE = np.ones((1, 1))


@dataclass(frozen=True, slots=True)
class EffectContrast:
    """The orthonormal contrasts of an effect: between groups of units, and between the cells within each.

    Attributes:
        between: (contrasts, groups).
        within: (contrasts, cells within a group).
    """

    factors: tuple[str, ...]
    between: Floats
    within: Floats


@dataclass(frozen=True, eq=False, slots=True)
class Layout:
    """How runs are combined into the means that are compared.

    Attributes:
        between: the factors that differ between units; the others differ within each.
        is_blocked: whether units are blocks; else each run is a unit.
        rows: the indices of the used runs among the runs with a value; sorted by unit and cell.
        starts: where each cell of a unit begins among `rows`.
        sizes: the number of units in each group; units are sorted by group.
        effects: the tested effects, main effects first.
        left_out: the runs of incomplete blocks.
        is_replicated: whether a cell of a block has several runs.
        batches: the batch of each of `rows`, by which the rows of a cell are sorted; None for a single batch.
        row_weights: the weight of each of `rows` in the mean of its cell in a block; None for a single batch.
        terms, inverse: where combinations are listed, the effects of the model, and the matrix that maps the means of
            combinations to its coefficients.
    """

    factors: Factors
    between: tuple[str, ...]
    is_blocked: bool
    rows: Numbers
    starts: Numbers
    sizes: Numbers
    effects: tuple[EffectContrast, ...]
    left_out: tuple[int, ...] = ()
    is_replicated: bool = False
    batches: Numbers | None = None
    row_weights: Floats | None = None
    terms: tuple[Term, ...] = ()
    inverse: Floats | None = None

    @property
    def within(self) -> tuple[str, ...]:
        """The factors that differ within each unit."""
        return tuple(name for name in self.factors if name not in self.between)

    @property
    def cells(self) -> int:
        """The number of combinations."""
        return len(self.sizes) * self.factors.only(self.within).count

    @property
    def has_gaps(self) -> bool:
        """Whether combinations are listed, and some of the possible ones have no runs."""
        return self.inverse is not None and self.cells < self.factors.count

    @property
    def missing_for_ranks(self) -> str:
        """What is missing for comparing the ranks of a single factor; empty if nothing is."""
        fewest = _FEWEST_RANKED[self.cells > _PAIR]
        has_enough = self.is_blocked or len(self.factors) > 1 or self.sizes.min() >= fewest
        return "" if has_enough else f"{fewest} runs of each treatment"

    def moments(self, values: Floats, estimand: Estimand = Estimand.MEAN) -> Moments:
        """Return the means of all cells with their squared standard errors, from values of (..., runs)."""
        if self.is_blocked:
            return moments_of_units(self.units(values, estimand), self.sizes)
        taken, strata = self._taken(values, estimand), self._strata
        if strata is None:
            return moments_of_runs(taken, self.sizes, estimand)
        return moments_of_strata(taken, *strata, estimand)

    def _taken(self, values: Floats, estimand: Estimand) -> Floats:
        taken = values[..., self.rows]
        return relative_ranks(taken, self.batches) if estimand is Estimand.RANK else taken

    def units(self, values: Floats, estimand: Estimand = Estimand.MEAN) -> Floats:
        """Return the mean, or the mean rank, of each cell in each block, (..., blocks, cells)."""
        taken = self._taken(values, estimand)
        if self.row_weights is None:
            counts = np.diff(np.append(self.starts, len(self.rows)))
            cells = np.add.reduceat(taken, self.starts, axis=-1) / counts
        else:
            cells = np.add.reduceat(taken * self.row_weights, self.starts, axis=-1)
        return np.asarray(cells.reshape(*cells.shape[:-1], int(self.sizes.sum()), -1))

    def averaged_out(self, values: Floats, estimand: Estimand = Estimand.MEAN) -> AveragedOut:
        """Return the part of the variance of a run that is averaged out in the means of cells in blocks."""
        unit = np.repeat(np.arange(len(self.starts)), np.diff(np.append(self.starts, len(self.rows))))
        return averaged_out(self._taken(values, estimand), unit, self.row_weights, self.batches)

    @property
    def _strata(self) -> tuple[Numbers, Floats] | None:
        """The numbers of runs of each cell in each batch, (cells, batches), and the share of each batch."""
        if self.batches is None:
            return None
        _, batch = np.unique(self.batches, return_inverse=True)
        counts = run_counts(np.repeat(np.arange(len(self.sizes)), self.sizes), batch)
        return counts, batch_shares(counts.astype(np.float64))

    def variance_per_error(self, estimand: Estimand) -> Floats:
        """Return the factor from the squared standard error of each group's mean to the variance of a single value."""
        strata = None if self.is_blocked else self._strata
        if strata is None:
            return winsorised_sizes(self.sizes) if estimand is Estimand.TRIMMED_MEAN else self.sizes.astype(np.float64)
        counts, shares = strata
        if estimand is not Estimand.TRIMMED_MEAN:
            return np.asarray(1 / np.sum(shares**2 / counts, axis=1))
        left = left_of(counts)
        ratio = np.sum(left - 1, axis=1) / np.sum(counts - 1, axis=1)
        return np.asarray(ratio / np.sum(shares**2 / left, axis=1) / WINSORISED**2)

    def weights(self, treatments: dict[str, str]) -> Floats:
        """Return the weights of the cells in a marginal mean, equal over the treatments of all other factors."""
        if self.inverse is not None:
            return np.asarray((self.factors.row(self.terms, treatments) @ self.inverse)[:, None])

        def part(names: Sequence[str]) -> Floats:
            return self.factors.only(names).weights({name: treatments[name] for name in names if name in treatments})

        return np.outer(part(self.between), part(self.within))


def relative_ranks(values: Floats, batches: Numbers | None = None) -> Floats:
    """Return ranks as shares, 0..1: their mean is the probability that a value is larger than that of a random run.

    With several batches, ranks are within each (van Elteren 1960).
    """
    if batches is not None:
        ranks = np.empty(values.shape)
        for each in np.unique(batches):
            ranks[..., batches == each] = relative_ranks(values[..., batches == each])
        return ranks
    return np.asarray((stats.rankdata(values, axis=-1) - 0.5) / values.shape[-1], dtype=np.float64)


def layout_of(data: MeasureData) -> Layout | None:
    """Return the layout of a measure's runs; None where some means or their variance cannot be estimated.

    This is so for combinations without runs or with a single one, and for incomplete blocks: then a model is fitted.
    """
    factors = data.treatments
    if factors.count > MOST_CELLS:
        return None
    codes = codes_of(data.frame, factors)
    batches = data.batches if data.is_extended else None
    return _blocked(factors, codes, data.blocks, batches) if data.is_blocked else _independent(factors, codes, batches)


def _independent(factors: Factors, codes: dict[str, Numbers], batches: Numbers | None) -> Layout | None:
    cell = factors.numbers(codes)
    sizes = np.bincount(cell, minlength=factors.count)
    if sizes.min() < _PAIR:
        return None
    if batches is not None:
        _, batch = np.unique(batches, return_inverse=True)
        counts = run_counts(cell, batch)
        if not counts.all() or np.any(sizes <= counts.shape[1]):
            return None  # a batch lacks a combination, or there is no estimate of error within batches
    rows = np.argsort(cell, kind="stable") if batches is None else np.lexsort((batches, cell))
    return Layout(
        factors,
        tuple(factors),
        is_blocked=False,
        rows=rows,
        starts=np.cumsum(sizes) - sizes,
        sizes=sizes,
        effects=_effects(factors, tuple(factors)),
        batches=None if batches is None else batches[rows],
    )


def _blocked(
    factors: Factors, codes: dict[str, Numbers], blocks: NDArray[np.str_], batches: Numbers | None
) -> Layout | None:
    _, block = np.unique(blocks, return_inverse=True)
    count = int(block.max()) + 1
    held_by = {name: len(set(zip(block.tolist(), codes[name].tolist(), strict=True))) for name in factors}
    between = tuple(name for name in factors if held_by[name] == count)  # one treatment in each block
    within = tuple(name for name in factors if name not in between)
    if not factors.is_apart(between):
        return None  # blocks do not have the same combinations: a model adjusts for blocks
    of_units, of_cells = factors.only(between), factors.only(within)
    cell, group = of_cells.numbers(codes), of_units.numbers(codes)
    if between and batches is not None:
        return None  # units would have to be stratified: a model adjusts for batches
    weights = None if batches is None else weights_in_blocks(block, cell, batches, of_cells.count)
    held = np.zeros((count, of_cells.count), dtype=np.intp)
    counts = np.ones(len(cell), dtype=bool) if weights is None else weights > 0
    np.add.at(held, (block[counts], cell[counts]), 1)
    complete = held.min(axis=1) > 0
    group_of = np.zeros(count, dtype=np.intp)
    group_of[block] = group
    sizes = np.bincount(group_of[complete], minlength=of_units.count)
    if complete.mean() < COMPLETE or sizes.min() < _PAIR:
        return None
    used = np.flatnonzero(complete[block] & counts)
    rows = used[np.lexsort((cell[used], block[used], group[used]))]
    keys = np.stack([block[rows], cell[rows]])
    starts = np.concatenate([[0], np.flatnonzero(np.any(np.diff(keys, axis=1), axis=0)) + 1])
    return Layout(
        factors,
        between,
        is_blocked=True,
        rows=rows,
        starts=starts,
        sizes=sizes,
        effects=_effects(factors, between),
        left_out=tuple(map(int, np.flatnonzero(~complete[block] | ~counts))),
        is_replicated=bool(held.max() > 1),
        batches=None if batches is None else batches[rows],
        row_weights=None if weights is None else weights[rows],
    )


def _effects(factors: Factors, between: Sequence[str]) -> tuple[EffectContrast, ...]:
    of_units, of_cells = factors.only(between), factors.only(name for name in factors if name not in between)

    def matrix(own: Factors, effect: Term) -> Floats:
        return own.contrasts([name for name in effect if name in own])

    return tuple(
        EffectContrast(effect, matrix(of_units, effect), matrix(of_cells, effect))
        for effect in factors.terms(MOST_FACTORS)
    )


def listed_layout(factors: Factors, codes: Mapping[str, Numbers], terms: Sequence[Term]) -> Layout | None:
    """Return the layout of runs; None where a combination has a single run, or effects are not estimable."""
    listed = np.stack([codes[name] for name in factors], axis=1)
    cells, cell = np.unique(listed, axis=0, return_inverse=True)
    sizes = np.bincount(cell.ravel())
    if sizes.min() < _PAIR:
        return None
    of_cells = {name: cells[:, place] for place, name in enumerate(factors)}
    parts = list(factors.columns(of_cells, terms).values())
    exog = np.column_stack([np.ones(len(cells)), *parts])
    if np.linalg.matrix_rank(exog) < exog.shape[1]:
        return None
    inverse = np.linalg.pinv(exog)
    effects, start = [], 1
    for term, columns in zip(terms, parts, strict=True):
        rows = inverse[start : start + columns.shape[1]]
        start += columns.shape[1]
        turned, triangle = np.linalg.qr(rows.T)
        # The sign of QR's columns is arbitrary; the sign of t shall be that of the first treatment minus the second.
        effects.append(EffectContrast(term, without_rounding((turned * np.sign(np.diag(triangle))).T), ALONE))
    return Layout(
        factors,
        tuple(factors),
        is_blocked=False,
        rows=np.argsort(cell.ravel(), kind="stable"),
        starts=np.cumsum(sizes) - sizes,
        sizes=sizes,
        effects=tuple(effects),
        terms=tuple(terms),
        inverse=inverse,
    )


def incomplete_layout(data: MeasureData) -> Layout | None:
    """Return the layout of an incomplete factorial: some combinations have no run, the others two or more.

    Interactions of two factors are included if all of them are estimable, else none is.

    Returns:
        None for anything else: blocks, several batches, and combinations whose main effects are not estimable.
    """
    if data.is_blocked or data.is_extended or len(data.factors) < _PAIR:
        return None
    factors = data.treatments
    codes = codes_of(data.frame, factors)
    main = tuple((name,) for name in factors)
    pairs = factors.terms(_PAIR)[len(main) :]
    return listed_layout(factors, codes, (*main, *pairs)) or listed_layout(factors, codes, main)
