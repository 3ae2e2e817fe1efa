"""The time of a graph that lives by a simulation: what is published on `/clock`."""

from __future__ import annotations

import threading
import time

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Message, RobotLink

_TOPIC = "/clock"
_TYPE = "rosgraph_msgs/Clock"
#: How long, in real seconds, the clock may stand still before a sleep on it is given up.
_PATIENCE = 5.0
#: A clock that goes back by more than this, s, began again; less are messages that overtook each other.
_RESET = 0.5


class GraphClock:
    """A clock that shows what the graph's own clock showed last; it must be started before it is used.

    Attributes:
        is_simulated: always: a graph publishes its time because it is not that of the world.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> clock = GraphClock(link)
        >>> link.deliver("/clock", {"clock": {"sec": 12, "nanosec": 500000000}})
        >>> clock.now()
        12.5
    """

    is_simulated = True

    def __init__(self, link: RobotLink, *, fix: str = "Start the simulation.") -> None:
        self._fix = fix
        self._changed = threading.Condition()
        self._now = 0.0
        self._shown = 0.0
        self._offset = 0.0
        self._is_known = False
        self._subscription = link.subscribe(_TOPIC, _TYPE, self._take)

    def start(self) -> None:
        """Return once it shows the graph's time.

        Raises:
            LinkError: it is not published.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: self._is_known, _PATIENCE):
                raise LinkError(
                    f"the graph is to live by {_TOPIC}, and nothing came on it within {_PATIENCE:g} s",
                    where="the graph's clock",
                    fix=self._fix,
                )

    def now(self) -> float:
        """Return the seconds that the graph's clock showed last; never goes back, also where a simulator is reset."""
        return self._now

    def shown(self) -> float:
        """Return the seconds that were told last; after a reset, those of the simulator's new time."""
        return self._shown

    def sleep(self, seconds: float) -> None:
        """Block until this many seconds of the graph's clock have gone by; negative counts as zero.

        Raises:
            LinkError: the graph's clock stands still.
        """
        with self._changed:
            target, shown, seen = self._now + seconds, self._now, time.monotonic()
            while self._now < target:
                self._changed.wait(_PATIENCE)
                if self._now > shown:
                    shown, seen = self._now, time.monotonic()
                elif time.monotonic() - seen >= _PATIENCE:
                    raise LinkError(
                        f"the graph's clock has stood still at {shown:.3f} s for {_PATIENCE:g} s",
                        where=_TOPIC,
                        fix="Look whether the simulation goes on.",
                    )

    def close(self) -> None:
        """End the subscription; what it shows stays."""
        self._subscription.close()

    def _take(self, message: Message) -> None:
        stamp = message["clock"]
        shown = stamp["sec"] + stamp["nanosec"] / 1e9
        with self._changed:
            if shown < self._shown - _RESET:  # from where it stands, time goes on with the simulator's new one
                self._offset = self._now - shown
            self._shown = shown
            self._now = max(self._now, shown + self._offset)
            self._is_known = True
            self._changed.notify_all()
