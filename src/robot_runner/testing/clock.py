"""A clock that tests move."""

from __future__ import annotations

import heapq
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["FakeClock", "Repetition"]


class Repetition:
    """Something that a fake clock does again and again until it is closed."""

    def __init__(self) -> None:
        self.is_closed = False

    def close(self) -> None:
        """Do it no more; closing twice does nothing."""
        self.is_closed = True


class FakeClock:
    """A `Clock` on which time goes by only while it is slept on; what was scheduled happens on the way.

    Args:
        start: what it shows at first, s.

    Example:
        >>> clock = FakeClock(start=100.0)
        >>> clock.at(101.0, lambda: print("one second later"))
        >>> clock.sleep(5.0)
        one second later
        >>> clock.now()
        105.0
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()  # what is due at the same time happens in the order in which it was scheduled

    def now(self) -> float:
        """Return the seconds that it shows."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Move on; whatever a scheduled callback raises comes out of here."""
        target = self._now + max(seconds, 0.0)
        while self._due and self._due[0][0] <= target:
            self._now, _, callback = heapq.heappop(self._due)
            callback()
        self._now = max(self._now, target)

    def at(self, time: float, callback: Callable[[], None]) -> None:
        """Have `callback` called when the clock shows `time`, or at the next sleep if it does already."""
        heapq.heappush(self._due, (max(time, self._now), next(self._numbers), callback))

    def every(self, period: float, callback: Callable[[], None]) -> Repetition:
        """Have `callback` called every `period` seconds, first one period from now, until the result is closed."""
        repetition, begun = Repetition(), self._now

        def tick(number: int) -> None:
            if not repetition.is_closed:
                self.at(begun + (number + 1) * period, lambda: tick(number + 1))
                callback()

        self.at(begun + period, lambda: tick(1))
        return repetition

    call_every = every  # so that a `PeriodicSampler` takes its readings on this clock
