"""The clock of a simulation: time passes only during a sleep on it."""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import undivided
from robot_runner.core.links.goals import ActionCanceled
from robot_runner.ros.missions.joint_missions import sleep_by, sleep_with_others

#: The grid of the simulation: physics, sensors and power are known at its points (5 ms).
STEP_NS = 5_000_000
STEPS_PER_SECOND = 200

_SECOND_NS = 1_000_000_000
#: In real time the simulation is at most this far ahead.
_PACE_NS = 20_000_000
#: How long, real s, a worker may compute between two sleeps on the clock.
_LONGEST_WORK = 60.0


def tick_time(number: int, rate: int) -> int:
    """Return the time (ns) of tick `number` at `rate` ticks a second, rounded up to the grid."""
    return -(-number * _SECOND_NS // (rate * STEP_NS)) * STEP_NS


class Ticker:
    """Calls a callback repeatedly on a simulated clock until it is closed.

    `due` returns the time (ns) of the n-th call; `number` is that of the first call that may be in the future.
    """

    def __init__(
        self, clock: SimulatedClock, due: Callable[[int], int], callback: Callable[[], None], *, number: int
    ) -> None:
        self._clock = clock
        self._due = due
        self._callback = callback
        self._number = number
        self._is_closed = False
        self._schedule()

    def close(self) -> None:
        """End the calls; closing twice does nothing."""
        self._is_closed = True

    def repeat(self) -> None:
        """Schedule the next call, as the clock asks for when it is about to make one."""
        if not self._is_closed:
            self._schedule()

    def _schedule(self) -> None:
        while (due_ns := self._due(self._number)) <= self._clock.now_ns:
            self._number += 1
        self._clock.schedule(due_ns, self._tick, self.repeat)

    def _tick(self) -> None:
        if not self._is_closed:
            self._callback()


class ClockWorker:
    """A thread on a simulated clock: it runs only while that clock is advanced, and no other thread runs then.

    So its actions have the same simulated times in each execution, whatever the load of the machine.
    """

    def __init__(self, clock: SimulatedClock, work: Callable[[], None]) -> None:
        self._clock = clock
        self._work = work
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._is_over, self._is_stopped = False, False
        self._thread = threading.Thread(target=self._run, name="simulated work", daemon=True)
        self._thread.start()
        clock.after(0.0, self._hand_over)

    def sleep(self, seconds: float) -> None:
        """Sleep so many simulated seconds in its own thread; raise an `ActionCanceled` if the worker was stopped."""
        if not self._is_stopped:
            # At least one nanosecond: time must pass for all others, too.
            self._clock.after(max(seconds, 1 / _SECOND_NS), self._hand_over)
            self._back.release()
            self._go.acquire()
        if self._is_stopped:
            raise ActionCanceled("the simulated time does not go on")

    def stop(self) -> None:
        """Make its sleep raise an exception, and wait for its end."""
        self._is_stopped = True
        if self._thread is not threading.current_thread():
            self._hand_over()

    def _hand_over(self) -> None:
        if self._is_over:
            return
        self._go.release()
        if not self._back.acquire(timeout=_LONGEST_WORK):
            problem = f"what lives by the simulated clock does not come back to it within {_LONGEST_WORK:g} s"
            fix = "Wait on the run's clock in it, and for nothing else."
            raise LinkError(problem, where="the simulated clock", fix=fix)

    def _run(self) -> None:
        sleep_by(self.sleep)
        self._go.acquire()
        try:
            if not self._is_stopped:
                self._work()
        finally:
            self._is_over = True
            self._back.release()


class SimulatedClock:
    """A clock that starts at 0 s and advances by sleeping on it; callbacks that are due are called during the sleep.

    Times are whole nanoseconds internally, so that many short sleeps add up exactly. With a `real_time_factor` a sleep
    takes its nominal time (1.0), half of it (2.0), and so on; without one it takes as long as the physics needs.

    Example:
        >>> clock = SimulatedClock()
        >>> clock.sleep(1.5)
        >>> clock.now()
        1.5
    """

    def __init__(self, real_time_factor: float | None = None) -> None:
        self._real_time_factor = real_time_factor
        self._now_ns = 0
        self._due: list[tuple[int, int, Callable[[], None], Callable[[], None]]] = []
        self._scheduled = 0
        self._sleeper: threading.Thread | None = None

    @property
    def now_ns(self) -> int:
        """The nanoseconds since the simulation began."""
        return self._now_ns

    @property
    def step(self) -> int:
        """The last point of the simulation's grid that is not in the future."""
        return self._now_ns // STEP_NS

    def now(self) -> float:
        """Return the seconds since the simulation began."""
        return self._now_ns / _SECOND_NS

    def sleep(self, seconds: float) -> None:
        """Sleep for this many simulated seconds; negative counts as zero.

        Raises:
            LinkError: a callback of this clock sleeps on it, or another thread does at the same time.
        """
        if sleep_with_others(seconds):
            return
        sleeper, here = self._sleeper, threading.current_thread()
        if sleeper is not None:
            problem = f"a callback slept {seconds} s on the simulated clock during another sleep on it"
            fix = "Note the message in the callback and return; sleep in the mission."
            if sleeper is not here:
                problem = f"the threads {sleeper.name} and {here.name} slept on the simulated clock at the same time"
                fix = "Have one thread sleep on it, the mission's; what goes on beside it can subscribe to a topic."
            raise LinkError(problem, where="the simulated clock", fix=fix)
        self._sleeper = here
        try:
            target_ns = self._now_ns + max(0, round(seconds * _SECOND_NS))
            if self._real_time_factor is None:
                self._move_to(target_ns)
            else:
                self._move_in_pace(target_ns, self._real_time_factor)
        finally:
            self._sleeper = None

    def every(self, rate: int, callback: Callable[[], None]) -> Ticker:
        """Call `callback` `rate` times a second, on the grid."""
        return Ticker(self, lambda number: tick_time(number, rate), callback, number=self._now_ns * rate // _SECOND_NS)

    def call_every(self, period: float, callback: Callable[[], None]) -> Ticker:
        """Call `callback` every `period` seconds from now on, not rounded to the grid."""
        begun_ns = self._now_ns
        return Ticker(self, lambda number: begun_ns + round(number * period * _SECOND_NS), callback, number=1)

    def after(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call `callback` once, in `seconds`; if zero, at the beginning of the next sleep."""
        self.schedule(self._now_ns + max(0, round(seconds * _SECOND_NS)), callback)

    def schedule(self, due_ns: int, callback: Callable[[], None], repeat: Callable[[], None] = lambda: None) -> None:
        """Call `callback` once, at this time, and `repeat` before; those of the same time in the order of these calls.

        Where a request to end the run keeps `callback` from being called, `repeat` has been.
        """
        self._scheduled += 1
        heapq.heappush(self._due, (due_ns, self._scheduled, callback, repeat))

    def work(self, work: Callable[[], None]) -> ClockWorker:
        """Start work in a thread that may sleep on this clock, at the beginning of the next sleep."""
        return ClockWorker(self, work)

    def _move_in_pace(self, target_ns: int, factor: float) -> None:
        began, began_ns = time.monotonic(), self._now_ns
        while self._now_ns < target_ns:
            self._move_to(min(self._now_ns + _PACE_NS, target_ns))
            ahead = (self._now_ns - began_ns) / _SECOND_NS / factor - (time.monotonic() - began)
            if ahead > 0:
                time.sleep(ahead)

    def _move_to(self, target_ns: int) -> None:
        while self._due and self._due[0][0] <= target_ns:
            with undivided:
                self._now_ns, _, callback, repeat = heapq.heappop(self._due)
                repeat()
            callback()
        self._now_ns = target_ns
