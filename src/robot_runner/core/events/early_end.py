"""Ending a run or its mission early: by a callback, or by an exception in a thread."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator, contextmanager
from typing import Protocol, Self


class RunInterrupted(BaseException):
    """Raised in a run's callback when the run is to stop. A BaseException, so that callbacks do not swallow it."""

    def __init__(self, reason: str = "the run was told to end") -> None:
        super().__init__(reason)


class RunFailed(RunInterrupted):
    """Raised in the callback that is being executed when `context.fail` is called, with its reason."""


class MissionStopped(RunInterrupted):
    """Raised in the mission when `context.stop_mission` is called, with its reason: the run is not failed."""


class Ending(Protocol):
    """Ends a run, or its mission, from any of its threads."""

    @property
    def has_failed(self) -> bool:
        """Whether the run has failed, so that closing must not take long."""

    def fail(self, owner: str, reason: str) -> None:
        """Fail the run and end what it is doing."""

    def stop_mission(self, owner: str, reason: str) -> None:
        """End the mission. It must be going on, and not have been stopped before."""


class EndingInPlace:
    """Ends the callback that asks for it and nothing else: for contexts outside a run's process.

    Example:
        >>> EndingInPlace().fail("Guard", "too warm")
        Traceback (most recent call last):
        robot_runner.core.events.early_end.RunFailed: too warm
    """

    has_failed = False

    def fail(self, owner: str, reason: str) -> None:
        """Raise the reason as a `RunFailed`."""
        del owner
        raise RunFailed(reason)

    def stop_mission(self, owner: str, reason: str) -> None:
        """Raise the reason as a `MissionStopped`."""
        del owner
        raise MissionStopped(reason)


class Undivided(ContextDecorator):
    """Lets a request to end the run, or its mission, wait for the end of a block of the main thread.

    Such a request is raised wherever the main thread is, by the handler of a signal. What would be wrong half done
    belongs in such a block, which must be short and hang nowhere: it calls no user's code.

    Example:
        >>> with undivided:
        ...     undivided.hold(lambda: print("the end is asked for"))
        ...     print("the last step")
        True
        the last step
        the end is asked for
    """

    def __init__(self) -> None:
        self._depth = 0
        self._held: Callable[[], None] | None = None

    def __enter__(self) -> Self:
        if _is_main_thread():
            self._depth += 1
        return self

    def __exit__(self, *raised: object) -> None:
        if not _is_main_thread():
            return
        self._depth -= 1
        if not self._depth and self._held is not None:
            held, self._held = self._held, None
            held()

    @property
    def is_entered(self) -> bool:
        """Whether this is the main thread, in such a block."""
        return self._depth > 0 and _is_main_thread()

    def hold(self, request: Callable[[], None]) -> bool:
        """Return whether the main thread is in such a block; `request` is called at its end then."""
        if self.is_entered:
            self._held = request
        return self.is_entered


#: The one for all blocks: `with undivided:`, or `@undivided` above a function.
undivided = Undivided()


def _is_main_thread() -> bool:
    return threading.get_ident() == threading.main_thread().ident


#: Takes an exception, and where it was raised, such as `the callback of /scan`.
HandOver = Callable[[BaseException, str], None]

# Global, as a process executes one run at a time: links and samplers need no reference to it.
_run: tuple[int, HandOver] | None = None


@contextmanager
def fails_run(hand_over: HandOver) -> Iterator[None]:
    """Let `hand_over` take the exceptions of threads of this process that nothing else handles, for a while."""
    global _run  # noqa: PLW0603 - as `threading.excepthook`, whose place it takes where a thread has to go on
    earlier, _run = _run, (os.getpid(), hand_over)
    try:
        yield
    finally:
        _run = earlier


def raised_in_thread(error: BaseException, where: str) -> bool:
    """Fail the run of this process for an exception that a thread has caught.

    A thread that ends with the exception need not call this: `threading.excepthook` does. It is for a thread that goes
    on, such as one that calls callbacks.

    Args:
        error: what was raised.
        where: what raised it, as the subject of "... raised ValueError": `the callback of /scan`.

    Returns:
        whether there is a run; else the caller has to keep the exception or to log it.
    """
    if _run is None or _run[0] != os.getpid():  # a process that the run forked is not the run
        return False
    _run[1](error, where)
    return True
