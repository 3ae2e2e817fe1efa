"""Integrals and means of samples over their real time stamps, which are never quite evenly spaced."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import islice
from typing import TYPE_CHECKING

from robot_runner.plugins.sampling.window import cut

if TYPE_CHECKING:
    from robot_runner.plugins.sampling.series import Series
    from robot_runner.plugins.sampling.window import Window

__all__ = ["energy", "energy_from_mean_power", "integrate", "mean", "mean_of_intervals"]


def integrate(series: Series) -> float | None:
    """Return the integral of the samples over time by the trapezoid rule, or None for fewer than two samples.

    Example:
        >>> from robot_runner.plugins.sampling.series import Series
        >>> integrate(Series([0.0, 1.0, 3.0], [2.0, 4.0, 4.0]))
        11.0
    """
    if len(series) < 2:  # noqa: PLR2004 - one sample spans no time
        return None
    times, values = series.times, series.values
    steps = zip(times, islice(times, 1, None), values, islice(values, 1, None), strict=False)
    return 0.5 * math.fsum((later - sooner) * (left + right) for sooner, later, left, right in steps)


def mean(series: Series) -> float | None:
    """Return the mean over time (the integral divided by the time spanned), or None where no time is spanned."""
    total = integrate(series)
    if total is None or series.times[-1] == series.times[0]:
        return None
    return total / (series.times[-1] - series.times[0])


def mean_of_intervals(series: Series, window: Window) -> float | None:
    """Return the mean over the window of values that each tell of the time since the sample before.

    CPU utilisation is such a value: the share of time that was busy since the last look. The first sample
    has no time before it and does not count. None where the samples say nothing about the window.

    Example:
        >>> from robot_runner.plugins.sampling.series import Series
        >>> from robot_runner.plugins.sampling.window import Window
        >>> mean_of_intervals(Series([0.0, 1.0, 3.0], [99.0, 10.0, 40.0]), Window(0.0, 2.0))
        25.0
    """
    times = series.times
    spans = zip(times, islice(times, 1, None), islice(series.values, 1, None), strict=False)
    weighted = [
        (min(later, window.end) - max(sooner, window.start), value)
        for sooner, later, value in spans
        if later > window.start and sooner < window.end
    ]
    total = math.fsum(weight for weight, _ in weighted)
    if total <= 0:
        return None
    return math.fsum(weight * value for weight, value in weighted) / total


def energy(power: Series, window: Window, *, reach: float = 0.0) -> float | None:
    """Return the integral of power (W) over the window, in joules; edges as `cut` treats them.

    Example:
        >>> from robot_runner.plugins.sampling.series import Series
        >>> from robot_runner.plugins.sampling.window import Window
        >>> energy(Series([0.0, 10.0], [8.0, 8.0]), Window(1.0, 3.0))
        16.0
    """
    return integrate(cut(power, window, reach=reach))


def energy_from_mean_power(power: Series, window: Window) -> float | None:
    """Return the paper's E = P x t in joules: the plain mean of the window's samples times the window's duration.

    Source: Swanborn and Malavolta, Robot Runner (ICSE 2021), section II.C. It equals the integral for evenly
    spaced samples; where samples are missing, it takes it that power was as on average.
    """
    within = power.values[bisect_left(power.times, window.start) : bisect_right(power.times, window.end)]
    return math.fsum(within) / len(within) * window.duration if len(within) else None
