"""The rules of `repeat_until`: how precisely a measure is to be known."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Self

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import DesignError, Finding, did_you_mean
from robot_runner.core.words import counted, exact, has_true_zero

#: The fewest repetitions at the first look: the spread of two values is too uncertain.
LEAST_REPETITIONS = 3
#: With fewer, the first interval is so wide that further repetitions are nearly always needed.
_ENOUGH_REPETITIONS = 5
#: For more looks the level hardly changes any more, and takes seconds to compute.
_MOST_REPETITIONS = 200

_TEXT = re.compile(r"\s*([0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*(\S.*?)?\s*")
_PERCENT = "%"


class PreciseOf(Enum):
    """The quantity that is to be known precisely.

    MEANS are those of each combination; DIFFERENCES are those between any two treatments of a factor, within
    repetitions.
    """

    MEANS = "means"
    DIFFERENCES = "differences"


@dataclass(frozen=True, slots=True, init=False)
class Precision:
    """Repeat all combinations until a measure is known this precisely.

    Attributes:
        measure: a numeric measure of the run table.
        half_width: half the width of the wanted 95 % interval, in the measure's unit, or in percent.
        is_relative: whether `half_width` is in percent of the mean; for differences, of the mean of both treatments.
        unit: of `half_width` as it was given; empty for the measure's.
        at_most: how often each combination is executed at most, all its runs together.
        of: what is to be known.

    Raises:
        DesignError: an attribute is invalid; `findings` lists all problems.

    Example:
        >>> rule = Precision("Energy", half_width="2 %", at_most=30)
        >>> rule.half_width, rule.is_relative, str(rule)
        (2.0, True, 'the mean of Energy in each combination is known to ± 2 %')
    """

    measure: str
    half_width: float
    is_relative: bool
    unit: str
    at_most: int
    of: PreciseOf

    def __init__(
        self, measure: str, *, half_width: str | float, at_most: int, of: PreciseOf | str = PreciseOf.MEANS
    ) -> None:
        """Take a half width such as `"2 %"`, `"5 J"` or `5`, and `of` as a member or by its value."""
        number, unit = _number_and_unit(half_width)
        kinds = {each.value: each for each in PreciseOf}
        kind = kinds.get(of, of) if isinstance(of, str) else of
        DesignError.refuse(_findings(measure, half_width, number, at_most, kind))
        given = (measure, number, unit == _PERCENT, "" if unit == _PERCENT else unit, at_most, kind)
        for name, value in zip(self.__slots__, given, strict=True):
            object.__setattr__(self, name, value)

    def __str__(self) -> str:
        """Return the goal in words."""
        what = (
            f"the mean of {self.measure} in each combination"
            if self.of is PreciseOf.MEANS
            else f"each difference of {self.measure} between treatments"
        )
        return f"{what} is known to ± {self.wanted_in_words}"

    @property
    def wanted_in_words(self) -> str:
        """The wanted half width with its unit."""
        unit = _PERCENT if self.is_relative else self.unit
        return f"{exact(self.half_width)} {unit}".strip()

    def as_mapping(self) -> dict[str, Any]:
        """Return the rule as plain data, for the manifest."""
        return {
            "measure": self.measure,
            "half_width": self.wanted_in_words,
            "at_most": self.at_most,
            "of": self.of.value,
        }

    @classmethod
    def of_mapping(cls, plain: Mapping[str, Any]) -> Self:
        """Return the rule that `as_mapping` made plain; other data raises any exception."""
        return cls(plain["measure"], half_width=plain["half_width"], at_most=plain["at_most"], of=plain["of"])


def most_repetitions(rules: Sequence[Precision]) -> int:
    """Return how often each combination is executed at most, until all rules are fulfilled or have given up."""
    return max((rule.at_most for rule in rules), default=0)


def rule_in_words(rules: Sequence[Precision], least: int) -> str:
    """Return in words until when combinations are repeated, and how often at least and at most; empty without rules."""
    if not rules:
        return ""
    until = " and ".join(dict.fromkeys(map(str, rules)))
    return f"until {until}; at least {least:,}, at most {most_repetitions(rules):,} repetitions"


def rules_as_mapping(rules: Sequence[Precision], least: int) -> dict[str, Any] | None:
    """Return the rules and how often combinations are executed at least, as plain data; None without rules."""
    return {"least": least, "rules": [rule.as_mapping() for rule in rules]} if rules else None


def rules_of_mapping(plain: object) -> tuple[tuple[Precision, ...], int]:
    """Return the inverse of `rules_as_mapping`: the rules, and the least number of repetitions.

    Raises:
        DesignError: the data is damaged.
    """
    if plain is None:
        return (), 0
    try:
        rules = plain["rules"]  # type: ignore[index]  # whatever it is, the answer is the same
        return tuple(map(Precision.of_mapping, rules)), int(plain["least"])  # type: ignore[index]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = f"the rules of repetition are damaged: {type(error).__name__}: {error}"
        raise DesignError(problem, where="repeat_until", fix="Restore the manifest from a backup.") from error


def precision_findings(
    where: str, rules: Sequence[Precision], repetitions: int, units: Mapping[str, str]
) -> Iterator[Finding]:
    """Yield findings on rules that do not fit the least number of repetitions, or the units of the measures."""
    if rules and repetitions < LEAST_REPETITIONS:
        problem = f"{counted(repetitions, 'repetition')} cannot show the spread, on which precision depends"
        yield Finding.error(where, problem, f"Plan repetitions={_ENOUGH_REPETITIONS} or more: that many are the least.")
    elif rules and repetitions < _ENOUGH_REPETITIONS:
        problem = f"with {repetitions} repetitions at the first look, its interval is very wide"
        yield Finding.warning(where, problem, f"Plan repetitions={_ENOUGH_REPETITIONS} or more.")
    for rule in rules:
        if rule.measure not in units:
            yield Finding.error(where, f"there is no measure {rule.measure!r}", did_you_mean(rule.measure, units))
        elif rule.unit and rule.unit != units[rule.measure]:
            unit = units[rule.measure] or "no unit"
            problem = f"half_width is {rule.wanted_in_words!r}, and {rule.measure} has {unit}"
            yield Finding.error(where, problem, f"Give it as a share ('2 %'), or in the measure's unit ({unit}).")
        elif rule.is_relative and not has_true_zero(unit := units[rule.measure]):
            problem = f"half_width is {rule.wanted_in_words!r}, and a percentage says nothing of values in {unit}"
            yield Finding.warning(where, problem, f"Give it in the measure's unit, such as '1 {unit}'.")
        if rule.at_most < repetitions:
            problem = f"at_most is {rule.at_most}, and {repetitions} repetitions are planned"
            yield Finding.error(where, problem, "Plan fewer repetitions, or allow more: at_most counts all of them.")


def _number_and_unit(half_width: object) -> tuple[float, str]:
    """Return number and unit of a half width; NaN where it has no number."""
    if isinstance(half_width, int | float) and not isinstance(half_width, bool):
        return float(half_width), ""
    found = _TEXT.fullmatch(half_width) if isinstance(half_width, str) else None
    return (float(found[1]), found[2] or "") if found else (math.nan, "")


def _findings(measure: object, half_width: object, number: float, at_most: object, of: object) -> Iterator[Finding]:
    where = f"Precision({measure!r})"
    if not isinstance(measure, str) or not measure.strip():
        yield Finding.error(where, f"the measure is {measure!r}", "Name a measure, such as 'Energy'.")
    if not (math.isfinite(number) and number > 0):
        fix = "Give a share of the mean ('2 %'), or a number above 0 in the measure's unit ('5 J')."
        yield Finding.error(where, f"half_width is {half_width!r}", fix)
    if not is_whole(at_most):
        yield Finding.error(where, f"at_most is {at_most!r}", "Give a whole number of repetitions.")
    elif not LEAST_REPETITIONS <= at_most <= _MOST_REPETITIONS:
        fix = f"Give {LEAST_REPETITIONS} to {_MOST_REPETITIONS} repetitions, all runs of a combination together."
        yield Finding.error(where, f"at_most is {at_most}", fix)
    if not isinstance(of, PreciseOf):
        yield Finding.error(where, f"of is {of!r}", did_you_mean(str(of), [each.value for each in PreciseOf]))
