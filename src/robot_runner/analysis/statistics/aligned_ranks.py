"""The aligned rank transform: analysis of variance without the assumption of normal residuals, interactions included.

Source: Wobbrock, Findlater, Gergle and Higgins, The Aligned Rank Transform for Nonparametric Factorial Analyses Using
Only ANOVA Procedures, CHI 2011. For each effect the values are aligned (stripped of all other effects), ranked, and
analysed; only that effect is read off.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import stats

from robot_runner.analysis.statistics.linear_model import fit_linear

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import MeasureData
    from robot_runner.analysis.statistics.linear_model import LinearFit, Terms

__all__ = ["aligned", "aligned_ranks", "fit_aligned"]

#: Aligned values that differ by less than this, beside the largest, are ties that rounding has torn apart.
_TIE = 1e-9


def aligned(data: MeasureData, effect: Sequence[str]) -> NDArray[np.float64]:
    """Return the values aligned for one effect: the residual of the combination's mean, plus the effect's estimate.

    The estimate of an interaction is made of the means over all sets of its factors, with alternating signs.
    """
    values = pd.Series(data.values)
    columns = data.frame

    def mean_over(factors: Sequence[str]) -> NDArray[np.float64]:
        if not factors:
            return np.full(len(values), values.mean())
        keys = [columns[factor].astype(str).to_numpy() for factor in factors]
        return np.asarray(values.groupby(keys).transform("mean"), dtype=np.float64)

    estimate = np.zeros(len(values))
    for size in range(len(effect) + 1):
        sign = (-1) ** (len(effect) - size)
        for subset in combinations(effect, size):
            estimate += sign * mean_over(subset)
    return np.asarray(values - mean_over(data.factors) + estimate, dtype=np.float64)


def aligned_ranks(data: MeasureData, effect: Sequence[str]) -> NDArray[np.float64]:
    """Return the ranks of the values aligned for one effect; values that differ by rounding only are ties."""
    values = aligned(data, effect)
    step = _TIE * max(float(np.max(np.abs(values))), 1e-300)
    return np.asarray(stats.rankdata(np.round(values / step)), dtype=np.float64)


def fit_aligned(data: MeasureData, terms: Terms, effect: Sequence[str]) -> LinearFit:
    """Fit the full model to the ranks of the values aligned for one effect."""
    return fit_linear(data, terms, aligned_ranks(data, effect))
