"""Drift over the order of execution: is the battery, or the room, confounding?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.described import Interval, NotComputed
from robot_runner.analysis.statistics.design import PLACE
from robot_runner.analysis.statistics.quiet import quiet
from robot_runner.analysis.statistics.tested import Drift
from robot_runner.analysis.wording import in_figures, p_in_words
from robot_runner.design.columns import RUN_ID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import MeasureData

__all__ = ["drift_of"]

_LEAST = 6  # with fewer runs no order can be significant
_LEVEL = 0.95


def drift_of(data: MeasureData, alpha: float, unit: str = "") -> Drift | NotComputed:
    """Look for a drift of the residuals over the order of execution (Spearman's rho, Theil-Sen slope).

    Args:
        data: the measure.
        alpha: the level of significance.
        unit: the measure's unit, for the sentence.
    """
    if len(data.frame) < _LEAST:
        return NotComputed("drift over the order of execution", f"it takes {_LEAST} runs with a value.")
    order = np.argsort(data.frame[PLACE].to_numpy())
    places = data.frame[PLACE].to_numpy(dtype=np.float64)[order]
    residuals = data.residuals()[order]
    if np.ptp(residuals) < 1e-12 * max(1e-300, float(np.max(np.abs(data.values)))):
        return NotComputed("drift over the order of execution", "within each combination all values are equal.")
    with quiet():
        rho, p_value = stats.spearmanr(places, residuals)
        slope = stats.theilslopes(residuals, places, alpha=_LEVEL)
    if not np.isfinite(p_value):
        return NotComputed("drift over the order of execution", "the values hardly vary.")
    is_significant = bool(p_value < alpha)
    is_confounded = _are_treatments_uneven(data, alpha)
    return Drift(
        places=tuple(int(place) for place in places),
        residuals=tuple(map(float, residuals)),
        run_ids=tuple(data.frame[RUN_ID].to_numpy()[order]),
        correlation=float(rho),
        p_value=float(p_value),
        slope=float(slope.slope),
        slope_interval=Interval(float(slope.low_slope), float(slope.high_slope), _LEVEL, "Theil-Sen"),
        is_significant=is_significant,
        is_confounded=is_confounded,
        warning=_warning(data.name, unit, slope.slope, rho, p_value, is_confounded=is_confounded)
        if is_significant
        else "",
    )


def _are_treatments_uneven(data: MeasureData, alpha: float) -> bool:
    """Return whether some treatments were executed rather earlier than others (Kruskal-Wallis test of the places)."""
    return any(_p_of_places(data, factor) < alpha for factor in data.factors)


def _p_of_places(data: MeasureData, factor: str) -> float:
    groups: list[NDArray[np.int64]] = [rows.to_numpy() for _, rows in data.frame.groupby(factor, observed=True)[PLACE]]
    with quiet():
        return float(stats.kruskal(*groups).pvalue)


def _warning(measure: str, unit: str, slope: float, rho: float, p_value: float, *, is_confounded: bool) -> str:
    direction = "rises" if slope > 0 else "falls"
    amount = f"{in_figures(abs(slope))} {unit}".strip()
    figures = f"rho = {rho:.2f}, {p_in_words(p_value)}"
    head = f"{measure} {direction} over the order of execution by about {amount} a run ({figures})"
    if is_confounded:
        return f"{head}, and treatments are unevenly spread over that order: the drift may pass for an effect."
    return f"{head}: something that changes with time, such as the battery or the room, adds to it."
