"""The relation of the clock of a device, or of another computer, to the run's clock."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from robot_runner.core.errors import LinkError, PluginError

#: Quartzes and ceramic resonators are more accurate than this: an Arduino Nano's has 0.5 % by its data sheet.
_LARGEST_SKEW = 0.01
#: Over less time, s, the jitter of arrival (some milliseconds) would be taken for skew.
_SHORTEST_BASE = 10.0
#: What moves arrivals by more than this, s, is believed to be the clock also where it may be jitter: a busy machine
#: delays bytes by less.
_BEYOND_JITTER = 0.1

#: How fast the rate of a clock may fall, parts of one in a second: a ceramic resonator that warms up changes by 0.1 %
#: at most, within many minutes.
_FASTEST_CHANGE = 2e-6
#: How far the rate of a clock may be off its mean over a mission, parts of one: data sheets of ceramic resonators allow
#: for 0.2 or 0.3 % from -20 to 80 degrees Celsius.
_MOST_BEND = 2e-3
#: Over so much of a mission, s, its clock is taken to go on beyond it as it did.
_STRETCH = 60.0

_Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ClockMap:
    """A line from a device's clock to the run's.

    Attributes:
        offset: the run's time when the device's clock showed 0, s.
        rate: seconds of the run that go by in one second of the device.
        drift: by how much the rate that was found differs from 1; if no clock is so inaccurate, `rate` is 1 instead.

    Example:
        >>> ClockMap(offset=100.0, rate=1.0).to_run(2.5)
        102.5
    """

    offset: float
    rate: float = 1.0
    drift: float = 0.0

    def to_run(self, device_time: float) -> float:
        """Return the run's time at a time of the device's clock, both in seconds; in whole microseconds.

        The relation of two clocks is not known more precisely; and the rounding gives a moment the same time whenever
        the device was switched on.
        """
        return round(self.offset + self.rate * device_time, 6)

    def all_to_run(self, device_times: Iterable[float]) -> list[float]:
        """Return `to_run` of many times."""
        offset, rate = self.offset, self.rate
        return [round(offset + rate * each, 6) for each in device_times]


def fit_clock(
    device_times: Sequence[float], received_times: Sequence[float], *, largest_skew: float = _LARGEST_SKEW
) -> ClockMap:
    """Return the map that fits messages stamped by a device and received by the run, both in s, in order.

    A message is received some time after it was stamped, never before. So the best line runs below all points
    (stamp, arrival) and as close to them as it can: an edge of their lower convex hull. Source: Moon, Skelly,
    Towsley, Estimation and removal of clock skew from network delay measurements (INFOCOM 1999). Where the messages
    span too little time to separate skew from jitter, the rate is taken as 1 and the least delay gives the offset.

    Args:
        device_times: when each message was stamped, by the device's clock.
        received_times: when it arrived, by the run's.
        largest_skew: up to which a skew, in parts of one, is corrected; a larger one is only reported as `drift`.

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


def fit_bent_clock(
    device_times: Sequence[float], received_times: Sequence[float], *, largest_skew: float = _LARGEST_SKEW
) -> list[tuple[int, ClockMap]]:
    """Return maps as of `fit_clock`, each with the number of the first message that it holds for.

    It is one, unless the device's clock leaves the line by more than 0.1 s: its rate changes with its temperature, so
    that a line through hours may be a second off. Then the maps run below the points as `fit_clock`'s line does, but
    bend as fast as a clock may: they join the corners of the lower hull that the points have with a parabola added.

    Raises:
        PluginError: there are no messages.
    """
    line = fit_clock(device_times, received_times, largest_skew=largest_skew)
    first, last, half = device_times[0], device_times[-1], _FASTEST_CHANGE / 2
    messages = zip(device_times, received_times, strict=True)
    hull = _lower_hull((at, came - line.offset - line.rate * at + half * (at - first) ** 2) for at, came in messages)
    least = _believed([(at, height - half * (at - first) ** 2) for at, height in hull])
    if not least[1:] or max(delay for _, delay in least) <= _BEYOND_JITTER:
        return [(0, line)]
    least = (_continued(least, first), *least, _continued(least[::-1], last))
    maps: list[tuple[int, ClockMap]] = []
    for (sooner, delay), (later, delay_then) in pairwise(least):
        bend = (delay_then - delay) / (later - sooner)
        clock = ClockMap(line.offset + delay - bend * sooner, line.rate + bend, line.drift)
        maps.append((bisect_left(device_times, sooner), clock))
    return maps


