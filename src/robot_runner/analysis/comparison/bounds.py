"""What difference would not matter: stated by the user, in the unit of the measure or as a share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["Bound", "Bounds"]

_PERCENT = 100.0


@dataclass(frozen=True, slots=True)
class Bound:
    """The largest difference that does not matter.

    Attributes:
        value: in the unit of the measure, or a percentage of the first experiment's mean.
        is_relative: whether it is a percentage.

    Raises:
        AnalysisError: it is not a finite number above 0, or not below 100 %.

    Example:
        >>> Bound.parse("5%")
        Bound(value=5.0, is_relative=True)
    """

    value: float
    is_relative: bool = False

    def __post_init__(self) -> None:
        is_sensible = math.isfinite(self.value) and self.value > 0
        if not is_sensible or (self.is_relative and self.value >= _PERCENT):
            raise AnalysisError(
                f"the bound is {self.value:g}{' %' if self.is_relative else ''}",
                where="bound",
                fix="Give a number above 0, or a percentage between 0 and 100: --bound 5%.",
            )

    @classmethod
    def parse(cls, text: str) -> Bound:
        """Read a bound, such as `10` or `5%`.

        Raises:
            AnalysisError: it is no number, or one that cannot be a bound.
        """
        is_relative = text.strip().endswith("%")
        try:
            value = float(text.strip().removesuffix("%"))
        except ValueError as error:
            fix = "Give a number in the measure's unit, or a percentage: --bound 10, or --bound 5%."
            raise AnalysisError(f"{text!r} is no bound", where="bound", fix=fix) from error
        return cls(value, is_relative)

    def in_units(self, mean: float) -> float:
        """Return the bound in the unit of the measure, where the first experiment has this mean."""
        return abs(mean) * self.value / _PERCENT if self.is_relative else self.value

    def __str__(self) -> str:
        return f"{self.value:g} %" if self.is_relative else f"{self.value:g}"


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of several measures.

    Attributes:
        general: for every measure that has none of its own; None where those have no bound.
        own: by measure.

    Example:
        >>> str(Bounds.parse(["5%", "Energy=10"]).of("Energy"))
        '10'
    """

    general: Bound | None
    own: Mapping[str, Bound]

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Bounds:
        """Read bounds, each as `5%` or `10`, or of one measure as `Energy=10`.

        Raises:
            AnalysisError: one cannot be read, or a measure has two.
        """
        general: Bound | None = None
        own: dict[str, Bound] = {}
        for text in texts:
            # The bound is a number, so what stands before the last = is the name, whatever it holds.
            name, equals, value = text.rpartition("=")
            if name in own or (not equals and general is not None):
                raise AnalysisError(f"{text!r} is a second bound", where="bound", fix="Leave one of them out.")
            if equals:
                own[name] = Bound.parse(value)
            else:
                general = Bound.parse(value)
        return cls(general, own)

    def of(self, measure: str) -> Bound | None:
        """Return the bound of a measure, if it has one."""
        return self.own.get(measure, self.general)
