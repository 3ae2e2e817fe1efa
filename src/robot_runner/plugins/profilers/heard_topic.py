"""What was heard of one topic: its messages' times, sizes, ages and numbers, and the figures made of them."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

from robot_runner.plugins.sampling.quality import quality_of
from robot_runner.plugins.sampling.raw_files import Column

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.links.robot import RawMessage
    from robot_runner.plugins.profilers.ros_listening import HeaderReader
    from robot_runner.plugins.sampling.quality import SampleQuality
    from robot_runner.plugins.sampling.window import Window

__all__ = ["DROPPED", "HeardTopic", "missed"]

#: The measure that only ROS 1 can tell.
DROPPED = "Dropped"

_UINT32 = 1 << 32

#: One publisher that is started anew lets the numbers fall once; more often than this, there are several.
_STEPS_A_FALL = 100

#: So far may a stamp lie in the future, s, before clocks are said to differ: they are never quite one.
_AHEAD = 0.001


def missed(sequence: Sequence[int]) -> int | None:
    """Return how many numbers of a sequence are missing; None where nobody counts.

    A publisher counts its messages, modulo 2^32. Where the numbers fall, it was started anew; where they fall time and
    again, several publishers count each for itself, and nothing can be told.

    Example:
        >>> missed([7, 8, 11, 12]), missed([0, 0, 0]), missed([90, 91, 0, 1]), missed([5, 900, 6, 901, 7, 902])
        (2, None, 0, None)
    """
    steps = [(later - sooner) % _UINT32 for sooner, later in pairwise(sequence)]
    falls = sum(step >= _UINT32 // 2 for step in steps)
    if not any(steps) or falls > max(1, len(steps) // _STEPS_A_FALL):
        return None
    return sum(step - 1 for step in steps if 1 < step < _UINT32 // 2)


@dataclass(slots=True)
class HeardTopic:
    """What was heard of one topic while it was measured.

    Attributes:
        label: the topic's part of the names of measures.
        rate: how many messages a second are expected, Hz; None for any number.
        problem: why nothing can be heard; empty where something can.
        times: when each message arrived, s on the run's clock.
        sizes: of each, bytes.
        ages: of each at its arrival, s; NaN where it has no stamp.
        sequence: the numbers of those that have any.
    """

    label: str
    rate: float | None
    problem: str = ""
    times: array[float] = field(default_factory=lambda: array("d"))
    sizes: array[int] = field(default_factory=lambda: array("q"))
    ages: array[float] = field(default_factory=lambda: array("d"))
    sequence: array[int] = field(default_factory=lambda: array("q"))

    def take(self, time: float, message: RawMessage, header: HeaderReader) -> None:
        """Note a message that arrived at this time of the run's clock."""
        stamp = header.read(message.data)
        self.times.append(time)
        self.sizes.append(len(message.data))
        self.ages.append(math.nan if stamp.time_ns is None else (message.received_ns - stamp.time_ns) / 1e9)
        if stamp.sequence is not None:
            self.sequence.append(stamp.sequence)

    @property
    def known_ages(self) -> list[float]:
        """The ages of the messages that have a stamp, s."""
        return [age for age in self.ages if math.isfinite(age)]

    @property
    def is_ahead(self) -> bool:
        """Whether a message was stamped after it arrived, so that two clocks differ."""
        return min(self.known_ages, default=0.0) < -_AHEAD

    def quality(self, window: Window) -> SampleQuality:
        """Return how evenly the messages came over the window."""
        # Where no rate is expected, the one that was had is taken: what is left to be doubted is its evenness.
        rate = self.rate or max(len(self.times), 1) / (window.duration or 1.0)
        return quality_of(self.times, window, rate)

    def values(self, window: Window) -> Mapping[str, float | None]:
        """Return the measures of the window, without the topic's label."""
        ages = [] if self.is_ahead else self.known_ages
        jitter = self.quality(window).jitter
        seconds = window.duration
        return {
            "Rate": len(self.times) / seconds if seconds else None,
            "Bandwidth": sum(self.sizes) / seconds if seconds else None,
            "Age": math.fsum(ages) / len(ages) if ages else None,
            "MaxAge": max(ages, default=None),
            "Jitter": None if jitter is None else jitter.p95,
            DROPPED: missed(self.sequence),
        }

    def columns(self) -> list[Column]:
        """Return what is kept of each message."""
        columns = [
            Column("time_s", self.times),
            Column("size_B", self.sizes, "%d"),
            Column("age_s", [age if math.isfinite(age) else None for age in self.ages]),
        ]
        return [*columns, Column("sequence", self.sequence, "%d")] if len(self.sequence) else columns

    def doubts(self, quality: SampleQuality) -> Iterator[str]:
        """Yield what is doubtful, with figures."""
        if self.problem:
            yield self.problem
            return
        if self.rate is not None or not self.times:
            yield from quality.warnings()
        if self.is_ahead:
            yield f"a message was stamped {-min(self.known_ages):.3f} s after it arrived, so ages are not known"
