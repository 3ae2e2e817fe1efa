"""The time of a graph with a simulation: what is published on `/clock`."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, GraphEndpoint, RawMessage, RobotLink
from robot_runner.core.words import enumerated

_TOPIC = "/clock"
_TYPE = "rosgraph_msgs/Clock"
#: How long, in real seconds, the clock may stand still before a sleep on it is given up.
_PATIENCE = 5.0
#: A clock that goes back by more than this was reset, s; by less, messages overtook each other.
_RESET = 0.5
#: A clock that goes back, regains this share of that in one step, and goes back again within this time, s, is published
#: by two nodes: a simulator that was reset and then stood still for a moment does only the first two.
_REGAINED = 0.5
_TOGETHER = 5.0


class GraphClock:
    """A clock that shows the last time on the graph's own clock; it must be started before it is used.

    Where two nodes publish the time, the run fails, and from then on the later one is ignored. It counts as simulated:
    a graph publishes its time because that is not the real time.

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
        self._link = link
        self._fix = fix
        self._changed = threading.Condition()
        self._now = 0.0
        self._shown = 0.0
        self._offset = 0.0
        self._went_back, self._went_back_at, self._has_regained = 0.0, 0.0, False
        self._is_known = False
        self._are_several = False
        # As bytes: those wait for no callback of the config, during which the run's time would stand still.
        self._subscription = link.subscribe_raw(_TOPIC, _TYPE, self._take)

    def start(self) -> None:
        """Return once the clock shows the graph's time; raise a `LinkError` if the time is not published."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._is_known, _PATIENCE):
                problem = f"the graph is to live by {_TOPIC}, and nothing came on it within {_PATIENCE:g} s"
                raise LinkError(problem, where="the graph's clock", fix=self._fix)

    def now(self) -> float:
        """Return the last time on the graph's clock, s; never goes back, even if a simulator is reset."""
        return self._now

    def shown(self) -> float:
        """Return the time that was published last, s; after a reset, the simulator's new time."""
        return self._shown

    def sleep(self, seconds: float) -> None:
        """Block until this many seconds have passed on the graph's clock; negative counts as zero.

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
                    problem = f"the graph's clock has stood still at {shown:.3f} s for {_PATIENCE:g} s"
                    raise LinkError(problem, where=_TOPIC, fix="Check whether the simulation goes on.")

    def close(self) -> None:
        """End the subscription; the clock keeps its last time."""
        self._subscription.close()

    def _take(self, message: RawMessage) -> None:
        seconds, nanoseconds = _stamp_in(message.data, self._link.encoding)
        shown = seconds + nanoseconds / 1e9
        with self._changed:
            step = shown - self._shown
            regains = step > self._went_back * _REGAINED and self._went_back > 0
            if regains and self._are_several:
                return
            is_new = step < -_RESET and self._goes_back(-step)
            self._has_regained = self._has_regained or regains
            if step < -_RESET:  # `now` goes on from its last time, with the steps of the simulator's new one
                self._offset = self._now - shown
            self._shown = shown
            self._now = max(self._now, shown + self._offset)
            self._is_known = True
            self._changed.notify_all()
        if is_new:
            raise self._several(-step)

    def _goes_back(self, by: float) -> bool:
        """Note that time went back by this much, s; return whether that is the first sign of several publishers."""
        before, self._went_back, self._went_back_at = self._went_back_at, by, time.monotonic()
        is_new = self._has_regained and self._went_back_at - before < _TOGETHER and not self._are_several
        self._are_several, self._has_regained = self._are_several or is_new, False
        return is_new

    def _several(self, step: float) -> LinkError:
        tellers: Sequence[GraphEndpoint] = ()
        with suppress(LinkError):  # a graph whose nodes cannot be listed
            tellers = self._link.publishers(_TOPIC)
        who = enumerated(sorted(map(str, tellers))) if len(tellers) > 1 else "more than one node"
        problem = f"{who} tell the graph's time: it goes back and forth by {step:.3f} s"
        return LinkError(problem, where=_TOPIC, fix="End all but one of them.")


def _stamp_in(data: bytes, encoding: Encoding) -> tuple[int, int]:
    """Return s and ns of a rosgraph_msgs/Clock; CDR begins with four bytes, of which the second has the byte order."""
    if encoding is Encoding.ROS1:
        layout, begin = "<II", 0
    else:
        layout, begin = "<iI" if data[1] & 1 else ">iI", 4
    seconds, nanoseconds = struct.unpack_from(layout, data, begin)
    return seconds, nanoseconds
