"""Whether this machine was suspended, or its clock was set, while a run was executed: its own clock tells of neither.

Spans are measured on the monotonic clock, which stands still while the machine is suspended: a robot that drives on
meanwhile draws energy that no sample shows, in a window that seems to be whole. Time stamps are those of the clock that
can be set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from robot_runner.core.errors import Finding

#: Who tells of clocks, among plugins and config.
CLOCKS = "clocks"

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

    def taken_setting(self) -> float:
        """Return by how much the clock of time stamps was set since this was asked last, s.

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
    """Has the journal tell by how much this machine's clock was set, so that times across that can be told.

    Args:
        note: keeps a record in the journal: its kind and fields.
    """

    def __init__(self, note: Callable[..., None]) -> None:
        self._note = note
        self._jumps = ClockJumps()

    def look(self, run: str, told: Iterable[Finding] = ()) -> list[Finding]:
        """Note by how much the clock was set since the last look, right before what is noted with later stamps.

        Args:
            run: the run that begins or ends now.
            told: what the run has told itself; that its clock was set is not told twice.

        Returns:
            what there is to tell.
        """
        seconds = self._jumps.taken_setting()
        if not seconds:
            return []
        self._note("clock_set", seconds=round(seconds, 3))
        where = f"{run}, {CLOCKS}"
        if any(each.where == where for each in told):
            return []
        problem, fix = told_setting(seconds)
        self._note("finding", run=run, owner=CLOCKS, problem=problem, fix=fix)
        return [Finding.warning(where, problem, fix)]


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
