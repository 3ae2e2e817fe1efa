"""What several plugins of one run share: opened once, closed in reverse order when the run ends."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Protocol, TypeVar, cast


class Closable(Protocol):
    """Anything that is closed once it is no longer needed."""

    def close(self) -> None:
        """Let go of what is held."""


R = TypeVar("R", bound=Closable)


class Resources:
    """The links and devices that a run has opened, by key.

    Example:
        >>> class Line:
        ...     def close(self) -> None:
        ...         print("closed")
        >>> with_line = Resources()
        >>> with_line.open("serial", Line) is with_line.open("serial", Line)
        True
        >>> with_line.close()
        closed
    """

    def __init__(self) -> None:
        self._opened: dict[str, Closable] = {}
        self._closing = ExitStack()
        self._lock = threading.RLock()  # systems that go on together open what they need at the same time

    def open(self, key: str, opener: Callable[[], R]) -> R:
        """Return what was opened under `key`, opening it first if it was not; it is closed with the run."""
        with self._lock:
            if key not in self._opened:
                opened = opener()
                self._opened[key] = opened
                self._closing.callback(opened.close)
            return cast("R", self._opened[key])

    def close(self) -> None:
        """Close everything in reverse order; what one of them raises is raised after all were closed."""
        self._opened.clear()
        self._closing.close()
