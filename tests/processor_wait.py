"""How long processes waited for a processor: time in which nobody can keep a promise about seconds."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

#: Returns how long each thread of the process that evaluates it has waited so far, s; for the configs of tests.
OWN_WAITS = """{
    path.parent.name: int(path.read_text().split()[1]) / 1e9 for path in Path("/proc/self/task").glob("*/schedstat")
}"""


def family() -> list[int]:
    """Return this process and all that descend from it."""
    return [os.getpid(), *(child.pid for child in psutil.Process().children(recursive=True))]


class ProcessorWait:
    """Adds up how long some processes, with all their threads, waited for a processor since it was made.

    Linux counts that for each thread: the second figure of schedstat, in ns (Documentation/scheduler/sched-stats.rst).
    Other than the pressure of the whole machine, it does not grow with what other processes lack.

    Args:
        pids: the processes.
    """

    def __init__(self, pids: Iterable[int]) -> None:
        self._pids = tuple(pids)
        self.restart()

    def restart(self) -> None:
        """Count from now on."""
        self._before = self._now()
        self._last = dict(self._before)

    def look(self) -> None:
        """Read the counters; what a process waited after the last look before its end is not known."""
        self._last |= self._now()

    def add(self, waits: Mapping[str, float]) -> None:
        """Add what a process told of itself (OWN_WAITS)."""
        self._last |= waits

    @property
    def seconds(self) -> float:
        """How long they waited until the last look, s."""
        return sum(waited - self._before.get(thread, 0.0) for thread, waited in self._last.items())

    def _now(self) -> dict[str, float]:
        waits = {}
        for pid in self._pids:
            with suppress(OSError):  # the process has ended
                for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
                    with suppress(OSError):  # the thread has ended
                        waits[path.parent.name] = int(path.read_text("ascii").split()[1]) / 1e9
        return waits
