"""Conditions made of others: all of them, any of them, not this one."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace

from robot_runner.conditions.bounds import Bound, contradictions
from robot_runner.core.errors import ConditionError, Finding
from robot_runner.core.events.condition import Condition, HeldFor, Look, LookAgain
from robot_runner.core.events.context import Clock, RobotRunnerContext


def all_of(*conditions: Condition) -> Condition:
    """Return the condition that all of these hold at the same look.

    Raises:
        ConditionError: there are none, or one is not a condition.

    Example:
        >>> from robot_runner import port_open, process_running
        >>> print(all_of(port_open(8080), process_running("talker")))
        (port 8080 is open and the process talker is there)
    """
    return _AllOf(conditions)


def any_of(*conditions: Condition) -> Condition:
    """Return the condition that at least one of these holds.

    Raises:
        ConditionError: there are none, or one is not a condition.
    """
    return _AnyOf(conditions)


def not_(condition: Condition) -> Condition:
    """Return the condition that this one does not hold.

    What cannot be reached or read does not hold either: `not_(port_open(22, host="robot"))` holds once the robot is
    gone, and so it does where its name is misspelt.

    Raises:
        ConditionError: it is not a condition.

    Example:
        >>> from robot_runner import port_open
        >>> print(not_(port_open(8080)))
        not (port 8080 is open)
    """
    return _Not((condition,))


def leaves(condition: Condition) -> Iterator[Condition]:
    """Yield the conditions of which this one is made and that are made of no others."""
    parts = list(condition.parts())
    if not parts:
        yield condition
    for part in parts:
        yield from leaves(part)


class _PacedClock:
    """The run's clock, but never faster than real time: for conditions inside and outside a simulation together."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def now(self) -> float:
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        """Sleep on the run's clock, and for at least as long in real time."""
        end = time.monotonic() + seconds
        self._clock.sleep(seconds)
        time.sleep(max(0.0, end - time.monotonic()))


class _Combined(Condition):
    """Other conditions, each looked at as often as its own `every_s` says."""

    _joint = ""

    def __init__(self, conditions: Sequence[Condition]) -> None:
        for each in conditions:
            if not isinstance(each, Condition):
                fix = "Give conditions, such as port_open(8080)."
                raise ConditionError(f"{each!r} is not a condition", where=type(self).__name__.strip("_"), fix=fix)
        if not conditions:
            raise ConditionError("there is no condition", where=type(self).__name__.strip("_"), fix="Give one or more.")
        self._parts = tuple(conditions)
        self.every_s = min(each.every_s for each in conditions)
        self.is_outside = all(each.is_outside for each in conditions)

    def __str__(self) -> str:
        return f"({self._joint.join(map(str, self._parts))})"

    def parts(self) -> Iterable[Condition]:
        return self._parts

    def check(self, robot: str | None) -> Iterable[Finding]:
        for part in self._parts:
            yield from part.check(robot)

    def clock(self, context: RobotRunnerContext) -> Clock:
        is_mixed = not self.is_outside and any(each.is_outside for each in leaves(self))
        return _PacedClock(context.clock) if is_mixed else super().clock(context)

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        clock = self.clock(context)
        looks = [_now_and_then(each.watch(context, opened), each.every_s, clock) for each in self._parts]
        return lambda: self._judge([look_again() for look_again in looks])

    def _seen(self, looks: Sequence[Look]) -> str:
        told = zip(self._parts, looks, strict=True)
        return "; ".join(f"{_subject(part)}{look.seen}" for part, look in told if look.seen)

    @abstractmethod
    def _judge(self, looks: Sequence[Look]) -> Look:
        """Return the combination of the looks at the parts."""


class _AllOf(_Combined):
    _joint = " and "

    def check(self, robot: str | None) -> Iterable[Finding]:
        yield from super().check(robot)
        yield from contradictions(self._conjuncts())

    def _conjuncts(self) -> Iterator[Condition]:
        """Yield the conditions that must hold at the same time, those of nested `all_of` included."""
        for part in self._parts:
            bare = part
            while isinstance(bare, HeldFor):
                bare = bare.condition
            if isinstance(bare, _AllOf):
                yield from bare._conjuncts()  # noqa: SLF001 - another of this class
            else:
                yield bare

    def _judge(self, looks: Sequence[Look]) -> Look:
        holds = all(look.holds for look in looks)
        is_known = all(look.is_known for look in looks) or any(look.is_known and not look.holds for look in looks)
        return Look(holds, self._seen(looks), is_known=is_known)


class _AnyOf(_Combined):
    _joint = " or "

    def _judge(self, looks: Sequence[Look]) -> Look:
        holds = any(look.holds for look in looks)
        return Look(holds, self._seen(looks), is_known=holds or all(look.is_known for look in looks))


class _Not(_Combined):
    def __str__(self) -> str:
        return f"not ({self._parts[0]})"

    def check(self, robot: str | None) -> Iterable[Finding]:
        """Yield why the condition cannot be looked at; that it can never hold is no problem here."""
        for leaf in leaves(self):
            yield from leaf.quantity.check(robot) if isinstance(leaf, Bound) else leaf.check(robot)

    def _judge(self, looks: Sequence[Look]) -> Look:
        (look,) = looks
        return replace(look, holds=look.is_known and not look.holds)


def _subject(condition: Condition) -> str:
    """Return the name of the quantity of a condition; empty where it is not about a single one."""
    one, *others = leaves(condition)
    return f"{one.quantity}: " if isinstance(one, Bound) and not others else ""


def _now_and_then(look_again: LookAgain, every_s: float, clock: Clock) -> LookAgain:
    """Return a function that looks at most every `every_s`, and returns the last look in between."""
    due, last = clock.now(), Look(holds=False, is_known=False)

    def look() -> Look:
        nonlocal due, last
        now = clock.now()
        if now >= due:
            last, due = look_again(), now + every_s
        return last

    return look
