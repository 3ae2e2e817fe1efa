"""What the model of a design leaves of values, beside its effects and blocks: columns as they are, of any rank."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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

#: Of columns of about 1: less is what rounding leaves of those that the groups tell.
_ROUNDING = 1e-9
#: Of values: what is left of them is rounding if it is no more than this share, some hundred units in the last place.
_LEAST_LEFT = 1e-13


def numbers_of_levels(levels: Sequence[str]) -> list[float] | None:
    """Return treatments as numbers; None where one is none.

    Example:
        >>> numbers_of_levels(["0.1", "0.2"]), numbers_of_levels(["slow", "fast"])
        ([0.1, 0.2], None)
    """
    try:
        found = [float(level) for level in levels]
    except ValueError:
        return None
    return found if np.isfinite(found).all() else None


def carried_over(frame: pd.DataFrame, factors: Mapping[str, Sequence[str]], beside: Floats) -> Floats | None:
    """Return the columns of the treatment before, 0 in the first period; None where others tell a part of them.

    Args:
        frame: the runs.
        factors: the treatments of each factor.
        beside: the columns of the constant, of blocks and of main effects.
    """
    parts = []
    for name, levels in factors.items():
        before = frame[before_column(name)].astype(str)
        known = before.isin(levels).to_numpy()
        codes = before.map({text: place for place, text in enumerate(levels)}).fillna(0).to_numpy(int)
        parts.append(coded_columns({name: codes}, {name: len(levels)}, (name,)) * known[:, None])
    columns = np.column_stack(parts)
    told = _rank(np.column_stack([beside, columns])) - _rank(beside)
    return columns if told == columns.shape[1] else None


def grouped(data: MeasureData) -> dict[str, NDArray[np.str_]]:
    """Return what the model of a design takes out of values as a whole, by name: blocks, whole plots, batches.

    What is left lies within each, and so does the order of execution that it is compared with: where a factor differs
    between blocks, too, as runs of one room, executed one after another, would pass for a drift.
    """
    batches = {"batches": _texts(data.batches)} if data.is_extended else {}
    if data.known.is_plain:
        return batches | ({"blocks": data.blocks} if data.is_blocked and _leave_any(data) else {})
    found = {name: _texts(data.frame[role_column(name)]) for name in data.known.blocks}
    found |= {data.known.whole_plot: _texts(data.plots)} if data.known.whole_plot else {}
    return found | batches


def _leave_any(data: MeasureData) -> bool:
    """Return whether anything is left beside combinations and blocks, or all combinations differ within blocks."""
    cells, number = _cells(data), len(data.frame)
    _, freedom = _left_beside([cells, data.blocks], (), np.zeros(number))
    return freedom > 0 or number - freedom == len(set(cells)) + len(set(data.blocks)) - 1


def _cells(data: MeasureData) -> NDArray[np.str_]:
    """Return the combination of each run."""
    if not data.factors:
        return _texts(np.zeros(len(data.frame)))
    return _texts(data.frame.groupby(list(data.factors), observed=True).ngroup())


def _left_beside(groups: Iterable[NDArray[np.str_]], columns: Sequence[Floats], values: Floats) -> tuple[Floats, int]:
    """Return what is left of values, by least squares, beside groups and columns of any rank; and how freely it varies.

    The means of the most groups are taken away, so that no more than the others have columns.
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
    """Return what the model of a measure's design leaves of each run's value (or another number), and how freely.

    A factorial has a mean for each combination, a design of its own its effects; blocks, batches and covariates add to
    either what they add.
    """
    values = data.values if values is None else values  # noqa: PD011 - no data frame
    beside, groups = _covariates(data), grouped(data)
    if data.known.is_plain:
        return _left_beside([_cells(data), *groups.values()], beside, values)
    return _fitted(data, groups, beside, values)[1]


class ModelEffects(NamedTuple):
    """The effects that the model of a design has.

    Attributes:
        powers: of a response surface, the columns of the factors that are multiplied: one, or two.
        terms: the columns of each other effect, by its factors.
        before: those of the treatment before; None where it is not in the model.
    """

    powers: Mapping[Term, Floats]
    terms: Mapping[Term, Floats]
    before: Floats | None

    @property
    def columns(self) -> list[Floats]:
        """All of them."""
        return [*self.powers.values(), *([] if self.before is None else [self.before]), *self.terms.values()]

    @property
    def without_interactions(self) -> ModelEffects:
        """The same without interactions of factors, for which runs may be too few."""
        return self._replace(terms={term: of for term, of in self.terms.items() if len(term) == 1})


def residual_effects(data: MeasureData) -> ModelEffects:
    """Return the effects that the model has whose residuals `residuals_of` returns, of a design of its own."""
    return _fitted(data, grouped(data), _covariates(data), data.values)[0]


def _fitted(
    data: MeasureData, groups: Mapping[str, NDArray[np.str_]], beside: Sequence[Floats], values: Floats
) -> tuple[ModelEffects, tuple[Floats, int]]:
    """Return the effects of a design's model, without interactions where the runs are too few, and what they leave."""
    effects = _effects(data, np.column_stack([np.ones(len(values)), *map(_dummies, groups.values()), *beside]))
    found = _left_beside(groups.values(), [*beside, *effects.columns], values)
    if found[1] > 0:
        return effects, found
    effects = effects.without_interactions
    return effects, _left_beside(groups.values(), [*beside, *effects.columns], values)


def _covariates(data: MeasureData) -> list[Floats]:
    told = [data.covariate(name) for name in data.covariates]
    columns = [each - each.mean() for each in told if np.isfinite(each).all() and np.ptp(each) > 0]
    return [(each / np.ptp(each))[:, None] for each in columns]


def block_columns(data: MeasureData, name: str) -> Floats:
    """Return a column of 0 and 1 for each block of a kind, such as each row, or each subject."""
    return _dummies(_texts(data.frame[role_column(name)]))


def taken_beside_plots(data: MeasureData) -> Floats:
    """Return what a model takes out beside whole plots, which are blocks there: replicates and covariates."""
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
    """Return all effects that the model has."""
    frame, known = data.frame, data.known
    factors = data.treatments
    codes = codes_of(frame, factors)
    numbers = {name: numbers_of_levels(levels) for name, levels in factors.items()}
    powers: dict[Term, Floats] = {}
    # One that applies to some runs only has no number in the others.
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
