"""What several plugins of one run share, opened once and closed when it ends; and what they can do on a host."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, cast, runtime_checkable


class Closable(Protocol):
    """Anything that is closed once it is no longer needed."""

    def close(self) -> None:
        """Let go of what is held."""


@runtime_checkable
class Halting(Protocol):
    """What may have set something in motion: all of these are halted before any of what was opened is closed."""

    def halt(self) -> None:
        """Command a standstill, ask for the end of goals, and wait for neither; what fails is told as it is closed."""


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
        """Halt what may move, then close everything in reverse order; faults are raised once all of it is closed."""
        for each in self._opened.values():
            if isinstance(each, Halting):
                self._closing.callback(each.halt)
        self._opened.clear()
        self._closing.close()


@dataclass(frozen=True, slots=True)
class CommandResult:
    """How a command on a host ended.

    Attributes:
        command: as it was given to the host's shell.
        exit_status: 0 where it says that all went well.
        output: what it wrote to its standard output.
        errors: what it wrote to its standard error.
        seconds: how long it took, s of real time, the way to the host included.
    """

    command: str
    exit_status: int
    output: str
    errors: str
    seconds: float

    @property
    def is_success(self) -> bool:
        """Whether the exit status is 0."""
        return self.exit_status == 0


class HostAccess(Protocol):
    """One host of the config's `hosts`, this machine or another one: the same contract for both.

    Commands are executed by the host's `sh`, and begin in the user's home folder. Deadlines are in real time, also
    where the robot is simulated.
    """

    def run(self, command: str | Sequence[str], *, timeout_s: float = 60.0, check: bool = True) -> CommandResult:
        """Execute a command to its end; what it writes is kept in the run's folder, in `<host>/commands.log`.

        Args:
            command: a text for the shell, or a list of words that are taken as they are.
            timeout_s: how long it may take, s; then it is ended, with what it started.
            check: whether an exit status other than 0 is an error.

        Raises:
            CommandError: it took too long, or failed and `check` is true; its last lines are told.
            LinkError: the host cannot be reached, or has gone away.
        """

    def copy_to(self, source: Path | str, destination: str, *, timeout_s: float = 60.0) -> None:
        """Copy a file, or a folder with all that is in it, to the host, and replace what stands there.

        Args:
            source: on this machine; links are not followed out of a folder, but copied as links.
            destination: the path that it is to have there; the folders above it are made.
            timeout_s: how long it may take, s.

        Raises:
            LinkError: it cannot be copied, or the host cannot be reached.
        """

    def fetch(self, *patterns: str, timeout_s: float = 60.0) -> list[Path]:
        """Fetch files into the run's folder, as `<host>/<path there>`; links are not followed.

        What matches nothing, is too large or cannot be read is a warning of the run.

        Args:
            patterns: absolute paths, or paths in the home folder (`~/...`), which may hold `*`, `?` and `[...]`; a
                folder is fetched with all that is in it.
            timeout_s: how long it may take, s; what has not come by then is a warning, too.

        Returns:
            the files that came.

        Raises:
            LinkError: the host cannot be reached.
        """
