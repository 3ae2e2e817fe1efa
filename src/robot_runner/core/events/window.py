"""The measured window of a run, which is its mission, and the phases of the mission."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from robot_runner.core.errors import PluginError
from robot_runner.core.events.early_end import undivided


@dataclass(frozen=True, slots=True)
class Window:
    """The span of time of a measure.

    Attributes:
        start: its beginning, s on the run's clock.
        end: its end, s on the run's clock.

    Raises:
        PluginError: the end comes before the start, or one of them is not finite.

    Example:
        >>> Window(2.0, 97.0).duration
        95.0
    """

    start: float
    end: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start) and math.isfinite(self.end) and self.start <= self.end):
            fix = "Take both times from context.clock.now(), the earlier one first."
            raise PluginError(f"a window cannot reach from {self.start} s to {self.end} s", where="Window", fix=fix)

    @property
    def duration(self) -> float:
        """The seconds from its start to its end."""
        return self.end - self.start


@dataclass(frozen=True, slots=True)
class Phase:
    """A part of the mission; a mission may have several phases of one name.

    Example:
        >>> from robot_runner.plugins import Window
        >>> Phase("navigate", Window(2.0, 5.0)).window.duration
        3.0
    """

    name: str
    window: Window


class TimeSource(Protocol):
    """The part of `Clock` that is needed here; `context.py`, which has the whole, imports this module."""

    def now(self) -> float:
        """Return the seconds since some fixed moment; never goes back."""


class _Moment(NamedTuple):
    """One moment on the run's clock and on this machine's, s."""

    run: float
    machine: float


#: A phase's name is a part of a column's name, behind a dot.
_PHASE_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


def is_phase_name(value: object) -> bool:
    """Return whether a phase may have this name."""
    return isinstance(value, str) and _PHASE_NAME.fullmatch(value) is not None


class MissionTimes:
    """When the mission of a run, and each phase of it, began and ended.

    The measured window is the mission: from the emission of `launch_mission` until all its callbacks have returned.
    Each moment is taken on the run's clock and on this machine's: while the robot is simulated, profilers of this
    machine need the latter. `report` takes the window and each phase as records, times in s on the run's clock; for the
    `requested` phases measures are to be published.

    Example:
        >>> from robot_runner.testing import FakeClock
        >>> times = MissionTimes(FakeClock())
        >>> times.begin()
        >>> with times.phase("navigate"):
        ...     pass
        >>> times.end()
        >>> [phase.name for phase in times.phases()]
        ['navigate']
    """

    def __init__(
        self,
        clock: TimeSource,
        report: Callable[[str, dict[str, Any]], None] = lambda _kind, _fields: None,
        requested: Sequence[str] = (),
    ) -> None:
        self.requested = tuple(requested)
        self._clock = clock
        self._report = report
        self._begun: _Moment | None = None
        self._ended: _Moment | None = None
        self._narrowed: list[_Moment | None] = [None, None]
        self._phases: list[tuple[str, _Moment, _Moment]] = []
        self._open: dict[str, list[_Moment]] = {}
        self._at_edges: list[Callable[[], None]] = []
        self._is_stopped = False
        # Any thread may stop the mission or have a phase; re-entrant, as a signal handler may do so, too.
        self._lock = threading.RLock()

    def at_edges(self, look: Callable[[], None]) -> None:
        """Call `look` just before the mission begins, and just after it has ended; it must not raise.

        A meter that counts is then read at the edges of the window, however low its rate.
        """
        self._at_edges.append(look)

    def begin(self) -> None:
        """Begin the mission."""
        for look in self._at_edges:
            look()
        self._begun, self._ended, self._is_stopped = self._now(), None, False
        self._narrowed, self._phases, self._open = [None, None], [], {}

    def end(self, *, has_failed: bool = False) -> None:
        """End the mission, and with it the window; a second call does nothing.

        Where it `has_failed`, no readings are taken at the end: a meter that hangs must not delay the robot's stop.
        """
        if self._begun is None or self._ended is not None:
            return
        self._ended = self._now()
        window = self.window()
        for look in () if has_failed else self._at_edges:
            look()
        self._at_edges.clear()
        if window is not None:
            self._report("window", {"start": window.start, "end": window.end})

    def stop(self) -> bool:
        """End the window now, unless it has ended; return whether this call is the first to stop the mission.

        Raises:
            PluginError: the mission has not begun.
        """
        if self._begun is None:
            self._check_going_on("stop_mission")
        with self._lock:
            if self._ended is not None or self._is_stopped:
                return False
            self._is_stopped = True
            self._narrowed[1] = self._narrowed[1] or self._now()
            return True

    def begin_window(self) -> None:
        """Begin the window here instead of at the beginning of the mission.

        Raises:
            PluginError: no mission is going on, or the window has ended.
        """
        self._narrow(0)

    def end_window(self) -> None:
        """End the window here instead of at the end of the mission; where it has ended, nothing happens.

        Raises:
            PluginError: no mission is going on.
        """
        self._narrow(1)

    @property
    def is_narrowed(self) -> bool:
        """Whether `begin_window` or `end_window` was called in the mission, and nothing has stopped it."""
        return self._narrowed != [None, None] and not self._is_stopped

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Take the `with` block for a phase of the mission, also when it raises; overlapping blocks are one phase.

        Raises:
            PluginError: no phase can have this name, or no mission is going on.
        """
        if not is_phase_name(name):
            fix = "Use letters, digits, '_' and '-' (64 at most)."
            raise PluginError(f"a phase cannot be named {name!r}", where="phase", fix=fix)
        self._check_going_on(f"phase {name!r}")
        phases, beginnings = self._phases, self._open.setdefault(name, [])
        now = self._now()  # not under the lock: a clock may wait for a thread that wants it
        with self._lock:
            beginnings.append(now)
        try:
            yield
        finally:
            ended = self._now()
            with self._lock:
                begun = beginnings[0]
                beginnings.pop()  # the first one stays until all have ended
                is_over = not beginnings
            if is_over:
                with undivided:
                    phases.append((name, begun, ended))
                    self._report("phase", {"name": name, "start": begun.run, "end": ended.run})

    def window(self, clock: TimeSource | None = None) -> Window | None:
        """Return the measured window; None while the mission has not ended.

        Args:
            clock: None or the run's clock for times on that; any other for times on this machine's monotonic clock.
        """
        if self._begun is None or self._ended is None:
            return None
        start, end = self._narrowed[0] or self._begun, self._narrowed[1] or self._ended
        return self._between(start, end, clock)

    def phases(self, clock: TimeSource | None = None) -> tuple[Phase, ...]:
        """Return the phases that are over, in the order of their ends, on a clock as `window` takes it."""
        return tuple(Phase(name, self._between(begun, ended, clock)) for name, begun, ended in self._phases)

    def _narrow(self, edge: int) -> None:
        self._check_going_on("window")
        if self._is_stopped:
            return  # it ended when the mission was stopped
        if self._narrowed[1] is None:
            self._narrowed[edge] = self._now()
        elif edge == 0:
            fix = "A mission has one window: begin it before it ends, and measure several parts as phases."
            raise PluginError("the window has ended already", where="window", fix=fix)

    def _check_going_on(self, where: str) -> None:
        if self._begun is None or self._ended is not None:
            fix = "Call it in a callback of launch_mission."
            raise PluginError("there is no mission going on", where=where, fix=fix)

    def _between(self, begun: _Moment, ended: _Moment, clock: TimeSource | None) -> Window:
        if clock is None or clock is self._clock:
            return Window(begun.run, ended.run)
        return Window(begun.machine, ended.machine)

    def _now(self) -> _Moment:
        return _Moment(self._clock.now(), time.monotonic())
