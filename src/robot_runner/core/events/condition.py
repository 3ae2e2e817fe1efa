"""Conditions, for callbacks and gates to await, and for guards to watch."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import ConditionError, ConditionTimeout, Finding
from robot_runner.core.events.context import Clock, RobotRunnerContext, SystemClock

#: A wait ends this early, s: on a simulated clock with longer steps, sleeping for the rest would never end.
_RESOLUTION = 1e-6
#: How often a wait reports what was seen, s of real time.
_TOLD_EVERY = 0.5


@dataclass(frozen=True, slots=True)
class Look:
    """The result of one look at a condition.

    Attributes:
        holds: whether the condition holds now.
        seen: what was seen, in words with figures, such as `52.3 °C`, or empty.
        value: the same as a plain value, where it is one.
        is_known: whether it is known if the condition holds: a battery without a message is neither full nor empty.
    """

    holds: bool
    seen: str = ""
    value: float | str | bool | None = None
    is_known: bool = True

    def __post_init__(self) -> None:
        # A bool of NumPy, or a number as `seen`, could not be read back from the journal.
        object.__setattr__(self, "holds", bool(self.holds))
        object.__setattr__(self, "seen", "" if self.seen is None else str(self.seen))


#: Looks at a condition that is being watched, again and again.
LookAgain = Callable[[], Look]


class Condition(ABC):
    """Something that holds or does not: a port is open, a CPU is below 50 °C, a person has said yes.

    A condition is plain data that may be used in any number of runs and processes; what a look needs (a connection, a
    subscription, when it began to hold) belongs to one `watch`. It is used in three ways: awaited by a callback
    (`wait`), between two runs (a gate), and watched during a run (a guard).

    Attributes:
        every_s: how often it is looked at, s of its clock.
        is_outside: whether it is about what goes on in real time even where the robot is simulated, such as a file, a
            process or another computer.

    Example:
        >>> from robot_runner import Look
        >>> class Always(Condition):
        ...     def __str__(self) -> str:
        ...         return "anything"
        ...     def watch(self, context, opened):
        ...         return lambda: Look(True, "all is well")
        >>> from pathlib import Path
        >>> from robot_runner.testing import make_context
        >>> Always().wait(make_context(Path("unused")), timeout_s=1.0).seen
        'all is well'
    """

    #: Short enough to end a mission in time, and long enough to cost next to nothing.
    every_s: float = 0.05
    is_outside: bool = False

    @abstractmethod
    def __str__(self) -> str:
        """Return the condition in words that complete the sentence "waiting until ...": `port 8080 is open`."""

    @abstractmethod
    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        """Begin to watch, and return a function that looks at the condition without waiting for long.

        What cannot be reached does not hold, and `seen` says why; a look raises only where waiting is in vain.

        Args:
            context: of the run during which, or before which, it is watched.
            opened: closes what is entered into it when the watching ends. Links and devices that a run shares are
                opened through `context.resources`, which closes them.
        """

    def check(self, robot: str | None) -> Iterable[Finding]:
        """Return findings on why this condition can never hold, as far as that is known before anything is executed.

        Args:
            robot: how the robot is reached, such as `"simulated"`, or None.
        """
        del robot
        return ()

    def parts(self) -> Iterable[Condition]:
        """Return the conditions of which this one is made."""
        return ()

    def clock(self, context: RobotRunnerContext) -> Clock:
        """Return the clock that a wait sleeps on: the run's, or this machine's for what goes on outside a simulation.

        A simulated mission of 95 s takes a few real ones, and a program needs its real second to start meanwhile.
        """
        return SystemClock() if self.is_outside else context.clock

    def held_for(self, seconds: float) -> Condition:
        """Return the condition that this one has held at each look for this long, s of its clock.

        Raises:
            ConditionError: the time is not positive.
        """
        if not (is_number(seconds) and seconds > 0):
            fix = "Give held_for a number of seconds above 0."
            raise ConditionError(f"nothing can hold for {seconds!r} s", where=str(self), fix=fix)
        return HeldFor(self, seconds)

    def wait(self, context: RobotRunnerContext, *, timeout_s: float) -> Look:
        """Wait until the condition holds, and record how long that took and the last look.

        Args:
            context: of the run; the wait sleeps on its clock, unless the condition `is_outside`.
            timeout_s: how long to wait at most, s of that clock.

        Returns:
            the look that found it to hold.

        Raises:
            ConditionTimeout: it did not hold in time; the problem says what was seen last.
            ConditionError: the time is not a number.
        """
        if isinstance(timeout_s, bool) or not isinstance(timeout_s, int | float) or math.isnan(timeout_s):
            raise ConditionError(f"timeout_s is {timeout_s!r}", where=str(self), fix="Give wait a number of seconds.")
        clock = self.clock(context)
        started, told = clock.now(), 0.0
        with ExitStack() as opened:
            look_again = self.watch(context, opened)
            while True:
                look = look_again()
                waited = clock.now() - started
                if look.holds or timeout_s - waited < _RESOLUTION:
                    break
                if time.monotonic() - told >= _TOLD_EVERY:
                    told = time.monotonic()
                    context.broker.note(context.owner, "waiting", self._facts(look, waited))
                clock.sleep(min(self.every_s, timeout_s - waited))
        context.broker.note(context.owner, "waited", {**self._facts(look, waited), "holds": look.holds})
        if look.holds:
            return look
        seen = f": {look.seen}" if look.seen else ""
        problem = f"after {timeout_s:g} s it still did not hold that {self}{seen}"
        fix = "Look at what is awaited, or allow it more time (timeout_s)."
        raise ConditionTimeout(problem, where=context.owner, fix=fix)

    def _facts(self, look: Look, waited: float) -> dict[str, Any]:
        return {"condition": str(self), "seen": look.seen, "seconds": round(waited, 3)}


@dataclass(frozen=True)
class HeldFor(Condition):
    """Another condition, which must have held for a while, as `Condition.held_for` makes it."""

    condition: Condition
    seconds: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "every_s", self.condition.every_s)
        object.__setattr__(self, "is_outside", self.condition.is_outside)

    def __str__(self) -> str:
        return f"{self.condition} for {self.seconds:g} s"

    def parts(self) -> Iterable[Condition]:
        """Return the other condition."""
        return (self.condition,)

    def check(self, robot: str | None) -> Iterable[Finding]:
        """Return the findings of the other condition."""
        return self.condition.check(robot)

    def clock(self, context: RobotRunnerContext) -> Clock:
        """Return the clock of the other condition."""
        return self.condition.clock(context)

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        """Watch the other condition, and since when it holds."""
        look_again, clock = self.condition.watch(context, opened), self.clock(context)
        since: float | None = None

        def look() -> Look:
            nonlocal since
            seen, now = look_again(), clock.now()
            since = None if not seen.holds else now if since is None else since
            if since is None:
                return seen
            held = now - since
            return replace(seen, holds=held >= self.seconds, seen=f"{seen.seen}, for {held:.1f} s".lstrip(", "))

        return look
