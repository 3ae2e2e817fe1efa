"""How the orchestrator waits: one poll for everything awaited, interruptions included, while screens are refreshed.

Whatever waits is written as *steps*: a generator that yields what it waits for, and is resumed once that is over. So
the steps of several runs go on side by side in a process without threads.
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import closing
from typing import TypeVar

from robot_runner.core.events.early_end import undivided
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.places import INTERRUPTED, Awaited, Places

#: Why nothing is awaited any more before a run.
NO_MORE_RUNS = "no more runs begin"
#: How often it is looked whether that is so, s.
_LISTEN = 0.2
_READABLE = select.POLLIN | select.POLLHUP | select.POLLERR
_Result = TypeVar("_Result")
#: A generator that yields what it waits for, and returns a result.
Steps = Generator[Awaited, None, _Result]


class Pause:
    """A span of time, which input from a terminal (the descriptor `user_input`) or an interruption ends early.

    Attributes:
        due: when it is over, on the monotonic clock, s.
        typed: what was read; empty at the end of the input, and None where nothing was.
    """

    def __init__(self, seconds: float, user_input: int | None = None) -> None:
        self.due: float | None = time.monotonic() + seconds
        self._input = user_input
        self._is_stopped = False
        self.typed: bytes | None = None

    @property
    def descriptors(self) -> Collection[int]:
        """The descriptor of the terminal, if there is one."""
        return () if self._input is None else (self._input,)

    def advance(self) -> bool:
        """Read the typed lines; return whether the pause is over."""
        if self._input is not None and select.select([self._input], [], [], 0)[0]:
            typed = os.read(self._input, 4096)
            if typed or _is_gone(self._input):  # else Ctrl-D, after which a terminal goes on
                self.typed = typed
                return True
        return self._is_stopped or self.due is None or time.monotonic() >= self.due

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """End it."""
        del because, is_interruption
        self._is_stopped, self.due = True, time.monotonic()

    def kill(self) -> None:
        """End it."""


def _is_gone(descriptor: int) -> bool:
    looking = select.poll()
    looking.register(descriptor, 0)  # what is always told: that the other end has hung up
    return bool(looking.poll(0))


class UntilEnding:
    """A wait before a run, which is stopped once no more runs begin."""

    def __init__(self, awaited: Awaited, is_ending: Callable[[], bool]) -> None:
        self._awaited = awaited
        self._is_ending = is_ending

    @property
    def descriptors(self) -> Collection[int]:
        """Those of the wait within."""
        return self._awaited.descriptors

    @property
    def due(self) -> float:
        """When to look again whether it is to end, or earlier, s."""
        look = time.monotonic() + _LISTEN
        return look if self._awaited.due is None else min(look, self._awaited.due)

    def advance(self) -> bool:
        """Stop the wait within where no more runs begin; return whether it is over."""
        if self._is_ending():
            self._awaited.stop(NO_MORE_RUNS)
        return self._awaited.advance()

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """Let it end soon."""
        self._awaited.stop(because, is_interruption=is_interruption)

    def kill(self) -> None:
        """End it at once."""
        self._awaited.kill()


def until_ending(steps: Steps[_Result], is_ending: Callable[[], bool]) -> Steps[_Result]:
    """Follow steps, and stop their waits once no more runs begin; return their result."""
    with closing(steps):
        while True:
            try:
                awaited = next(steps)
            except StopIteration as end:
                result: _Result = end.value
                return result
            yield UntilEnding(awaited, is_ending)


class PollLoop:
    """The work of the orchestrator while it waits.

    The interruption ends all that is awaited. `refresh` brings a live screen up to date every `refresh_interval` s, and
    never where that is None. `tend` is called before each wait, and returns in how many seconds it is to be called
    again, or None.
    """

    def __init__(
        self,
        interruption: Interruption,
        refresh: Callable[[], None] = lambda: None,
        refresh_interval: float | None = None,
        tend: Callable[[], float | None] = lambda: None,
    ) -> None:
        self.interruption = interruption
        self.refresh_interval = refresh_interval
        self._refresh = refresh
        self._tend = tend

    def refresh_screen(self) -> None:
        """Bring a live screen up to date, and call `tend`."""
        if self.refresh_interval is not None:
            self._refresh()
        with undivided:  # a callback may have called this, and what is written would be half done
            self._tend()

    def follow(self, steps: Steps[_Result]) -> _Result:
        """Execute steps, with nothing else beside them, and return their result."""
        try:
            while True:
                awaited = next(steps)
                while not self.turn([awaited]):
                    pass
        except StopIteration as end:
            result: _Result = end.value
            return result
        finally:
            steps.close()

    def turn(self, awaited: Sequence[Awaited], places: Places | None = None) -> list[Awaited]:
        """Wait until there is something to do, do it, and return what is over.

        The user's interruption stops all of them, and a second one kills them.
        """
        self._pass_interruption_on(awaited)
        self._wait(awaited, places)
        over = [each for each in awaited if each.advance()]
        self._pass_interruption_on([each for each in awaited if each not in over])
        if self.refresh_interval is not None:
            self._refresh()
        return over

    def _pass_interruption_on(self, awaited: Sequence[Awaited]) -> None:
        if self.interruption.is_requested:
            for each in awaited:
                each.stop(INTERRUPTED, is_interruption=True)
                if self.interruption.is_urgent:
                    each.kill()

    def _wait(self, awaited: Sequence[Awaited], places: Places | None) -> None:
        poll = select.poll()
        poll.register(self.interruption.descriptor, _READABLE)
        every: Sequence[Awaited | Places] = awaited if places is None else (*awaited, places)
        for each in every:
            for descriptor in each.descriptors:
                poll.register(descriptor, _READABLE)
        now = time.monotonic()
        waits = [due - now for each in every if (due := each.due) is not None]
        waits += [seconds for seconds in (self.refresh_interval, self._tend()) if seconds is not None]
        ready = poll.poll(_milliseconds(min(waits)) if waits else None)
        if any(descriptor == self.interruption.descriptor for descriptor, _ in ready):
            self.interruption.forget_wakeups()


def _milliseconds(seconds: float) -> float:
    """Return the timeout of a poll: a millisecond more, as poll may return a little before the moment that is due."""
    return seconds * 1000 + 1 if seconds > 0 else 0
