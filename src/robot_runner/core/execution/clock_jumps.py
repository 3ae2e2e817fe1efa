"""Whether this machine was suspended, or its clock was set, while a run was executed: its own clock tells of neither.

Spans are measured on the monotonic clock, which stands still while the machine is suspended: a robot that drives on
meanwhile draws energy that no sample shows, in a window that seems to be whole. Time stamps are those of the clock that
can be set.
"""

from __future__ import annotations

import time
from typing import NamedTuple

#: Changes are real from here on, s: a clock that is steered takes the others with it, so that they stay together.
_LEAST = 0.1
#: The clocks are read again where that took longer, s, as this process had to wait in between.
_AT_ONCE, _TRIES = 0.005, 10


class _Ahead(NamedTuple):
    """How far a clock is ahead of another one, s."""

    counting_suspension: float
    can_be_set: float


class ClockJumps:
    """How this machine's clocks stood to each other when this was made, and what has become of that since.

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


def _ahead() -> _Ahead:
    counting_suspension = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    for _ in range(_TRIES):
        began = time.monotonic()
        since_boot, stamped = time.clock_gettime(counting_suspension), time.clock_gettime(time.CLOCK_REALTIME)
        if time.monotonic() - began < _AT_ONCE:
            break
    return _Ahead(since_boot - began, stamped - since_boot)


def _real(change: float) -> float:
    return change if abs(change) >= _LEAST else 0.0
