"""Links and devices that the plugins of one run share, and the protocol of a host."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, cast, runtime_checkable

from robot_runner.core.events.early_end import undivided


class Closable(Protocol):
    """Anything that is closed once it is no longer needed."""

    def close(self) -> None:
        """Release the resource."""


@runtime_checkable
class Halting(Protocol):
    """A link that may have set something in motion: all of these are halted before anything is closed."""

    def halt(self) -> None:
        """Command a standstill and cancel goals without waiting; a failure is raised by `close`."""


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
        self._lock = threading.RLock()  # missions that go on together may open something at the same time
        self.fault: BaseException | None = None  # what closing has raised

    def open(self, key: str, opener: Callable[[], R]) -> R:
        """Return the resource under `key`, opened if it was not; it is closed with the run."""
        with self._lock:
            if key not in self._opened:
                opened = opener()
                with undivided:
                    self._opened[key] = opened
                    self._closing.callback(opened.close)
            return cast("R", self._opened[key])

    def close(self) -> None:
        """Halt what is `Halting`, then close all in reverse order; errors are raised once all are closed."""
        for each in self._opened.values():
            if isinstance(each, Halting):
                self._closing.callback(each.halt)
        self._opened.clear()
        try:
            self._closing.close()
        except BaseException as error:
            self.fault = error
            raise


#: What is open in this process beside the resources of its run.
_opened_here: set[Resources] = set()
os.register_at_fork(after_in_child=_opened_here.clear)


@contextmanager
def opened_here() -> Iterator[Resources]:
    """Yield resources of one's own, which are closed at the end of the block, or of the run that left it open.

    Where that fails, as a robot cannot be told to stand still, it fails at the end of the run once more.
    """
    resources = Resources()
    _opened_here.add(resources)
    try:
        yield resources
    finally:
        resources.close()
        _opened_here.discard(resources)


@contextmanager
def closing_left_open() -> Iterator[None]:
    """Close resources of `opened_here` that are still open at the end of this block; errors are raised at the end.

    So are those of resources whose closing has failed before: whatever a callback does about them, the run has to know.
    """
    before = set(_opened_here)
    try:
        yield
    finally:
        with ExitStack() as closing_all:
            for each in _opened_here - before:
                closing_all.callback(_close_again, each)


def _close_again(resources: Resources) -> None:
    resources.close()
    if resources.fault is not None:
        raise resources.fault


@dataclass(frozen=True, slots=True)
class CommandResult:
    """How a command on a host ended.

    Attributes:
        command: as it was given to the host's shell.
        exit_status: 0 for success.
        output: what it wrote to its standard output.
        errors: what it wrote to its standard error.
        seconds: how long it took, s of real time, the network included.
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
            command: a text for the shell, or a list of words that are quoted for it.
            timeout_s: how long it may take, s; then it is ended, with what it started.
            check: whether an exit status other than 0 is an error.

        Raises:
            CommandError: it took too long, or failed and `check` is true; the problem has its last lines.
            LinkError: the host cannot be reached, or has gone away.
        """

    def copy_to(self, source: Path | str, destination: str, *, timeout_s: float = 60.0) -> None:
        """Copy a file, or a folder with all that is in it, to the host, and replace what is there.

        Args:
            source: on this machine; links inside a folder are copied as links.
            destination: its path there; the folders above it are made.
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
