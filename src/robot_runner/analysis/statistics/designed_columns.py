"""Residuals of the model of a design, from effects and blocks; its columns may have any rank."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.effect_coding import Term, coded_columns
from robot_runner.analysis.statistics.known_design import before_column, role_column
from robot_runner.analysis.statistics.nested_factors import codes_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from robot_runner.analysis.statistics.analysed_design import MeasureData

#: Columns, whose size is about 1, are 0 within groups if they are smaller than this.
_ROUNDING = 1e-9
#: Residuals are rounding if they are no more than this share of the values, some hundred units in the last place.
_LEAST_LEFT = 1e-13


def numbers_of_levels(levels: Sequence[str]) -> list[float] | None:
    """Return treatments as numbers; None if one is not a number.

    Example:
        >>> numbers_of_levels(["0.1", "0.2"]), numbers_of_levels(["slow", "fast"])
        ([0.1, 0.2], None)
    """
    try:
        found = [float(level) for level in levels]
    except ValueError:
        return None
    return found if np.isfinite(found).all() else None


def carried_over(
    frame: pd.DataFrame,
    factors: Mapping[str, Sequence[str]],
    beside: Floats,
    mean_of: Callable[[Floats], Floats] = lambda columns: columns,
) -> Floats | None:
    """Return the columns of carry-over, the previous treatment, 0 in the first period; None if not estimable.

    They are estimable beside the columns of the constant, blocks and main effects. `mean_of` reduces columns of runs to
    those of their means, as `beside` is.
    """
    parts = []
    for name, levels in factors.items():
        before = frame[before_column(name)].astype(str)
        known = before.isin(levels).to_numpy()
        codes = before.map({text: place for place, text in enumerate(levels)}).fillna(0).to_numpy(int)
        parts.append(coded_columns({name: codes}, {name: len(levels)}, (name,)) * known[:, None])
    columns = mean_of(np.column_stack(parts))
    told = _rank(np.column_stack([beside, columns])) - _rank(beside)
    return columns if told == columns.shape[1] else None


def grouped(data: MeasureData) -> dict[str, NDArray[np.str_]]:
    """Return the groups whose means the model of a design subtracts, by name: blocks, whole plots, batches.

    Residuals are within groups, and so is the order of execution that they are compared with. Otherwise the runs of one
    room, executed one after another, would look like a drift, also where a factor differs between blocks.
    """
    batches = {"batches": _texts(data.batches)} if data.is_extended else {}
    if data.known.is_plain:
        return batches | ({"blocks": data.blocks} if data.is_blocked and _leave_freedom(data) else {})
    found = {name: _texts(data.frame[role_column(name)]) for name in data.known.blocks}
    found |= {data.known.whole_plot: _texts(data.plots)} if data.known.whole_plot else {}
    return found | batches


@lru_cache(maxsize=8)
def _leave_freedom(data: MeasureData) -> bool:
    """Return whether combinations and blocks leave degrees of freedom, or all combinations differ within blocks."""
    cells, number = _cells(data), len(data.frame)
    _, freedom = residuals_from([cells, data.blocks], (), np.zeros(number))
    return freedom > 0 or number - freedom == len(set(cells)) + len(set(data.blocks)) - 1


@lru_cache(maxsize=8)
def _cells(data: MeasureData) -> NDArray[np.str_]:
    """Return the combination of each run."""
    if not data.factors:
        return _texts(np.zeros(len(data.frame)))
    return _texts(data.frame.groupby(list(data.factors), observed=True).ngroup())


def residuals_from(groups: Iterable[NDArray[np.str_]], columns: Sequence[Floats], values: Floats) -> tuple[Floats, int]:
    """Return the least-squares residuals of values from groups and columns of any rank, and their degrees of freedom.

    For the grouping with the most groups, means are subtracted, so that only the others need columns.
    """
    most, *others = sorted([_texts(np.zeros(len(values))), *groups], key=lambda each: -len(set(each)))
    both = np.column_stack([*map(_dummies, others), *columns, values])
    left = both - pd.DataFrame(both).groupby(most).transform("mean").to_numpy()
    beside, rest = left[:, :-1], left[:, -1]
    beside = beside[:, np.max(np.abs(beside), axis=0, initial=0.0) > _ROUNDING]
    rank = _rank(beside) if beside.size else 0
    freedom = len(values) - len(set(most)) - rank
    rest = rest - beside @ np.linalg.lstsq(beside, rest)[0] if rank else rest
    is_rounding = np.max(np.abs(rest), initial=0.0) <= _LEAST_LEFT * np.max(np.abs(values), initial=0.0)
    return np.zeros_like(rest) if is_rounding else rest, freedom


def residuals_of(data: MeasureData, values: Floats | None = None) -> tuple[Floats, int]:
    """Return the residuals of a measure's values, or of other numbers, from its model, and their degrees of freedom.

    A factorial has a mean for each combination, a special design its effects; either also has blocks, batches and
    covariates.
    """
    values = data.values if values is None else values  # noqa: PD011 - no data frame
    beside, groups = _covariates(data), grouped(data)
    if data.known.is_plain:
        return residuals_from([_cells(data), *groups.values()], beside, values)
    return _fitted(data, groups, beside, values)[1]


class ModelEffects(NamedTuple):
    """The effects in the model of a design.

    Attributes:
        powers: for a response surface, the columns of linear and second-order terms, by their factors.
        terms: the columns of all other effects, by their factors.
        before: the columns of carry-over; None if it is not in the model.
    """

    powers: Mapping[Term, Floats]
    terms: Mapping[Term, Floats]
    before: Floats | None

    @property
    def columns(self) -> list[Floats]:
        """The columns of all effects."""
        return [*self.powers.values(), *([] if self.before is None else [self.before]), *self.terms.values()]

    @property
    def without_interactions(self) -> ModelEffects:
        """The same without interactions, for which there may be too few runs."""
        return self._replace(terms={term: of for term, of in self.terms.items() if len(term) == 1})


def residual_effects(data: MeasureData) -> ModelEffects:
    """Return the effects in the model of `residuals_of`, for a special design."""
    return _fitted(data, grouped(data), _covariates(data), data.values)[0]


def _fitted(
    data: MeasureData, groups: Mapping[str, NDArray[np.str_]], beside: Sequence[Floats], values: Floats
) -> tuple[ModelEffects, tuple[Floats, int]]:
    """Return the effects of a design's model, without interactions if runs are too few, and the residuals."""
    effects = _effects(data, np.column_stack([np.ones(len(values)), *map(_dummies, groups.values()), *beside]))
    found = residuals_from(groups.values(), [*beside, *effects.columns], values)
    if found[1] > 0:
        return effects, found
    effects = effects.without_interactions
    return effects, residuals_from(groups.values(), [*beside, *effects.columns], values)