def _believed(corners: Sequence[_Point]) -> Sequence[_Point]:
    """Return a hull's corners without those at its ends that messages made which were held up.

    From there the clock would have gone too slowly or too fast. And the first and the last message are corners,
    however late they came.
    """
    bends = [(most - least) / (later - sooner) for (sooner, least), (later, most) in pairwise(corners)]
    begin, end = 0, len(bends)
    while begin < end and bends[begin] < -_MOST_BEND:
        begin += 1
    while begin < end and bends[end - 1] > _MOST_BEND:
        end -= 1
    return corners[begin + 1 : end]


def _continued(points: Sequence[_Point], end: float) -> _Point:
    """Return the point at an end before the first one, to which the clock leads that goes on as it does behind that.

    Where it is far, all messages were held up and tell nothing of the clock: then it is one of the line.
    """
    at, delay = points[0]
    if abs(end - at) > _STRETCH:
        return end, 0.0
    behind, then = next((each for each in points if abs(each[0] - at) >= _STRETCH), points[-1])
    return end, delay + (then - delay) / (behind - at) * (end - at)


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
        # Not in a function, as a run has tens of thousands of points: does the last edge turn right?
        while len(hull) > 1:
            (first, least), (second, less) = hull[-2], hull[-1]
            if (second - first) * (point[1] - least) > (less - least) * (point[0] - first):
                break
            hull.pop()
        hull.append(point)
    return hull


#: The largest drift of a computer's steady clock, in parts of one: quartzes are off by less than 1e-4, and a service
#: that sets clocks by the network changes their rate by 5e-4 at most (man adjtimex).
_MOST_DRIFT = 2e-3


@dataclass(frozen=True, slots=True)
class ClockExchange:
    """One request for the time, and its answer.

    Attributes:
        sent: when the request was sent, s on the run's clock.
        received: when the answer arrived, s on the run's clock.
        steady: what the computer's steady clock showed in between, s.
        wall: what the computer's wall clock showed in between, s since 1970.
        own_wall: what this machine's wall clock showed half-way between sending and receiving, s since 1970.
        resolution: of the computer's steady clock, s.
    """

    sent: float
    received: float
    steady: float
    wall: float
    own_wall: float
    resolution: float = 0.0

    @property
    def round_trip(self) -> float:
        """The seconds from the request to its answer."""
        return self.received - self.sent


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """The offsets of a computer's clocks from this machine's at one moment.

    Attributes:
        at: the moment, s on the run's clock.
        steady: what the computer's steady clock showed then, s.
        wall_offset: how far the computer's wall clock was ahead of this machine's, s.
        round_trip: of the exchange that it comes from, s.
        uncertainty: how far both may be wrong, s: half the round trip and the resolution of the computer's clock.
        exchanges: how many there were.
    """

    at: float
    steady: float
    wall_offset: float
    round_trip: float
    uncertainty: float
    exchanges: int


