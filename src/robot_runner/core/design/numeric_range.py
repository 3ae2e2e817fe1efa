"""The range of a numeric factor: from a lower to an upper end, in steps, with a unit."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from typing import TypeGuard

from robot_runner.core.errors import DesignError, Finding

#: By default a range has about so many steps: finer than a robot can be set, and short texts in the table.
_STEPS = 1000
#: The smallest width: a thousandth of it is still a float.
_NARROWEST = 1e-300


@dataclass(frozen=True, slots=True)
class Range:
    """The values that a numeric factor may have; a design chooses among them, and without one they are the two ends.

    No design ever goes beyond the ends, which keep a robot safe.

    Attributes:
        lower: the smallest value.
        upper: the largest value; with a step, rounded down to a multiple of the step above `lower`.
        unit: of the values, such as `m/s`.
        step: values are `lower` plus a multiple of it. None for a thousandth of the width, or less; 1 where both ends
            are integers.

    Raises:
        DesignError: the ends or the step are invalid.

    Example:
        >>> Range(0.05, 0.22, unit="m/s").at(0.5), Range(0.05, 0.22, step=0.05).upper
        (0.135, 0.2)
    """

    lower: float
    upper: float
    unit: str = ""
    step: float | None = None

    def __post_init__(self) -> None:
        DesignError.refuse(self._findings())
        for name in ("lower", "upper", "step"):
            if isinstance(value := getattr(self, name), float):
                object.__setattr__(self, name, float(value))  # NumPy's numbers have another `repr`
        if self.step is not None and not (steps := round((self.upper - self.lower) / self.step, 6)).is_integer():
            last = round(self.lower + math.floor(steps) * self.step, max(_digits(self.lower), _digits(self.step)))
            object.__setattr__(self, "upper", type(self.upper)(last) if self.is_whole else float(last))

    @property
    def is_whole(self) -> bool:
        """Whether it has whole numbers only."""
        return all(isinstance(each, int) for each in (self.lower, self.upper, 1 if self.step is None else self.step))

    @property
    def in_words(self) -> str:
        """Its ends and its step, without the unit: `0.05 to 0.2 in steps of 0.05`."""
        return f"{self.lower} to {self.upper} in steps of {self._step}"

    def at(self, share: float) -> float:
        """Return the valid value nearest to `share` (0 to 1) of the way from the lower end to the upper one."""
        if self.step is None and share in {0, 1}:
            return self.upper if share else self.lower
        step = self._step
        exact = self.lower + (self.upper - self.lower) * share
        value = self.lower + round((exact - self.lower) / step) * step
        value = min(max(value, self.lower), self.upper)
        if self.is_whole:
            return round(value)
        return round(value, max(_digits(self.lower), _digits(self.upper), _digits(step)))

    def share_of(self, value: float) -> float:
        """Return the position of a value between the lower end, 0, and the upper one, 1."""
        return (value - self.lower) / (self.upper - self.lower)

    @property
    def step_count(self) -> int:
        """How many steps there are from end to end; with the default step, the last one may be shorter."""
        return max(1, math.ceil(round((self.upper - self.lower) / self._step, 6)))

    @property
    def _step(self) -> float:
        if self.step is not None:
            return self.step
        if self.is_whole:
            return 1
        return float(10.0 ** math.floor(math.log10((self.upper - self.lower) / _STEPS)))

    def _findings(self) -> Iterator[Finding]:
        numbers = {"lower": self.lower, "upper": self.upper} | ({} if self.step is None else {"step": self.step})
        wrong = [name for name, value in numbers.items() if not is_number(value)]
        for name in wrong:
            problem = f"{name} is {numbers[name]!r}, of type {type(numbers[name]).__name__}"
            yield Finding.error("Range", problem, "Give a finite number.")
        if not isinstance(self.unit, str):
            yield Finding.error("Range", f"the unit {self.unit!r} is not text", "Give it as in unit='m/s'.")
        if wrong:
            return
        if self.lower >= self.upper:
            problem = f"the lower end {self.lower} is not below the upper end {self.upper}"
            yield Finding.error("Range", problem, "Give the lower end first.")
        elif not _NARROWEST < self.upper - self.lower <= sys.float_info.max:
            problem = f"nothing can be set between {self.lower} and {self.upper}"
            yield Finding.error("Range", problem, "Give the values in another unit.")
        elif self.step is not None and not 0 < self.step <= self.upper - self.lower:
            problem = f"the step {self.step} does not fit between {self.lower} and {self.upper}"
            yield Finding.error("Range", problem, "Give a step above 0 that is no wider than the range.")


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a finite number, no boolean, and not beyond the largest float."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a whole number, and no boolean."""
    return isinstance(value, int) and not isinstance(value, bool)


def _digits(value: float) -> int:
    """Return how many decimals a number has, as Python writes it."""
    exponent = Decimal(repr(value)).normalize().as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0
