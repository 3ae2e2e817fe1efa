"""The keyboard while a live screen is drawn: whoever reads a line of it gets a terminal on which nothing is drawn."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import TextIO


class _Keyboard:
    """Standard input that calls `give_way` before anybody waits for a line; everything else is as it was.

    `input()` comes by here as well: while rich redirects stdout, Python reads the line from `sys.stdin`.
    """

    def __init__(self, stream: TextIO, give_way: Callable[[], None]) -> None:
        self._stream = stream
        self._give_way = give_way

    def readline(self, *size: int) -> str:
        self._give_way()
        return self._stream.readline(*size)

    def read(self, *size: int) -> str:
        self._give_way()
        return self._stream.read(*size)

    def __iter__(self) -> Iterator[str]:
        return iter(self.readline, "")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def input_gives_way(give_way: Callable[[], None]) -> Iterator[None]:
    """While this lasts, `give_way` is called before a callback of this process reads what somebody types."""
    earlier = sys.stdin
    keyboard: Any = _Keyboard(earlier, give_way)
    sys.stdin = keyboard
    try:
        yield
    finally:
        sys.stdin = earlier