def telling_covariates(data: MeasureData) -> Iterator[tuple[str, Floats]]:
    """Yield the covariates that are numbers in all runs and vary, with their values."""
    for name in data.covariates:
        values = data.covariate(name)
        if np.isfinite(values).all() and np.ptp(values) > 0:
            yield name, values


def _covariates(data: MeasureData) -> list[Floats]:
    columns = [each - each.mean() for _, each in telling_covariates(data)]
    return [(each / np.ptp(each))[:, None] for each in columns]


def block_columns(data: MeasureData, name: str) -> Floats:
    """Return a dummy column for each block of a kind, such as each row, or each subject."""
    return _dummies(_texts(data.frame[role_column(name)]))


def taken_beside_plots(data: MeasureData) -> Floats:
    """Return the nuisance columns besides whole plots, which serve as blocks: replicates and covariates."""
    of_blocks = [block_columns(data, name)[:, 1:] for name in data.known.blocks]
    return np.column_stack([np.empty((len(data.frame), 0)), *of_blocks, *_covariates(data)])


def _texts(values: ArrayLike) -> NDArray[np.str_]:
    return np.asarray(values).astype(str)


def _rank(columns: Floats) -> int:
    return int(np.linalg.matrix_rank(columns))


def _dummies(texts: NDArray[np.str_]) -> Floats:
    names, code = np.unique(texts, return_inverse=True)
    return np.asarray(np.eye(len(names))[code])


def _effects(data: MeasureData, beside: Floats) -> ModelEffects:
    frame, known = data.frame, data.known
    factors = data.treatments
    codes = codes_of(frame, factors)
    numbers = {name: numbers_of_levels(levels) for name, levels in factors.items()}
    powers: dict[Term, Floats] = {}
    # A conditional factor has no number in the runs to which it does not apply.
    everywhere = [name for name, levels in factors.items() if codes[name].max() < len(levels)]
    numeric = {name: np.array(each)[codes[name]] for name in everywhere if (each := numbers[name]) is not None}
    if known.is_surface:
        scaled = {name: (each - each.mean()) / max(float(np.ptp(each)), 1e-300) for name, each in numeric.items()}
        powers |= {(name,): each[:, None] for name, each in scaled.items()}
        pairs = list(combinations_with_replacement(scaled, 2))
        if 1 + len(scaled) + len(pairs) < len(frame):
            powers |= {(one, other): (scaled[one] * scaled[other])[:, None] for one, other in pairs}
    terms = known.terms or tuple((name,) for name in factors if not (known.is_surface and name in numeric))
    told = factors.columns(codes, [term for term in terms if set(term) <= set(factors)])
    main = [each for term, each in told.items() if len(term) == 1]
    before = carried_over(frame, factors, np.column_stack([beside, *main])) if known.carry_over and factors else None
    return ModelEffects(powers, told, before)
