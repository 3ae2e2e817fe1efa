"""All text to the terminal passes through here: no file, config or message of a robot can send escape sequences."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable

from robot_runner.core.words import harmless

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from typing import Any, TextIO


class HarmlessStream:
    """A text stream that shows control characters and escape sequences instead of obeying them.

    Everything else of the stream is as it was. What draws on the terminal (rich) writes to `unguarded` instead.
    """

    def __init__(self, stream: TextIO) -> None:
        self.unguarded = unguarded(stream)

    def write(self, text: str) -> int:
        """Make a text harmless and write it; return its original length."""
        self.unguarded.write(harmless(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unguarded, name)


def let_go_of(stream: TextIO) -> None:
    """Point a standard stream at the null device, so that flushing its buffer cannot fail."""
    import os  # noqa: PLC0415 - for a quick --help

    try:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)
    except (OSError, ValueError):
        pass


class _LastingStream:
    """A text stream that drops text which cannot be written, and reports that once; otherwise unchanged."""

    def __init__(self, stream: TextIO, say: Callable[[str], object]) -> None:
        self._stream = stream
        self._say = say

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._drop(error)
            return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._drop(error)

    def close(self) -> None:
        """Do nothing: a callback that closed the stream would close it for the screen, too."""
        self.flush()

    def _drop(self, error: OSError) -> None:
        let_go_of(self._stream)  # else what is buffered would fail again at each write, and at exit
        say, self._say = self._say, lambda _said: None
        if not isinstance(error, BrokenPipeError):  # `| head` has read enough
            say(f"output is dropped from here on ({error.strerror}); the experiment goes on\n")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class DroppedOutput:
    """While this lasts, failing to print raises nothing: neither in a callback that prints, nor in a screen."""

    def __enter__(self) -> None:
        self._earlier = sys.stdout, sys.stderr
        sys.stdout = self._stdout = _lasting(sys.stdout, sys.stderr.write)

    def __exit__(self, *raised: object) -> None:
        self._stdout.flush()
        sys.stdout, sys.stderr = self._earlier


def _lasting(stream: TextIO, say: Callable[[str], object]) -> Any:
    lasting: Any = _LastingStream(unguarded(stream), say)
    return HarmlessStream(lasting)


def unguarded(stream: Any) -> TextIO:
    """Return the stream beneath a `HarmlessStream`."""
    return stream.unguarded if isinstance(stream, HarmlessStream) else stream


def guard_streams() -> tuple[Any, Any]:
    """Make everything that this process prints harmless; return stdout and stderr as they were.

    What cannot be written to stderr is dropped: a log file on a full disk ends no command, and changes no exit code.
    """
    earlier = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = HarmlessStream(sys.stdout), _lasting(sys.stderr, lambda _said: None)
    return earlier
