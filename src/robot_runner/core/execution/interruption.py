"""How a run and an orchestrator are told to end: by signals, at moments when nothing is lost by it."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

__all__ = ["InterruptGate", "Interruption", "RunInterrupted"]


class RunInterrupted(BaseException):
    """Raised in a run's callback when the run is told to end. A BaseException, so that callbacks do not swallow it."""

    def __init__(self) -> None:
        super().__init__("the run was told to end")


class InterruptGate:
    """Lets a signal end a callback, and never the closing of what callbacks opened."""

    def __init__(self) -> None:
        self._armed = False
        self._requested = False

    def listen(self) -> None:
        """Take SIGTERM as the word to end. Call it in the main thread of the run's process."""
        inherited = _present
        if inherited is None:
            signal.signal(signal.SIGTERM, self._heard)
        else:  # forked: the orchestrator's handler came along; setting another would cost more than all else here
            inherited.become_run(self)

    def arm(self) -> None:
        """Have the word to end raised from now on, until `disarm`; before and after, it waits.

        Raises:
            RunInterrupted: the word was said, now or before.
        """
        self._armed = True
        if self._requested:
            self._raise()

    def disarm(self) -> None:
        """Have the word to end wait again."""
        self._armed = False

    def request(self, *, at_once: bool = False) -> None:
        """Say the word to end; `at_once` does not even wait for the closing.

        Raises:
            RunInterrupted: a callback is being executed (or anything is, with `at_once`).
        """
        self._requested = True
        if self._armed or at_once:
            self._raise()

    def _heard(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.request()

    def _raise(self) -> None:
        self._armed = False  # once: what comes now is the closing
        raise RunInterrupted


#: The orchestrator's, while it executes an experiment.
_present: Interruption | None = None


class Interruption:
    """What the orchestrator was told by signals: Ctrl-C once ends cleanly, twice at once.

    A context manager: while it lasts, SIGINT, SIGTERM and SIGHUP are counted instead of raised, and wake whoever
    polls `descriptor`.
    """

    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self._count = 0
        self._last = 0.0
        self._gate: InterruptGate | None = None
        self._is_run = False
        self.first_signal: int | None = None

    @property
    def is_requested(self) -> bool:
        """Whether the experiment is to end cleanly."""
        return self._count > 0

    @property
    def is_urgent(self) -> bool:
        """Whether the experiment is to end at once."""
        return self._count > 1

    @property
    def descriptor(self) -> int:
        """Readable once a signal came."""
        return self._reader

    def become_run(self, gate: InterruptGate) -> None:
        """Be the handler of a run's own process instead: the word to end goes to its gate."""
        self._is_run = True
        self._gate = gate

    def __enter__(self) -> Self:
        global _present  # noqa: PLW0603 - a process has one handler of each signal, and so one of these
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        os.set_blocking(self._reader, False)
        self._earlier_wakeup = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._earlier = {number: signal.signal(number, self._count_signal) for number in self.SIGNALS}
        _present = self
        return self

    def __exit__(self, *raised: object) -> None:
        global _present  # noqa: PLW0603 - as above
        _present = None
        for number, handler in self._earlier.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._earlier_wakeup)
        os.close(self._reader)
        os.close(self._writer)

    @contextmanager
    def passed_on(self, gate: InterruptGate) -> Iterator[None]:
        """While this lasts, the word to end is passed on to callbacks that this process executes itself."""
        self._gate = gate
        try:
            yield
        finally:
            self._gate = None

    def forget_wakeups(self) -> None:
        """Empty the descriptor, so that the next poll waits again."""
        try:
            os.read(self._reader, 4096)
        except BlockingIOError:
            return

    def _count_signal(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self._is_run:
            if self._gate is not None:
                self._gate.request()
            return
        # A terminal that closes sends SIGHUP twice in a row, and some shells repeat SIGTERM: that is one word, not two.
        now = time.monotonic()
        if self._count and number != signal.SIGINT and now - self._last < 1.0:
            return
        self._last = now
        self._count += 1
        self.first_signal = self.first_signal or number
        if self._gate is not None:
            self._gate.request(at_once=self._count > 1)
