"""From the clock of a device to the clock of the run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from robot_runner.core.errors import PluginError

#: Quartzes and ceramic resonators are truer than this: 0.5 % is the data-sheet figure of an Arduino Nano's.
_LARGEST_SKEW = 0.01
#: Over less time, s, the jitter of arrival (some milliseconds) would pass for skew.
_SHORTEST_BASE = 10.0
#: Over less time than that, a skew is believed that moved the arrivals by more than a busy machine delays bytes, s.
_BEYOND_JITTER = 0.1

_Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ClockMap:
    """A line from a device's clock to the run's.

    Attributes:
        offset: the run's time when the device's clock showed 0, s.
        rate: seconds of the run that go by in one second of the device.
        drift: by how much that differs from 1 as it was found; where a clock cannot be so far off, the rate is 1.

    Example:
        >>> ClockMap(offset=100.0, rate=1.0).to_run(2.5)
        102.5
    """

    offset: float
    rate: float = 1.0
    drift: float = 0.0

    def to_run(self, device_time: float) -> float:
        """Return the run's time at a time of the device's clock, both in seconds; in whole microseconds.

        No two clocks are known to each other better than that; and so a moment has one time, whenever the device was
        switched on.
        """
        return round(self.offset + self.rate * device_time, 6)

    def all_to_run(self, device_times: Iterable[float]) -> list[float]:
        """Return what `to_run` does of many times."""
        offset, rate = self.offset, self.rate
        return [round(offset + rate * each, 6) for each in device_times]


def fit_clock(
    device_times: Sequence[float], received_times: Sequence[float], *, largest_skew: float = _LARGEST_SKEW
) -> ClockMap:
    """Return the map that fits messages stamped by a device and received by the run, both in s, in order.

    A message is received some time after it was stamped, never before. So the best line runs below all points
    (stamp, arrival) and as close to them as it can: an edge of their lower convex hull. Source: Moon, Skelly,
    Towsley, Estimation and removal of clock skew from network delay measurements (INFOCOM 1999). Where the messages
    span too little time to tell skew from jitter, the rate is taken as 1 and the least delay gives the offset.

    Args:
        device_times: when each message was stamped, by the device's clock.
        received_times: when it arrived, by the run's.
        largest_skew: up to where a skew, in parts of one, is believed and mended; a larger one is told as `drift` only.

    Raises:
        PluginError: there are no messages.

    Example:
        >>> fit_clock([0.0, 0.1, 0.2], [50.004, 50.101, 50.209]).offset
        50.001
    """
    if not len(device_times):
        raise PluginError("no messages to compare clocks with", where="fit_clock", fix="Call it once samples arrived.")
    hull = _lower_hull((stamp, arrival - stamp) for stamp, arrival in zip(device_times, received_times, strict=True))
    drift = _skew(hull, device_times[0], device_times[-1])
    skew = drift if abs(drift) <= largest_skew else 0.0
    return ClockMap(min(delay - skew * stamp for stamp, delay in hull), 1.0 + skew, drift)


def _skew(hull: Sequence[_Point], first: float, last: float) -> float:
    """Return how much faster the run's clock goes, from the hull's edge below the middle or its nearest wide chord."""
    middle, base = (first + last) / 2, min(_SHORTEST_BASE, (last - first) / 3)
    left = [point for point in hull if point[0] <= middle - base / 2]
    right = [point for point in hull if point[0] >= middle + base / 2]
    if base <= 0 or not left or not right:
        return 0.0
    (sooner, least), (later, most) = left[-1], right[0]
    is_sure = later - sooner >= _SHORTEST_BASE or abs(most - least) > _BEYOND_JITTER
    return (most - least) / (later - sooner) if is_sure else 0.0


def _lower_hull(points: Iterable[_Point]) -> list[_Point]:
    """Return the lower convex hull of points that are sorted by their first coordinate (Andrew's monotone chain)."""
    hull: list[_Point] = []
    for point in points:
        if hull and point[0] <= hull[-1][0]:
            if point[1] >= hull[-1][1]:
                continue
            hull.pop()
        # A run has tens of thousands of points, so what decides whether the last edge turns right stands here.
        while len(hull) > 1:
            (first, least), (second, less) = hull[-2], hull[-1]
            if (second - first) * (point[1] - least) > (less - least) * (point[0] - first):
                break
            hull.pop()
        hull.append(point)
    return hull
