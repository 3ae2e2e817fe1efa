"""Stop requests: how signals and threads interrupt the callbacks of a run, and end the experiment before its time."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from types import FrameType
from typing import Self

from robot_runner.core.events.early_end import RunInterrupted, undivided
from robot_runner.core.execution.processes import begin_run_of_its_own, is_part

#: The signals that ask the orchestrator, or a run, to stop.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: Wakes the main thread of a run. It stands for urgent data on a socket, which hardly any program uses, and a process
#: without a handler ignores it.
_WAKE = signal.SIGURG

#: How much later a run is asked to stop once more, s. CPython checks for signals before a system call that sleeps or
#: waits: a signal that comes in between does not end that call, but the next one does.
ASK_AGAIN = 0.2

#: A terminal that closes sends SIGHUP twice in a row, and some shells repeat SIGTERM: within this many seconds, that
#: is one request and not two.
_SAME_REQUEST = 1.0


def stop_signals_to_handle() -> list[signal.Signals]:
    """Return the stop signals, without SIGHUP where it is ignored, as under `nohup`."""
    return [each for each in STOP_SIGNALS if each != signal.SIGHUP or signal.getsignal(each) is not signal.SIG_IGN]


def _of_this_process(handler: Callable[[int, FrameType | None], None]) -> Callable[[int, FrameType | None], None]:
    """Return a handler of the stop signals of this process, and of those that it forks as parts of the experiment.

    A process that a callback forks (`multiprocessing`) inherits the handler, but ends as if there were none.
    """
    process = os.getpid()

    def take(number: int, frame: FrameType | None) -> None:
        if os.getpid() == process or is_part():
            handler(number, frame)
        elif number == signal.SIGINT:
            signal.default_int_handler(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)

    return take


@contextmanager
def stop_signals_handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle the stop signals for a while, also where they were blocked.

    A parent process may have blocked them, and that is inherited: nobody could stop the robot then.
    """
    taken = _of_this_process(handler)
    earlier = {number: signal.signal(number, taken) for number in stop_signals_to_handle()}
    mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, earlier)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, before in reversed(earlier.items()):  # that of Ctrl-C last: what it raises leaves nothing undone
            signal.signal(number, before)


def ignore_broken_pipes() -> None:
    """Let writing to a pipe without a reader raise BrokenPipeError, as is Python's default, and not end this process.

    A config may have restored SIGPIPE, as filters do: a run whose orchestrator was killed would close nothing.
    """
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


class InterruptGate:
    """Lets a stop request end a callback, but never the closing of what callbacks opened.

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
        self.held_up: Callable[[FrameType | None], None] = lambda _frame: None

    def listen(self) -> None:
        """Handle the stop signals of this process, also those that came while they were blocked.

        Where the main thread goes on after one, `held_up` is called. Call this in the main thread of the run's process.
        """
        begin_run_of_its_own()
        ignore_broken_pipes()
        for number in STOP_SIGNALS:
            signal.signal(number, _of_this_process(self._take_signal))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)

    @contextmanager
    def woken_by_threads(self) -> Iterator[None]:
        """Let the requests of other threads interrupt the callbacks that this thread executes.

        Where this is not the process's main thread, a request waits for the next event: only the main thread of a
        Python process handles signals.
        """
        self._runner = threading.get_ident()
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        earlier = signal.signal(_WAKE, lambda _number, _frame: self._raise_request())
        mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, {_WAKE})  # a parent process may have blocked it
        earlier_hook, sys.unraisablehook = sys.unraisablehook, partial(self._ask_again, sys.unraisablehook)
        self._is_listening = True
        try:
            yield
        finally:
            self._is_listening = False
            sys.unraisablehook = earlier_hook
            signal.pthread_sigmask(signal.SIG_BLOCK, mask & {_WAKE})
            signal.signal(_WAKE, earlier)

    def arm(self, *, is_mission: bool = False) -> None:
        """Let stop requests raise from now on, until `disarm`; before and after, they wait.

        With `is_mission` the mission is executed now, which `end_mission` ends.

        Raises:
            RunInterrupted: a request comes, or came before.
        """
        self._armed, self._is_mission = True, is_mission
        self._raise_request()

    def disarm(self) -> None:
        """Let stop requests wait again."""
        self._armed = False

    def request(self, *, at_once: bool = False) -> None:
        """Ask to stop; with `at_once`, closing is interrupted, too. Call it in the thread that executes the run.

        Raises:
            RunInterrupted: a callback is being executed (or anything is, with `at_once`).
        """
        self._run_ends = self._run_ends or RunInterrupted()
        self._armed = self._armed or at_once
        self._raise_request()

    def end_run(self, error: RunInterrupted) -> None:
        """Raise `error` in the callback that is being executed; call it in any thread."""
        self._run_ends = self._run_ends or error
        self._wake()

    def end_mission(self, error: RunInterrupted) -> None:
        """Raise `error` in the mission, if it is still being executed; call it in any thread."""
        self._mission_ends = self._mission_ends or error
        self._wake()

    def _wake(self) -> None:
        if threading.get_ident() == self._runner:
            self._raise_request()
        elif self._is_listening:
            self._send_wake()
            self._wake_later()

    def _wake_later(self) -> None:
        again = threading.Timer(ASK_AGAIN, self._send_wake)
        again.daemon = True
        with suppress(RuntimeError):  # the system has no further thread: the first time has to do
            again.start()

    def _send_wake(self) -> None:
        if self._is_listening:
            signal.pthread_kill(self._runner, _WAKE)

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        del number
        self.request()
        if not undivided.is_entered:  # else it is raised at the end of that block
            self.held_up(frame)

    def _ask_again(self, otherwise: Callable[[sys.UnraisableHookArgs], object], lost: sys.UnraisableHookArgs) -> None:
        """Raise a request once more that Python dropped, as it does with all that is raised in a `__del__`."""
        if lost.exc_value is None or all(lost.exc_value is not each for each in (self._run_ends, self._mission_ends)):
            otherwise(lost)
            return
        self._wake_later()
        self._armed = True  # last: what is raised in this hook is dropped, too

    def _raise_request(self) -> None:
        error = self._run_ends or (self._mission_ends if self._is_mission else None)
        if self._armed and error is not None and not undivided.hold(self._raise_request):
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
        ignore_broken_pipes()
        with ExitStack() as opened:
            # First, and at the end last: meanwhile, Ctrl-C raises nothing that would leave a part of this behind.
            opened.enter_context(stop_signals_handled(self._count_signal))
            self._reader, self._writer = os.pipe()
            opened.callback(os.close, self._reader)
            opened.callback(os.close, self._writer)
            os.set_blocking(self._writer, False)
            os.set_blocking(self._reader, False)
            opened.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False))
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        self._opened.close()

    @contextmanager
    def passed_on(self, gate: InterruptGate) -> Iterator[None]:
        """Pass stop requests on to callbacks that this process executes itself, for a while."""
        self._gate = gate
        if self._count:  # one came right before
            gate.request()
        try:
            yield
        finally:
            self._gate = None

    def request(self) -> None:
        """Count a stop request that came in another way as if it were a signal."""
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
