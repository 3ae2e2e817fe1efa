"""The one place by which text comes to a terminal: what is in a file, a config or a robot's message commands none."""

from __future__ import annotations

import sys

from robot_runner.core.words import harmless

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from collections.abc import Iterable
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

    def __iter__(self) -> Any:
        return iter(self.unguarded)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unguarded, name)


def unguarded(stream: Any) -> TextIO:
    """Return the stream itself, without what makes text harmless."""
    return stream.unguarded if isinstance(stream, HarmlessStream) else stream


def guard_streams() -> tuple[Any, Any]:
    """Have everything that this process prints made harmless; returns stdout and stderr as they were."""
    earlier = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (each and HarmlessStream(each) for each in earlier)
    return earlier
