"""Where text goes: coloured on a terminal, plain elsewhere; what a user wrote is never taken for markup."""

from __future__ import annotations

import json
import os
import sys
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "UserConsole",
    "complaints",
    "is_live_terminal",
    "no_byte_code",
    "output",
    "print_json",
    "quiet_loading",
    "shown_path",
]

#: Wide enough that nothing is folded where nobody looks at a screen.
_UNLIMITED = 100_000


class UserConsole(Console):
    """A rich console that shows text as it is."""

    def __init__(self, stream: TextIO) -> None:
        width = None if stream.isatty() else _UNLIMITED
        super().__init__(file=stream, width=width, highlight=False, markup=False, emoji=False, soft_wrap=False)

    def on_broken_pipe(self) -> None:
        """Leave it to whoever called: a command may have more to do than to print.

        Raises:
            BrokenPipeError: the one that was raised.
        """
        raise  # noqa: PLE0704 - rich calls this while it handles the error


def output() -> UserConsole:
    """Return the console for what was asked for."""
    return UserConsole(sys.stdout)


def complaints() -> UserConsole:
    """Return the console for what went wrong."""
    return UserConsole(sys.stderr)


def is_live_terminal(stream: TextIO) -> bool:
    """Whether lines on it can be drawn again."""
    return stream.isatty() and os.environ.get("TERM", "dumb") not in {"dumb", "unknown"}


def print_json(facts: Any) -> None:
    """Print facts as JSON."""
    print(json.dumps(facts, indent=2, ensure_ascii=False, default=str))


def shown_path(path: Path) -> str:
    """Return a path as short as it still works when it is pasted into a shell here.

    Example:
        >>> shown_path(Path.cwd() / "results")
        'results'
    """
    try:
        relative = path.relative_to(Path.cwd())
    except (ValueError, OSError):
        return str(path)
    return str(relative)


@contextmanager
def no_byte_code() -> Iterator[None]:
    """While a config is looked at, no byte code is written beside the modules that it imports."""
    earlier = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        sys.dont_write_bytecode = earlier


@contextmanager
def quiet_loading() -> Iterator[None]:
    """While a config is looked at, what its code prints goes to stderr, and nothing is written beside it."""
    with no_byte_code(), redirect_stdout(sys.stderr):
        yield
