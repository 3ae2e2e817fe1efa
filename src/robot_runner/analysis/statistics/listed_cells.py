"""The layout of combinations that are not all of the factors': fractions, covering arrays, factorials with gaps.

Each combination keeps a variance of its own, as in a full factorial; effects are those that least squares estimate from
the means of combinations, each of which counts the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.arrays import Numbers
from robot_runner.analysis.statistics.cell_layout import EffectContrast, Layout
from robot_runner.analysis.statistics.nested_factors import NestedFactors, codes_of, columns_of

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import MeasureData
    from robot_runner.analysis.statistics.effect_coding import Term

_PAIR = 2
_ALONE = np.ones((1, 1))


def listed_layout(
    factors: Mapping[str, Sequence[str]], codes: Mapping[str, Numbers], terms: Sequence[Term]
) -> Layout | None:
    """Return the layout of runs; None where a combination has a single one, or its effects cannot be told apart.

    Args:
        factors: the factors, with their treatments.
        codes: the number of each run's treatment, by factor.
        terms: the effects that are tested.
    """
    listed = np.stack([codes[name] for name in factors], axis=1)
    cells, cell = np.unique(listed, axis=0, return_inverse=True)
    sizes = np.bincount(cell.ravel())
    if sizes.min() < _PAIR:
        return None
    of_cells = {name: cells[:, place] for place, name in enumerate(factors)}
    parts = list(columns_of(factors, of_cells, terms).values())
    exog = np.column_stack([np.ones(len(cells)), *parts])
    if np.linalg.matrix_rank(exog) < exog.shape[1]:
        return None
    inverse = np.linalg.pinv(exog)
    effects, start = [], 1
    for term, columns in zip(terms, parts, strict=True):
        rows = inverse[start : start + columns.shape[1]]
        start += columns.shape[1]
        turned, triangle = np.linalg.qr(rows.T)
        # The sign of a rotation is arbitrary; that of t is to be that of the first treatment less the second.
        effects.append(EffectContrast(term, (turned * np.sign(np.diag(triangle))).T, _ALONE))
    return Layout(
        factors if isinstance(factors, NestedFactors) else {name: list(levels) for name, levels in factors.items()},
        tuple(factors),
        is_blocked=False,
        rows=np.argsort(cell.ravel(), kind="stable"),
        starts=np.concatenate([[0], np.cumsum(sizes)[:-1]]),
        sizes=sizes,
        effects=tuple(effects),
        terms=tuple(terms),
        inverse=inverse,
    )


def incomplete_layout(data: MeasureData) -> Layout | None:
    """Return the layout of a factorial some of whose combinations have no run, and the others two and more.

    Interactions of two factors are among its effects where all of them can be told apart from each other, else none is.

    Returns:
        None of anything else: of blocks, of several batches, and where the combinations do not tell main effects apart.
    """
    if data.is_blocked or data.is_extended or len(data.factors) < _PAIR:
        return None
    factors = data.treatments
    codes = codes_of(data.frame, factors)
    main = tuple((name,) for name in factors)
    pairs = factors.terms(_PAIR)[len(main) :] if isinstance(factors, NestedFactors) else combinations(factors, _PAIR)
    with_pairs = listed_layout(factors, codes, (*main, *pairs))
    return with_pairs or listed_layout(factors, codes, main)
