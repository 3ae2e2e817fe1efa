"""How a run and an orchestrator take a stop request: from signals, at moments at which nothing is lost by it."""

from __future__ import annotations

import os
import signal
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

from robot_runner.core.events.early_end import RunInterrupted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

__all__ = ["STOP_SIGNALS", "InterruptGate", "Interruption"]

#: The signals that ask the orchestrator, or a run, to stop.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: Wakes the main thread of a run. It tells of urgent data on a socket: hardly any program uses it, and a process that
#: does not expect it passes over it.
_WAKE = signal.SIGURG

#: A terminal that closes sends SIGHUP twice in a row, and some shells repeat SIGTERM: within this many seconds, that
#: is one request and not two.
_SAME_REQUEST = 1.0


class InterruptGate:
    """Lets a stop request end a callback, and never the closing of what callbacks opened.

    Requests come from signals, and from any thread that ends the run or its mission. A thread cannot raise anything in
    another one: it sends a signal to the main thread, whose handler does, also in a sleep, a wait or a join.
    """

    def __init__(self) -> None:
        self._armed = False
        self._is_mission = False
        self._runner = threading.get_ident()
        self._is_listening = False
        self._run_ends: RunInterrupted | None = None
        self._mission_ends: RunInterrupted | None = None

    def listen(self) -> None:
        """Take the stop signals of this process, also those that came while they were blocked.

        Call it in the main thread of the run's process.
        """
        for number in STOP_SIGNALS:
            signal.signal(number, self._take_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)

    @contextmanager
    def woken_by_threads(self) -> Iterator[None]:
        """While this lasts, what another thread asks for reaches the callback that this thread executes.

        Where this is not the process's main thread, the request waits for the next event: Python tells no other
        thread of signals.
        """
        self._runner = threading.get_ident()
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        earlier = signal.signal(_WAKE, lambda _number, _frame: self._raise_request())
        self._is_listening = True
        try:
            yield
        finally:
            self._is_listening = False
            signal.signal(_WAKE, earlier)

    def arm(self, *, is_mission: bool = False) -> None:
        """Have a stop request raised from now on, until `disarm`; before and after, it waits.

        Args:
            is_mission: whether what is executed now is what `end_mission` ends.

        Raises:
            RunInterrupted: a request comes, or came before.
        """
        self._armed, self._is_mission = True, is_mission
        self._raise_request()

    def disarm(self) -> None:
        """Have stop requests wait again."""
        self._armed = False

    def request(self, *, at_once: bool = False) -> None:
        """Ask to stop; `at_once` does not even wait for the closing. Call it in the thread that executes the run.

        Raises:
            RunInterrupted: a callback is being executed (or anything is, with `at_once`).
        """
        self._run_ends = self._run_ends or RunInterrupted()
        self._armed = self._armed or at_once
        self._raise_request()

    def end_run(self, error: RunInterrupted) -> None:
        """Have `error` raised in the callback that is being executed; call it in any thread."""
        self._run_ends = self._run_ends or error
        self._wake()

    def end_mission(self, error: RunInterrupted) -> None:
        """Have `error` raised in the mission, if it is still being executed; call it in any thread."""
        self._mission_ends = self._mission_ends or error
        self._wake()

    def _wake(self) -> None:
        if threading.get_ident() == self._runner:
            self._raise_request()
        elif self._is_listening:
            signal.pthread_kill(self._runner, _WAKE)

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.request()

    def _raise_request(self) -> None:
        error = self._run_ends or (self._mission_ends if self._is_mission else None)
        if self._armed and error is not None:
            self._armed = False  # once: what comes now is the closing
            raise error


class Interruption:
    """The stop requests that the orchestrator got by signals: Ctrl-C once ends cleanly, twice at once.

    A context manager: while it lasts, the stop signals are counted instead of raised, and wake a poll on
    `descriptor`.
    """

    def __init__(self) -> None:
        self._count = 0
        self._last = 0.0
        self._gate: InterruptGate | None = None
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

    def __enter__(self) -> Self:
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        os.set_blocking(self._reader, False)
        self._earlier_wakeup = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._earlier = {number: signal.signal(number, self._count_signal) for number in STOP_SIGNALS}
        return self

    def __exit__(self, *raised: object) -> None:
        for number, handler in self._earlier.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._earlier_wakeup)
        os.close(self._reader)
        os.close(self._writer)

    @contextmanager
    def passed_on(self, gate: InterruptGate) -> Iterator[None]:
        """While this lasts, stop requests are passed on to callbacks that this process executes itself."""
        self._gate = gate
        try:
            yield
        finally:
            self._gate = None

    def request(self) -> None:
        """Take a stop request that came in another way, as if it were a signal."""
        self._count_signal(signal.SIGINT, None)
        os.write(self._writer, b"\0")

    def forget_wakeups(self) -> None:
        """Empty the descriptor, so that the next poll waits again."""
        try:
            os.read(self._reader, 4096)
        except BlockingIOError:
            return

    def _count_signal(self, number: int, frame: FrameType | None) -> None:
        del frame
        now = time.monotonic()
        if self._count and number != signal.SIGINT and now - self._last < _SAME_REQUEST:
            return
        self._last = now
        self._count += 1
        self.first_signal = self.first_signal or number
        if self._gate is not None:
            self._gate.request(at_once=self._count > 1)
