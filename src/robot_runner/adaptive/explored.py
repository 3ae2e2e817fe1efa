"""What a search has seen: the combinations that were executed, with their values, and which of them are best."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.factor import Combination
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import counted, enumerated, listed

#: Squares of larger values are beyond all numbers.
_LARGEST = 1e100


class Direction(Enum):
    """Which values of a measure are better."""

    MINIMISE = "minimise"
    MAXIMISE = "maximise"

    @property
    def sign(self) -> int:
        """What a value is multiplied by, so that less is better."""
        return 1 if self is Direction.MINIMISE else -1


@dataclass(slots=True)
class Explored:
    """A combination that was executed while it was searched.

    Attributes:
        values: of each measure, by its name, by repetition.
        repetition: the highest one, whether or not it confirms.
        has_failed: whether a run of the search yielded no value, and not because somebody left it out.
    """

    combination: Combination
    values: dict[str, dict[int, float]] = field(default_factory=dict)
    repetition: int = 0
    has_failed: bool = False

    @property
    def as_texts(self) -> dict[str, str]:
        """The combination, each treatment as text."""
        return {name: str(treatment) for name, treatment in self.combination.items()}

    def means(self, measures: Sequence[str]) -> tuple[float, ...] | None:
        """Return the mean of each measure; None where one of them has no value."""
        known = [self.values.get(name) for name in measures]
        return tuple(math.fsum(each.values()) / len(each) for each in known if each) if all(known) else None


def key_of(combination: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what tells a combination from others: its treatments as text."""
    return tuple(map(str, combination.values()))


def explored(told: Sequence[Told], measures: Sequence[str]) -> tuple[list[Explored], list[tuple[str, str]]]:
    """Return the combinations that were searched among, in the order in which they came up, and what is odd.

    Args:
        told: all runs; those of later batches confirm, and only their repetitions count here.
        measures: what is searched by.

    Returns:
        the combinations, and what is to be told of values that are no numbers, as problem and fix.
    """
    found: dict[tuple[str, ...], Explored] = {}
    odd = []
    for each in told:
        own = found.setdefault(key_of(each.run.combination), Explored(each.run.combination))
        own.repetition = max(own.repetition, each.run.repetition)
        if each.run.batch > 1:
            continue
        for name in measures:
            value = each.values.get(name)
            if is_number(value) and abs(value) <= _LARGEST:
                own.values.setdefault(name, {})[each.run.repetition] = float(value)
                continue
            own.has_failed |= not each.is_excluded
            if value is not None:
                why = "too large to compute with" if is_number(value) else f"which is no number of {name}"
                odd.append((f"{each.run.run_id} has {value!r}, {why}", "Name another measure."))
    searched = {key_of(each.run.combination) for each in told if each.run.batch == 1}
    return [each for key, each in found.items() if key in searched], odd


def best_of(points: Sequence[Explored], directions: Mapping[str, Direction]) -> list[Explored]:
    """Return the best combinations: the one with the best mean, or those that no other one beats in all measures."""
    measures = list(directions)
    signs = [directions[name].sign for name in measures]
    known = [
        (each, tuple(sign * mean for sign, mean in zip(signs, means, strict=True)))
        for each in points
        if (means := each.means(measures)) is not None
    ]
    found = [each for each, own in known if not any(_dominates(other, own) for _, other in known)]
    return found[:1] if len(measures) == 1 else found  # of equal means of one measure, the first


def _dominates(one: Sequence[float], other: Sequence[float]) -> bool:
    return one != other and all(mine <= its for mine, its in zip(one, other, strict=True))


def without_values(measures: Sequence[str]) -> tuple[str, str]:
    """Return what is told where no combination has a value, as problem and fix."""
    return f"no combination has a value of {enumerated(measures)}", "See why its runs failed, or yielded none."


def shown(combination: Mapping[str, Any]) -> str:
    """Return a combination in words."""
    return ", ".join(f"{name} {treatment}" for name, treatment in combination.items()) or "all runs"


def in_direction(name: str, direction: Direction) -> str:
    """Return what is searched for in words, such as `the least Energy`."""
    return f"the {'least' if direction is Direction.MINIMISE else 'most'} {name}"


def decided(name: str, words: str, facts: Mapping[str, Any], **more: Any) -> Decision:
    """Return a decision whose reason is said and kept in the same words."""
    return Decision(name=name, in_words=words, facts={"why": words, **facts}, **more)


# What comes after a search: runs that confirm what it found.


def confirmation(points: Sequence[Explored], often: int, known: str, facts: Mapping[str, Any]) -> Decision:
    """Return the decision to confirm what was found, by so many runs of each of these combinations."""
    # As written: each once, then all again.
    runs = [(each.combination, each.repetition + number) for number in range(1, often + 1) for each in points]
    what = listed(shown(each.combination) for each in points)
    words = f"{known}. Next: {counted(often, 'run')} each to confirm it, {what}"
    return decided("confirmation", words, facts, runs=runs, confirms=True)


# What is wrong with what was asked for.


def direction_findings(where: str, directions: object) -> Iterator[Finding]:
    """Say which measures or directions cannot be."""
    if not isinstance(directions, dict) or not directions:
        yield Finding.error(where, f"the measure is {directions!r}", "Name a measure, such as 'Energy'.")
        return
    words = [each.value for each in Direction]
    for name, direction in directions.items():
        if not isinstance(name, str) or not name.strip():
            yield Finding.error(where, f"the measure is {name!r}", "Name a measure, such as 'Energy'.")
        if not isinstance(direction, Direction) and direction not in words:
            problem = f"the direction of {name} is {direction!r}"
            yield Finding.error(where, problem, did_you_mean(str(direction), words))


def count_findings(where: str, least: int = 0, **counts: object) -> Iterator[Finding]:
    """Say which counts are no whole numbers from `least`."""
    for name, value in counts.items():
        if isinstance(value, bool) or not isinstance(value, int):
            yield Finding.error(where, f"{name} is {value!r}, of type {type(value).__name__}", "Give a whole number.")
        elif value < least:
            yield Finding.error(where, f"{name} is {value}", f"Give a whole number from {least}.")
