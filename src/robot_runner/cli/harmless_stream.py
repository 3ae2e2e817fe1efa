"""The one way of text to a terminal: no file, config or message of a robot can send it escape sequences."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable

from robot_runner.core.words import harmless

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from typing import Any, TextIO


class HarmlessStream:
    """A text stream that shows control characters and escape sequences instead of obeying them.

    Everything else of the stream is as it was. Who draws on a terminal (rich) writes past it, to `unguarded`.
    """

    def __init__(self, stream: TextIO) -> None:
        self.unguarded = unguarded(stream)

    def write(self, text: str) -> int:
        """Write a text that is made harmless; returns its length as it was handed over."""
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
    """A text stream that drops what cannot be written, and says so once; everything else of it is as it was."""

    def __init__(self, stream: TextIO, say: Callable[[str], object]) -> None:
        self._stream = stream
        self._say = say

    def write(self, text: str) -> int:
        """Write a text, or drop it; returns its length."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._drop(error)
            return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts, or drop them."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Hand what was written to the system, or drop it."""
        try:
            self._stream.flush()
        except OSError as error:
            self._drop(error)

    def close(self) -> None:
        """Leave it open: a callback that closes it takes it away from the screen, too."""
        self.flush()

    def _drop(self, error: OSError) -> None:
        let_go_of(self._stream)  # what is kept for it would fail each time, and at the end as well
        say, self._say = self._say, lambda _said: None
        if not isinstance(error, BrokenPipeError):  # `| head` has read enough
            say(f"output is dropped from here on ({error.strerror}); the experiment goes on\n")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class DroppedOutput:
    """While this lasts, what cannot be printed fails nothing: neither a callback that prints, nor a screen."""

    def __enter__(self) -> None:
        self._earlier = sys.stdout, sys.stderr
        sys.stderr = _lasting(sys.stderr, lambda _said: None)
        sys.stdout = self._stdout = _lasting(sys.stdout, sys.stderr.write)

    def __exit__(self, *raised: object) -> None:
        self._stdout.flush()
        sys.stdout, sys.stderr = self._earlier


def _lasting(stream: TextIO, say: Callable[[str], object]) -> Any:
    lasting: Any = _LastingStream(unguarded(stream), say)
    return HarmlessStream(lasting)


def unguarded(stream: Any) -> TextIO:
    """Return the stream itself, without what makes text harmless."""
    return stream.unguarded if isinstance(stream, HarmlessStream) else stream


def guard_streams() -> tuple[Any, Any]:
    """Have everything that this process prints made harmless; returns stdout and stderr as they were."""
    earlier = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (each and HarmlessStream(each) for each in earlier)
    return earlier