def estimate_offset(exchanges: Sequence[ClockExchange]) -> ClockOffset:
    """Return the offset from the exchange with the least delay.

    The computer read its clock at some time between request and answer. Half-way is the best guess, and it is wrong by
    half the round trip at most, however different the two ways are; so the quickest exchange is the most precise.
    Source: Mills, Internet time synchronization: the Network Time Protocol (IEEE Trans. Comm. 39, 1991), whose clock
    filter picks the sample with the least delay for the same reason.

    Args:
        exchanges: with one computer, in quick succession.

    Raises:
        LinkError: there are no exchanges.

    Example:
        >>> slow = ClockExchange(sent=10.0, received=10.5, steady=110.0, wall=3.0, own_wall=0.0)
        >>> quick = ClockExchange(sent=11.0, received=11.25, steady=111.5, wall=4.5, own_wall=1.0)
        >>> offset = estimate_offset([slow, quick])
        >>> offset.at, offset.steady, offset.wall_offset, offset.uncertainty
        (11.125, 111.5, 3.5, 0.125)
    """
    if not exchanges:
        raise LinkError("there was no exchange with its clock", where="clock offset", fix="Ask it for the time first.")
    best = min(exchanges, key=lambda each: each.round_trip)
    return ClockOffset(
        at=(best.sent + best.received) / 2,
        steady=best.steady,
        wall_offset=best.wall - best.own_wall,
        round_trip=best.round_trip,
        uncertainty=best.round_trip / 2 + best.resolution,
        exchanges=len(exchanges),
    )


@dataclass(frozen=True, slots=True)
class ClockRecord:
    """The offsets of a computer's clocks over a run.

    Attributes:
        host: the computer.
        before: the offset before the run.
        after: the offset after the run; None where the computer could not be reached any more.

    Example:
        >>> before = ClockOffset(at=10.0, steady=500.0, wall_offset=2.0, round_trip=0.0, uncertainty=0.0, exchanges=8)
        >>> after = ClockOffset(at=30.0, steady=521.0, wall_offset=3.0, round_trip=0.0, uncertainty=0.0, exchanges=8)
        >>> ClockRecord("pi@robot", before, after).to_run.to_run(510.5)  # half-way, on a clock that is 5 % fast
        20.0
    """

    host: str
    before: ClockOffset
    after: ClockOffset | None = None

    @property
    def to_run(self) -> ClockMap:
        """The line from the computer's steady clock to the run's; it goes through both offsets, so drift is corrected.

        Between the two its error is at most that of the worse one, if the drift is constant. Where only the first is
        known, both clocks are assumed to go equally fast.
        """
        first, last = self.before, self.after
        if last is None or last.steady <= first.steady:
            return ClockMap(first.at - first.steady)
        rate = (last.at - first.at) / (last.steady - first.steady)
        return ClockMap(first.at - rate * first.steady, rate)

    @property
    def uncertainty(self) -> float:
        """How far a time that was converted to the run's clock may be wrong, s."""
        return max(offset.uncertainty for offset in (self.before, self.after) if offset is not None)

    @property
    def drift(self) -> float | None:
        """By how much the computer's steady clock goes faster than this machine's, in parts of one; None if unknown."""
        if self.after is None or self.after.at <= self.before.at:
            return None
        return (self.after.steady - self.before.steady) / (self.after.at - self.before.at) - 1.0

    def doubts(self) -> Iterator[str]:
        """Yield a doubt where the steady clock stood still for a time, as while a computer is suspended.

        Then the line through both offsets is wrong, and samples are off their true times by up to the time lost.
        """
        if self.after is None:
            return
        here, there = self.after.at - self.before.at, self.after.steady - self.before.steady
        known = self.before.uncertainty + self.after.uncertainty
        if (off := abs(there - here)) > known + _MOST_DRIFT * here:
            yield (
                f"while {here:.3f} s went by here, the steady clock of {self.host} went on by {there:.3f} s, as where "
                f"a computer is suspended: its samples may stand up to {off:.3f} s beside their true times"
            )

    def facts(self) -> dict[str, Any]:
        """Return this record as plain data, for the files and the manifest."""
        return {
            "host": self.host,
            "before": asdict(self.before),
            "after": None if self.after is None else asdict(self.after),
            "uncertainty": self.uncertainty,
            "drift": self.drift,
        }
