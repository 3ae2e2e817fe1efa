"""Exceptions in threads: a run's process says what becomes of them, and whoever has threads hands them over."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["HandOver", "fails_run", "raised_in_thread"]

#: Takes an exception, and where it was raised, such as `the callback of /scan`.
HandOver = Callable[[BaseException, str], None]

# A process executes one run at a time; the links and samplers of that run need not be told which one.
_run: tuple[int, HandOver] | None = None


@contextmanager
def fails_run(hand_over: HandOver) -> Iterator[None]:
    """While this lasts, `hand_over` takes what is raised in the threads of this process where nobody awaits it."""
    global _run  # noqa: PLW0603 - as `threading.excepthook`, whose place it takes where a thread has to go on
    earlier, _run = _run, (os.getpid(), hand_over)
    try:
        yield
    finally:
        _run = earlier


def raised_in_thread(error: BaseException, where: str) -> bool:
    """Fail the run of this process for an exception that a thread caught, and that nobody awaits.

    A thread that ends with the exception need not call this: `threading.excepthook` does. It is for a thread that
    goes on, as one that calls back does.

    Args:
        error: what was raised.
        where: what raised it, as the subject of "... raised ValueError": `the callback of /scan`.

    Returns:
        whether there is a run that was told; else it is for the caller to keep the exception or to log it.
    """
    if _run is None or _run[0] != os.getpid():  # a process that the run forked is not the run
        return False
    _run[1](error, where)
    return True
