"""Conditions of a quantity above or below a limit."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TypeAlias

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import ConditionError, Finding, LinkError
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext

#: The value of a quantity, in its unit, or a text that says why it is not known.
Reading: TypeAlias = float | str


class Quantity(ABC):
    """A number that can be read repeatedly. Quantities are compared by equality.

    Attributes:
        unit: of its values.
        low, high: the smallest and largest possible value.
        every_s: how often it is read, s.
        is_outside: as of the condition.
    """

    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    every_s: float = 0.05
    is_outside: bool = False

    @abstractmethod
    def __str__(self) -> str:
        """Return its name, as in `the temperature of this machine`."""

    @abstractmethod
    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Reading]:
        """Begin to watch, and return a function that reads it; its `LinkError` says why it cannot be read now."""

    def check(self, robot: str | None) -> Iterable[Finding]:
        """Return findings on why it can never be read."""
        del robot
        return ()


@dataclass(frozen=True)
class Bound(Condition):
    """A quantity above or below a limit.

    Attributes:
        is_below: whether the quantity must be below the limit, otherwise above.

    Raises:
        ConditionError: the limit is not a number.
    """

    quantity: Quantity
    limit: float
    is_below: bool

    def __post_init__(self) -> None:
        if not is_number(self.limit):
            problem = f"{self.limit!r} is not a limit"
            raise ConditionError(problem, where=str(self.quantity), fix="Give a finite number.")
        object.__setattr__(self, "every_s", self.quantity.every_s)
        object.__setattr__(self, "is_outside", self.quantity.is_outside)

    def __str__(self) -> str:
        return f"{self.quantity} is {'below' if self.is_below else 'above'} {_shown(self.limit, self.quantity.unit)}"

    def check(self, robot: str | None) -> Iterable[Finding]:
        """Return findings on why the quantity can never be read, or never be beyond the limit."""
        quantity, unit = self.quantity, self.quantity.unit
        yield from quantity.check(robot)
        edge = quantity.low if self.is_below else quantity.high
        if self.limit <= edge if self.is_below else self.limit >= edge:
            problem = f"{quantity} is never {'below' if self.is_below else 'above'} {_shown(self.limit, unit)}"
            lies = f"{_shown(quantity.low, unit)} and {_shown(quantity.high, unit)}"
            yield Finding.error(f"condition {str(self)!r}", problem, f"Choose a limit between {lies}.")
        if unit == "%" and 0 < self.limit < 1:  # ROS itself has a state of charge from 0 to 1
            fix = f"Limits are in percent. Give {100 * self.limit:g} if {100 * self.limit:g} % is meant."
            yield Finding.warning(f"condition {str(self)!r}", "its limit is less than 1 %", fix)

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        """Begin to watch the quantity."""
        read = self.quantity.watch(context, opened)

        def look() -> Look:
            try:
                reading = read()
            except LinkError as error:
                reading = error.problem
            # Infinite ranges are known: nothing is within reach, or something is too near to measure (REP 117).
            if isinstance(reading, str) or math.isnan(reading):
                seen = reading if isinstance(reading, str) else f"{self.quantity} is not known"
                return Look(holds=False, seen=seen, is_known=False)
            holds = reading < self.limit if self.is_below else reading > self.limit
            return Look(holds, _shown(reading, self.quantity.unit), reading)

        return look


def contradictions(conditions: Iterable[Condition]) -> Iterator[Finding]:
    """Yield an error for each quantity that is to be below one limit and above a higher one at the same time."""
    bounds = [each for each in conditions if isinstance(each, Bound)]
    for below in (each for each in bounds if each.is_below):
        for above in bounds:
            if not above.is_below and above.quantity == below.quantity and above.limit >= below.limit:
                problem = f"never are both true: {below}, and {above}"
                yield Finding.error(f"condition {str(below)!r}", problem, "Leave one of them out, or use any_of.")


def measure_above(name: str, limit: float) -> Condition:
    """Return the condition that a measure published in this run is above a limit.

    Args:
        name: the measure's column in the run table.
        limit: in the measure's unit.

    Raises:
        ConditionError: the limit is not a finite number.

    Example:
        >>> print(measure_above("Energy", 500))
        the measure Energy is above 500
    """
    return Bound(Measured(name), limit, is_below=False)


def measure_below(name: str, limit: float) -> Condition:
    """Return the condition that a measure published in this run is below a limit; as `measure_above`."""
    return Bound(Measured(name), limit, is_below=True)


@dataclass(frozen=True)
class Measured(Quantity):
    """A measure of the run."""

    name: str

    def __str__(self) -> str:
        return f"the measure {self.name}"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Reading]:
        """Return a function that reads it."""
        del opened

        def read() -> Reading:
            value = context.measures.get(self.name)
            if isinstance(value, int | float) and not isinstance(value, bool):
                return value
            return f"{self} {f'is {value!r}' if self.name in context.measures else 'was not published yet'}"

        return read


def _shown(value: float, unit: str) -> str:
    return f"{value:.6g} {unit}".rstrip()
