"""Resample several profilers, each with its own sampling rate, onto one time grid."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray


#: Interpolate between samples that are at most this many of their periods apart; a wider gap stays a gap.
_MOST_PERIODS = 3.0
_ROUNDING = 1e-9
_BYTES, _GIGA = 8, 1e9


class Resampling(Enum):
    """How the value at a time of the grid is computed.

    MEAN: the mean of the samples that are nearer to this time than to any other of the grid; where there are none,
    linear interpolation. LINEAR: always linear interpolation. PREVIOUS: the last sample before this time.
    """

    MEAN = "mean"
    LINEAR = "linear"
    PREVIOUS = "previous"


@dataclass(frozen=True, slots=True)
class AlignedColumn:
    """The source of one column of aligned samples.

    Attributes:
        name: the plugin's name and the column's, as in `Ina219.power_W`.
        unit: the unit in the column's heading; empty where it has none.
        period: the median time between its samples, s.
        interpolated: the share of its values that were interpolated, percent.
        missing: the share of its values that are missing, percent.
        clock_uncertainty: how far its times may be off relative to the others', s: the largest of all runs, as the
            plugin noted it; None where samples were stamped by the run's own clock, or where it is not known.
    """

    name: str
    unit: str
    period: float
    interpolated: float
    missing: float
    clock_uncertainty: float | None


@dataclass(frozen=True, slots=True)
class AlignedSamples:
    """Samples of several profilers on one grid of times.

    Attributes:
        frame: `run_id` (categorical), the factors, `time_s` (s since the start of the mission, multiples of the
            period), and the columns; NaN at a time without samples near it.
        period: of the grid, s.
        resampling: how values were computed.
        columns: the source of each column.
    """

    frame: pd.DataFrame
    period: float
    resampling: Resampling
    columns: tuple[AlignedColumn, ...]


class Aligned(NamedTuple):
    """Values at the times of a grid, and which of them were interpolated."""

    course: Floats
    is_interpolated: NDArray[np.bool_]


def median_period(times: Floats) -> float:
    """Return the median time between samples, s; NaN where there are fewer than two."""
    return float(np.median(np.diff(times))) if len(times) > 1 else float("nan")


def grid_of(
    spans: Sequence[tuple[float, float]], period: float, window: tuple[float, float] | None, *, columns: int = 1
) -> Floats:
    """Return the times of a grid: multiples of the period, s since the start of the mission.

    Args:
        spans: the first and the last time of each source.
        period: s.
        window: the measured window; None for the time that all sources cover.
        columns: the number of columns, of all runs together, that will be held on such a grid.

    Raises:
        AnalysisError: the columns would take more memory than this machine has.

    Example:
        >>> grid_of([(-0.1, 1.3), (0.2, 1.0)], 0.5, None).tolist()
        [0.5, 1.0]
    """
    low, high = window or (max(first for first, _ in spans), min(last for _, last in spans))
    times = max(0.0, (high - low) / period)
    needed, there = times * columns * _BYTES / _GIGA, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / _GIGA
    if needed > there:
        problem = f"a grid of {period:g} s takes {needed:,.3g} GB: {times:,.3g} times a run"
        fix = f"Give a longer period, or fewer runs and columns: this machine has {there:,.3g} GB of memory."
        raise AnalysisError(problem, where="aligned samples", fix=fix)
    first, last = np.ceil(low / period - _ROUNDING), np.floor(high / period + _ROUNDING)
    return np.arange(first, last + 1) * period + 0.0  # turns -0.0 into 0.0


def align_values(times: Floats, values: Floats, grid: Floats, period: float, how: Resampling) -> Aligned:
    """Return one source's values at the times of a grid.

    Args:
        times: of its samples, s, ascending.
        values: of its samples; NaN for a missing one.
        grid: the times of the grid, s, ascending, `period` apart.
        period: of the grid, s.
        how: how a value is computed.
    """
    there = np.isfinite(times) & np.isfinite(values)
    times, values = times[there], values[there]
    if not len(times) or not len(grid):
        return Aligned(np.full(len(grid), np.nan), np.zeros(len(grid), dtype=bool))
    own = median_period(times)
    reach = _MOST_PERIODS * max(own if np.isfinite(own) else period, period)
    if how is Resampling.PREVIOUS:
        return Aligned(_previous(times, values, grid, reach), np.zeros(len(grid), dtype=bool))
    between = _between(times, values, grid, reach)
    on_sample = np.isin(np.round(grid / _ROUNDING), np.round(times / _ROUNDING))
    if how is Resampling.LINEAR:
        return Aligned(between, np.isfinite(between) & ~on_sample)
    places = np.floor((times - grid[0]) / period + 0.5 + _ROUNDING).astype(np.int64)
    inside = (places >= 0) & (places < len(grid))
    counts = np.bincount(places[inside], minlength=len(grid))
    sums = np.bincount(places[inside], weights=values[inside], minlength=len(grid))
    is_filled = counts > 0
    made = np.where(is_filled, sums / np.maximum(counts, 1), between)
    return Aligned(made, ~is_filled & np.isfinite(made))


def _between(times: Floats, values: Floats, grid: Floats, reach: float) -> Floats:
    """Interpolate linearly; NaN beyond the ends and in gaps wider than `reach`."""
    made = np.interp(grid, times, values, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(times, grid, side="left"), 0, len(times) - 1)
    before = np.clip(np.searchsorted(times, grid, side="right") - 1, 0, len(times) - 1)
    return np.where(times[after] - times[before] > reach + _ROUNDING, np.nan, made)


def _previous(times: Floats, values: Floats, grid: Floats, reach: float) -> Floats:
    places = np.searchsorted(times, grid + _ROUNDING, side="right") - 1
    is_near = (places >= 0) & (grid - times[np.maximum(places, 0)] <= reach)
    return np.where(is_near, values[np.maximum(places, 0)], np.nan)
