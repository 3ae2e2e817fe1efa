"""The clock that a run lives by: the machine's own, or that of a simulated robot."""

from __future__ import annotations

import time
from typing import Protocol, runtime_checkable

__all__ = ["Clock", "SystemClock"]


@runtime_checkable
class Clock(Protocol):
    """Time as the robot lives it: a mission that sleeps on it works on a real and on a simulated robot."""

    def now(self) -> float:
        """Return the seconds since some fixed moment; never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let this many seconds of the clock go by; negative counts as zero."""
        ...


class SystemClock:
    """The monotonic clock of this machine."""

    def now(self) -> float:
        """Return the seconds of the machine's monotonic clock."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Block the calling thread for this many real seconds."""
        if seconds > 0:
            time.sleep(seconds)
