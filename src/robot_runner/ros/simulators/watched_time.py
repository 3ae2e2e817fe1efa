"""The real-time factor of a simulator, by this machine's clock, and whether its time goes back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from robot_runner.core.links.robot import Message, RobotLink

CLOCK_TOPIC = "/clock"
_TYPE = "rosgraph_msgs/Clock"
#: The length of the slowest stretch, s of this machine: shorter ones depend on the network.
_STRETCH = 1.0


class WatchedTime:
    """Receives `/clock` from now on; `tell` is called with both times, s, if it goes back during the measurement.

    Attributes:
        factor: simulated seconds a real second, from the first to the last message of the measurement, or to its end
            if no message came in its last second; None if there were too few.
        slowest: the same over the slowest second; None likewise.
        earliest: the least simulated time received since `begin_reset`, s; None if there was none.
    """

    def __init__(self, link: RobotLink, tell: Callable[[float, float], object]) -> None:
        self._changed = threading.Condition()
        self._tell = tell
        self._now: float | None = None
        self._heard_at = 0.0
        self._is_measured = False
        self._first: tuple[float, float] | None = None
        self._stretch: tuple[float, float] | None = None
        self.factor: float | None = None
        self.slowest: float | None = None
        self.earliest: float | None = None
        self._subscription = link.subscribe(CLOCK_TOPIC, _TYPE, self._take, is_prompt=True)

    def now(self, *, timeout: float = 0.0) -> float | None:
        """Return the last simulated time, s; wait for the first, and return None if it does not come in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._now is not None, timeout)
            return self._now

    def begin_reset(self, *, timeout: float) -> float | None:
        """Return the same as `now`, and begin to look for the earliest time."""
        before = self.now(timeout=timeout)
        with self._changed:
            self.earliest = None
        return before

    def begin(self) -> None:
        """Measure from the next message on."""
        with self._changed:
            self._first = self._stretch = self.factor = self.slowest = None
            self._is_measured = True

    def end(self) -> None:
        """End the measurement; without recent messages, time counts as standing still since the last."""
        real = time.monotonic()
        with self._changed:
            if self._is_measured and self._now is not None and real - self._heard_at >= _STRETCH:
                self._measure(self._now, real)
            self._is_measured = False

    def close(self) -> None:
        """End the subscription; the results are kept."""
        self._subscription.close()

    def _take(self, message: Message) -> None:
        stamp, real = message["clock"], time.monotonic()
        simulated = stamp["sec"] + stamp["nanosec"] / 1e9
        with self._changed:
            before, self._now, self._heard_at = self._now, simulated, real
            self.earliest = simulated if self.earliest is None else min(self.earliest, simulated)
            self._changed.notify_all()
            is_measured = self._is_measured
            if is_measured:
                self._measure(simulated, real)
        if is_measured and before is not None and simulated < before:
            self._tell(before, simulated)

    def _measure(self, simulated: float, real: float) -> None:
        if self._first is None or self._stretch is None:
            self._first = self._stretch = (simulated, real)
            return
        if real > self._first[1]:
            self.factor = (simulated - self._first[0]) / (real - self._first[1])
        if real - self._stretch[1] >= _STRETCH:
            pace = (simulated - self._stretch[0]) / (real - self._stretch[1])
            self.slowest = pace if self.slowest is None else min(self.slowest, pace)
            self._stretch = (simulated, real)
