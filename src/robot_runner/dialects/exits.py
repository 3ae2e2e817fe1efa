"""Config files that end their program while they are loaded."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["exits_raised"]


@contextmanager
def exits_raised() -> Iterator[None]:
    """Have `os._exit`, with which some configs end their program, raise: this process is not theirs to end.

    Raises:
        SystemExit: it was called in this process.
    """
    end, own_process = os._exit, os.getpid()

    def exit_or_raise(status: int = 0) -> NoReturn:
        if os.getpid() != own_process:  # a process that the config forked
            end(status)
        raise SystemExit(status)

    os._exit = exit_or_raise
    try:
        yield
    finally:
        os._exit = end
