"""How long an event may take whose callbacks the orchestrating process executes itself: `event_deadline_in_s`.

A timer signal ends the callback, as a thread would have to be left behind. Python handles a signal between two of its
own instructions: it interrupts sleeping, waiting and I/O, but code in C that computes or that waits again after each
signal goes on. Nothing in this process can end that, so a watcher, a process of its own, ends the orchestrator then:
the experiment stops instead of hanging, and resumes where it was.
"""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress
from typing import TYPE_CHECKING, Self

from robot_runner.core.execution.processes import forked

if TYPE_CHECKING:
    from types import FrameType

__all__ = ["DeadlinePassed", "EventDeadline"]

#: How many times over `grace_in_s` a callback may take to end once its deadline has passed.
_PATIENCE = 3
#: Of a terminal; the live screen hides it.
_SHOW_CURSOR = "\x1b[?25h"


class DeadlinePassed(BaseException):
    """Raised in a callback that takes too long. A BaseException, so that callbacks do not swallow it."""


class EventDeadline:
    """Has `DeadlinePassed` raised in what is executed while it lasts, once that takes too long. A context manager.

    Where callbacks swallow the exception, it is raised again each `grace` seconds. Use it in the main thread.

    Args:
        what: the event that is guarded, in words.
        seconds: how long it may take.
        grace: how long what it ends may take to clean up, s.
    """

    def __init__(self, what: str, seconds: float, grace: float) -> None:
        self._what = what
        self._seconds = seconds
        self._grace = grace
        self._is_armed = False
        self._watcher = (0, -1)

    def __str__(self) -> str:
        return f"the event took longer than event_deadline_in_s = {self._seconds:g} s"

    def __enter__(self) -> Self:
        self._watcher = self._watch()
        self._earlier = signal.signal(signal.SIGALRM, self._take_signal)
        self._is_armed = True
        signal.setitimer(signal.ITIMER_REAL, self._seconds, self._grace)
        return self

    def __exit__(self, *raised: object) -> None:
        try:
            self._is_armed = False
        finally:  # also where the signal came right before this
            self._is_armed = False
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, self._earlier)
            self._dismiss_watcher()

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        if self._is_armed:
            raise DeadlinePassed(str(self))

    def _watch(self) -> tuple[int, int]:
        """Start the watcher; returns its process id, and the descriptor on which it is told that all is over."""
        reader, writer = os.pipe()
        watcher = forked()
        if watcher == 0:
            os.close(writer)
            self._end_orchestrator_unless_told(reader)
        os.close(reader)
        return watcher, writer

    def _dismiss_watcher(self) -> None:
        watcher, line = self._watcher
        with suppress(BrokenPipeError):  # somebody killed it
            os.write(line, b".")  # closing is not enough: a callback may have left a process that holds the line open
        os.close(line)
        with suppress(ChildProcessError):  # a callback waited for all children
            os.waitpid(watcher, 0)

    def _end_orchestrator_unless_told(self, reader: int) -> None:
        orchestrator = os.getppid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # the orchestrator decides
        told, _, _ = select.select([reader], [], [], self._seconds + _PATIENCE * self._grace)
        if not told and os.getppid() == orchestrator:
            with suppress(OSError):  # nobody reads it
                os.write(2, self._last_words().encode())
            os.kill(orchestrator, signal.SIGKILL)
        os._exit(0)

    def _last_words(self) -> str:
        cursor = _SHOW_CURSOR if os.isatty(2) else ""
        return (
            f"{cursor}\nerror: {self._what}: {self}, and code that is not Python's keeps it from being ended: the "
            "experiment is killed\n  fix: Mend this callback and start the experiment again: it resumes.\n"
        )
