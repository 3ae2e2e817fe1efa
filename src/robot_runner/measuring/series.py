"""Integrals and means of samples over their actual time stamps, which are never quite evenly spaced."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import MutableSequence, Sequence
from dataclasses import dataclass
from itertools import groupby, islice, pairwise
from operator import itemgetter, le

from robot_runner.core.errors import PluginError
from robot_runner.core.events.window import Window

#: By how many times between changes a renewal is recognised, and how far these may differ, as a share of their mean.
_EVEN_CHANGES, _EVENNESS = 2, 0.1
#: The number of values of a quantity that is only switched on and off.
_STATES = 2
#: Or how far, in times between two readings, if that is more.
_SLACK = 1.1


@dataclass(frozen=True, slots=True)
class Series:
    """Samples of one quantity, oldest first; any sequences do, such as lists or `array("d")`.

    Attributes:
        times: when each sample was taken, s; never falling.
        values: one value for each time.

    Raises:
        PluginError: there are more times than values or the reverse, or the times fall.

    Example:
        >>> len(Series([0.0, 0.1, 0.2], [7.5, 7.6, 7.4]))
        3
    """

    times: Sequence[float]
    values: Sequence[float]

    def __post_init__(self) -> None:
        if len(self.times) != len(self.values):
            problem = f"there are {len(self.times)} times and {len(self.values)} values"
            raise PluginError(problem, where="Series", fix="Give one time for each value.")
        if not all(map(le, self.times, islice(self.times, 1, None))):
            problem = "the times of the samples are not in order"
            raise PluginError(problem, where="Series", fix="Sort the samples by time.")

    def __len__(self) -> int:
        return len(self.times)


def within(times: Sequence[float], window: Window) -> slice:
    """Return which of the samples lie in a window, by the times at which they were taken."""
    return slice(bisect_left(times, window.start), bisect_right(times, window.end))


def cut(series: Series, window: Window, *, reach: float = 0.0) -> Series:
    """Return the samples of the window, with a sample on each edge.

    The value on an edge is interpolated linearly between the samples on either side of it. Where there is no
    sample beyond an edge, the nearest one inside is used for it if it is at most `reach` seconds away
    (one sampling period is a good choice); otherwise the result begins or ends with that sample.

    Example:
        >>> from robot_runner.plugins import Series, Window
        >>> cut(Series([0.0, 1.0, 2.0], [0.0, 10.0, 20.0]), Window(0.5, 1.5)).values
        [5.0, 10.0, 15.0]
    """
    seen = within(series.times, window)
    times, values = _copied(series.times[seen]), _copied(series.values[seen])
    if not times or times[0] > window.start:
        first = _value_at(series, window.start, reach)
        if first is not None:
            times.insert(0, window.start)
            values.insert(0, first)
    if not times or times[-1] < window.end:
        last = _value_at(series, window.end, reach)
        if last is not None:
            times.append(window.end)
            values.append(last)
    return Series(times, values)


def _copied(part: Sequence[float]) -> MutableSequence[float]:
    """Return a list, or the array that a part of one is: a mission of hours has millions of samples."""
    return part if isinstance(part, array) and part.typecode == "d" else list(part)


def _value_at(series: Series, time: float, reach: float) -> float | None:
    times, values = series.times, series.values
    after = bisect_left(times, time)
    if 0 < after < len(times):
        before = after - 1
        share = (time - times[before]) / (times[after] - times[before])
        return values[before] + share * (values[after] - values[before])
    if after == 0 and len(times) and times[0] - time <= reach:
        return values[0]
    if after and time - times[-1] <= reach:
        return values[-1]
    return None


def integrate(series: Series) -> float | None:
    """Return the integral of the samples over time by the trapezoid rule, or None for fewer than two samples.

    Example:
        >>> from robot_runner.plugins import Series
        >>> integrate(Series([0.0, 1.0, 3.0], [2.0, 4.0, 4.0]))
        11.0
    """
    if len(series) < 2:  # noqa: PLR2004 - one sample spans no time
        return None
    times, values = series.times, series.values
    steps = zip(times, islice(times, 1, None), values, islice(values, 1, None), strict=False)
    return 0.5 * math.fsum((later - sooner) * (left + right) for sooner, later, left, right in steps)


def growth(counter: Series, window: Window) -> float | None:
    """Return by how much a counter grew over the window, or None where its readings span no time.

    At the edges the counter is interpolated between the readings on either side; beyond the first or the last reading
    it is assumed to grow at its average rate.

    Example:
        >>> from robot_runner.plugins import Series, Window
        >>> growth(Series([0.0, 10.0, 20.0], [0, 100, 300]), Window(5.0, 15.0))
        150.0
    """
    counted = cut(counter, window)
    if len(counted) < 2 or counted.times[-1] == counted.times[0]:  # noqa: PLR2004 - one reading shows no growth
        return None
    seen = counted.times[-1] - counted.times[0]
    return (counted.values[-1] - counted.values[0]) * window.duration / seen


def renewed_every(series: Series, *, is_restless: bool = False) -> float | None:
    """Return the time between changes of a series, s, where it is even; None otherwise, or for too few changes.

    Even changes are those of a meter that renews its value less often than it is read. A series of two values is left
    out: that is a load which is switched on and off.

    Args:
        series: as it was read.
        is_restless: whether it is a quantity that differs at each reading if the meter renews its value, as power with
            decimals does: then the longest time without a change counts where changes are too few, or uneven.

    Example:
        >>> renewed_every(Series([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [7.5, 7.5, 7.6, 7.6, 7.4, 7.4, 7.5]))
        2.0
    """
    times, values = series.times, series.values
    changes = [times[place] for place in range(1, len(series)) if values[place] != values[place - 1]]
    apart = [later - sooner for sooner, later in pairwise(changes)]
    still = longest_standstill(times, values) if is_restless else []
    unchanged = still[-1] - still[0] if still else None
    if len(apart) < _EVEN_CHANGES or len(set(values)) == _STATES:
        return unchanged
    every, spread = math.fsum(apart) / len(apart), max(apart) - min(apart)
    # A change is seen only at the next reading, so that times between changes may differ by the time between readings.
    reading = (times[-1] - times[0]) / (len(series) - 1)
    is_even = spread <= _EVENNESS * every or (len(apart) > _EVEN_CHANGES and spread <= _SLACK * reading)
    return every if is_even else unchanged


def longest_standstill(times: Sequence[float], values: Sequence[object]) -> Sequence[float]:
    """Return the times, s, of the longest stretch of equal values, by the number of samples; empty for none.

    Example:
        >>> longest_standstill([0.0, 1.0, 2.0, 3.0], [7, 8, 8, 9])
        [1.0, 2.0]
    """
    groups = groupby(zip(times, values, strict=True), key=itemgetter(1))
    return max(([time for time, _ in group] for _, group in groups), key=len, default=[])


def mean(series: Series) -> float | None:
    """Return the mean over time (the integral divided by the time spanned), or None where no time is spanned."""
    total = integrate(series)
    if total is None or series.times[-1] == series.times[0]:
        return None
    return total / (series.times[-1] - series.times[0])


def mean_of_intervals(series: Series, window: Window) -> float | None:
    """Return the mean over the window of values that are each about the time since the sample before.

    CPU utilisation is such a value: the busy share of the time since the last sample. The first sample
    has no time before it and does not count. None where the samples do not cover any of the window.

    Example:
        >>> from robot_runner.plugins import Series, Window
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
        >>> from robot_runner.plugins import Series, Window
        >>> energy(Series([0.0, 10.0], [8.0, 8.0]), Window(1.0, 3.0))
        16.0
    """
    return integrate(cut(power, window, reach=reach))


def energy_from_mean_power(power: Series, window: Window) -> float | None:
    """Return the paper's E = P x t in joules: the plain mean of the window's samples times the window's duration.

    Source: Swanborn and Malavolta, Robot Runner (ICSE 2021), section II.C. It equals the integral for evenly
    spaced samples; where samples are missing, average power is assumed.
    """
    seen = power.values[within(power.times, window)]
    return math.fsum(seen) / len(seen) * window.duration if len(seen) else None
