"""Notice that this machine was suspended, or that its clock was set, while a run was executed.

Spans are measured on the monotonic clock, which stands still while the machine is suspended: a robot that drives on
draws energy that no sample shows, in a window that seems to be whole. Time stamps are of the clock that can be set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from robot_runner.core.errors import Finding

#: The owner of findings about clocks, where those of plugins have the plugin's name.
CLOCKS = "clocks"

#: Smaller changes are ignored, s. Slewing (NTP) causes none: it moves all clocks of Linux together.
_LEAST = 0.1
#: Where reading the clocks took longer, s, as this process was interrupted, they are read again, up to so many times.
_AT_ONCE, _TRIES = 0.005, 10


def now_counting_suspension() -> float:
    """Return the time of the steady clock that goes on while this machine is suspended, s.

    A poll or sleep does not count suspension: to wait for a moment of this clock, look at it again and again.
    """
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class _Ahead(NamedTuple):
    """How far a clock is ahead of another one, s."""

    counting_suspension: float
    can_be_set: float


class ClockJumps:
    """How this machine's clocks have moved against each other since this was made.

    Example:
        >>> jumps = ClockJumps()
        >>> jumps.suspended, jumps.was_set
        (0.0, 0.0)
    """

    def __init__(self) -> None:
        self._before = _ahead()

    @property
    def suspended(self) -> float:
        """For how long the machine has been suspended since, s; 0 where the system cannot tell (macOS)."""
        return _real(_ahead().counting_suspension - self._before.counting_suspension)

    @property
    def was_set(self) -> float:
        """By how much the clock of time stamps was set since, s."""
        return _real(_ahead().can_be_set - self._before.can_be_set)

    def taken_setting(self) -> float:
        """Return by how much the clock of time stamps was set since the last call, s.

        Smaller differences are dropped: where this clock alone is slewed (macOS), they would add up over hours.
        """
        now = _ahead()
        seconds = _real(now.can_be_set - self._before.can_be_set)
        self._before = now
        return seconds


def told_setting(seconds: float) -> tuple[str, str]:
    """Return problem and fix where the clock of time stamps was set by so many seconds."""
    problem = f"this machine's clock was set by {seconds:+,.1f} s: stamps before and after do not fit together"
    return problem, "Set it before the experiment, and keep it so (chrony, systemd-timesyncd)."


class NotedSettings:
    """Notes in the journal by how much this machine's clock was set, so that durations across that can be computed.

    `note` keeps a record in the journal: its kind and fields.
    """

    def __init__(self, note: Callable[..., None]) -> None:
        self._note = note
        self._jumps = ClockJumps()
        self._set_since_finding = 0.0

    def take(self) -> None:
        """Record by how much the clock was set since the last call; call it often, as `status` computes with it."""
        seconds = self._jumps.taken_setting()
        if seconds:
            self._note("clock_set", seconds=round(seconds, 3))
            self._set_since_finding += seconds

    def look(self, run: str = "", told: Iterable[Finding] = ()) -> list[Finding]:
        """Do the same before records with new stamps are written; also record a finding if the clock was set.

        `run` begins or ends now; it is empty where the experiment ends. Where one of its own findings, `told`, is about
        clocks, none is added. Return the finding, or nothing.
        """
        self.take()
        seconds, self._set_since_finding = _real(self._set_since_finding), 0.0
        where = f"{run}, {CLOCKS}" if run else CLOCKS
        if not seconds or any(each.where == where for each in told):
            return []
        problem, fix = told_setting(seconds)
        self._note("finding", **({"run": run} if run else {}), owner=CLOCKS, problem=problem, fix=fix)
        return [Finding.warning(where, problem, fix)]


def _ahead() -> _Ahead:
    for _ in range(_TRIES):
        began = time.monotonic()
        since_boot, stamped = now_counting_suspension(), time.clock_gettime(time.CLOCK_REALTIME)
        if time.monotonic() - began < _AT_ONCE:
            break
    return _Ahead(since_boot - began, stamped - since_boot)


def _real(change: float) -> float:
    return change if abs(change) >= _LEAST else 0.0
