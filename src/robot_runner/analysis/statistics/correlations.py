"""How measures go together."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.described import Interval, NotComputed
from robot_runner.analysis.statistics.design import VALUE
from robot_runner.analysis.statistics.effect_sizes import correlation_magnitude
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.quiet import quiet
from robot_runner.analysis.statistics.tested import Correlation
from robot_runner.design.columns import RUN_ID

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import MeasureData
    from robot_runner.design.analysis_plan import Correction

__all__ = ["correlations_of"]

_LEAST = 4
_LEVEL = 0.95


def correlations_of(
    measures: Sequence[MeasureData], correction: Correction
) -> tuple[tuple[Correlation, ...], tuple[NotComputed, ...]]:
    """Correlate each pair of measures, over all runs and within combinations of treatments."""
    found: list[Correlation] = []
    missing: list[NotComputed] = []
    for first, second in combinations(measures, 2):
        result = _correlation(first, second)
        (found if isinstance(result, Correlation) else missing).append(result)  # type: ignore[arg-type]
    after = adjusted([each.p_value for each in found], correction)
    listed = (replace(each, adjusted_p_value=value) for each, value in zip(found, after, strict=True))
    return tuple(listed), tuple(missing)


def _correlation(first: MeasureData, second: MeasureData) -> Correlation | NotComputed:
    what = f"correlation of {first.name} and {second.name}"
    joined = first.frame[[RUN_ID, VALUE]].merge(second.frame[[RUN_ID, VALUE]], on=RUN_ID, suffixes=("_1", "_2"))
    x, y = (joined[f"{VALUE}_{which}"].to_numpy(dtype=np.float64) for which in (1, 2))
    if len(joined) < _LEAST:
        return NotComputed(what, f"it takes {_LEAST} runs that have both.")
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return NotComputed(what, "all values of one of them are equal.")
    with quiet():  # values that are equal but for rounding
        pearson = stats.pearsonr(x, y)
        spearman = stats.spearmanr(x, y)
        ends = pearson.confidence_interval(_LEVEL)
    if not math.isfinite(pearson.statistic) or not math.isfinite(spearman.pvalue):
        return NotComputed(what, "the values hardly vary.")
    interval = Interval(float(ends.low), float(ends.high), _LEVEL, "Fisher's z")
    return Correlation(
        first=first.name,
        second=second.name,
        n=len(joined),
        pearson=float(pearson.statistic),
        pearson_interval=interval if math.isfinite(interval.low) else None,
        spearman=float(spearman.statistic),
        p_value=float(spearman.pvalue),
        adjusted_p_value=float(spearman.pvalue),
        within=_within(first, second),
        magnitude=correlation_magnitude(float(spearman.statistic)),
    )


def _within(first: MeasureData, second: MeasureData) -> float | None:
    """Return Pearson's r of what is left of both once the means of the combinations are taken away."""
    residuals = [dict(zip(data.frame[RUN_ID], data.residuals(), strict=True)) for data in (first, second)]
    shared = [run_id for run_id in residuals[0] if run_id in residuals[1]]
    x, y = (np.array([each[run_id] for run_id in shared]) for each in residuals)
    if not first.factors or _is_flat(x, first.values) or _is_flat(y, second.values):
        return None
    return float(stats.pearsonr(x, y).statistic)


def _is_flat(residuals: NDArray[np.float64], values: NDArray[np.float64]) -> bool:
    return float(np.ptp(residuals)) < 1e-12 * max(1e-300, float(np.max(np.abs(values))))
