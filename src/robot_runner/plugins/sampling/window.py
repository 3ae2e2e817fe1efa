"""The measured window, and samples cut to it."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from robot_runner.errors import PluginError
from robot_runner.plugins.sampling.series import Series

__all__ = ["Window", "cut"]


@dataclass(frozen=True, slots=True)
class Window:
    """The span of time that a measure is about, from `start_measurement` to `stop_measurement`.

    Attributes:
        start: its beginning, s on the run's clock.
        end: its end, s on the run's clock.

    Raises:
        PluginError: the end comes before the start, or one of them is not finite.

    Example:
        >>> Window(2.0, 97.0).duration
        95.0
    """

    start: float
    end: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start) and math.isfinite(self.end) and self.start <= self.end):
            raise PluginError(
                f"a window cannot reach from {self.start} s to {self.end} s",
                where="Window",
                fix="Take both times from context.clock.now(), the earlier one first.",
            )

    @property
    def duration(self) -> float:
        """The seconds from its start to its end."""
        return self.end - self.start


def cut(series: Series, window: Window, *, reach: float = 0.0) -> Series:
    """Return the samples of the window, with a sample on each edge.

    The value on an edge is interpolated linearly between the samples on either side of it. Where there is no
    sample beyond an edge, the nearest one inside stands for it if it is no further than `reach` seconds away
    (one period of sampling is a fair choice); otherwise the result begins or ends with that sample.

    Example:
        >>> cut(Series([0.0, 1.0, 2.0], [0.0, 10.0, 20.0]), Window(0.5, 1.5)).values
        [5.0, 10.0, 15.0]
    """
    low, high = bisect_left(series.times, window.start), bisect_right(series.times, window.end)
    times, values = list(series.times[low:high]), list(series.values[low:high])
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
