"""What a search chooses from, none of it listed, and what it has seen: combinations with their values."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import chain, product
from math import prod
from random import Random
from typing import Any

from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.design import IsAllowed
from robot_runner.core.design.factor import Combination, Factor, factor_places
from robot_runner.core.design.numeric_range import is_number, is_whole
from robot_runner.core.design.planned_runs import RunOrder, arranged
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import INACTIVE, counted, enumerated, listed

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

    def means(self, measures: Sequence[str]) -> tuple[float, ...] | None:
        """Return the mean of each measure; None where one of them has no value."""
        known = [self.values.get(name) for name in measures]
        return tuple(math.fsum(each.values()) / len(each) for each in known if each) if all(known) else None


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
        own = found.setdefault(each.run.combination.texts, Explored(each.run.combination))
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
    searched = {each.run.combination.texts for each in told if each.run.batch == 1}
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
        if not is_whole(value):
            yield Finding.error(where, f"{name} is {value!r}, of type {type(value).__name__}", "Give a whole number.")
        elif value < least:
            yield Finding.error(where, f"{name} is {value}", f"Give a whole number from {least}.")


#: A combination as the place of each factor's treatment.
Places = tuple[int, ...]

#: How many combinations are drawn, at most, to find one that is allowed and new.
_DRAWS = 2000
#: A space of so many combinations is gone through, one by one, where drawing finds none.
_FEW = 20_000


class SearchedSpace:
    """What a search chooses from.

    Treatments that are numbers have places in ascending order, others as they are listed; a range has all its steps.

    Args:
        factors: what is varied.
        is_allowed: whether the exclusions leave a combination.

    Attributes:
        levels: the treatments of each factor, by place.
        are_numbers: whether those of each factor are numbers.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> space = SearchedSpace([Factor("Speed", [0.2, 0.1])], lambda combination: True)
        >>> space.combination((0,))["Speed"], space.places(space.combination((1,)))
        (0.1, (1,))
    """

    def __init__(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> None:
        self.are_numbers = [all(map(is_number, factor.treatments)) for factor in factors]
        self.levels: list[list[Any]] = [
            sorted(settings(factor)) if is_numeric else settings(factor)
            for factor, is_numeric in zip(factors, self.are_numbers, strict=True)
        ]
        self._is_allowed = is_allowed
        # Exclusions know the ends of a range and no step between them, so that its conditions are looked at here.
        self._conditions = [
            (factor.name, [(other, set(map(str, wanted))) for other, wanted in factor.when.items()])
            for factor in factors
            if factor.when
        ]
        self._names = factor_places(factor.name for factor in factors)
        self._place_of = [{str(level): place for place, level in enumerate(levels)} for levels in self.levels]

    @property
    def size(self) -> int:
        """How many combinations there are, those that are not allowed included."""
        return prod(map(len, self.levels))

    def combination(self, places: Places) -> Combination:
        """Return the combination of treatments at these places."""
        treatments = (levels[place] for levels, place in zip(self.levels, places, strict=True))
        return Combination(self._names, tuple(treatments))

    def places(self, combination: Combination) -> Places | None:
        """Return the places of a combination's treatments; None where the config has them no longer."""
        try:
            return tuple(own[str(each)] for own, each in zip(self._place_of, combination.treatments, strict=True))
        except KeyError:
            return None

    def is_allowed(self, places: Places) -> bool:
        """Return whether the exclusions leave this combination, and each factor applies where it has a treatment."""
        combination = self.combination(places)
        for name, conditions in self._conditions:
            holds = all(str(combination[other]) in wanted for other, wanted in conditions)
            if holds is (combination[name] is INACTIVE):
                return False
        return self._is_allowed(combination)

    def spread(self, count: int, seed: str) -> list[Places]:
        """Return so many combinations, spread over the space, or fewer where it has no more that are allowed.

        A Latin hypercube that reaches both ends of each factor: the best is often there.
        """
        if count < 2:  # noqa: PLR2004 - one combination has no ends
            return self._filled([], count, seed)
        seeds = [Random(f"{seed} {own}").getrandbits(32) for own in self._names]  # noqa: S311 - reproducible, not secret
        orders = [arranged(count, None, RunOrder(shuffle=True, seed=each)) for each in seeds]
        spread = [
            tuple(
                round(order[number] * (len(levels) - 1) / (count - 1))
                for order, levels in zip(orders, self.levels, strict=True)
            )
            for number in range(count)
        ]
        return self._filled([each for each in dict.fromkeys(spread) if self.is_allowed(each)], count, seed)

    def _filled(self, places: list[Places], count: int, seed: str) -> list[Places]:
        while len(places) < count and (found := self.another(places, f"{seed} {len(places)}")) is not None:
            places.append(found)
        return places

    def another(self, tried: Collection[Places], seed: str) -> Places | None:
        """Return any combination that is allowed and not among these; None where none is found."""
        draw = Random(seed).random  # noqa: S311 - reproducible, not secret
        drawn = (tuple(int(draw() * len(levels)) for levels in self.levels) for _ in range(_DRAWS))
        # The first factor changes first, as it always did: the same seed gives the same runs.
        listed = (each[::-1] for each in product(*(range(len(levels)) for levels in reversed(self.levels))))
        candidates = chain(drawn, listed) if self.size <= _FEW else drawn
        return next((each for each in candidates if each not in tried and self.is_allowed(each)), None)


def settings(factor: Factor) -> list[Any]:
    """Return what a factor can be set to: its treatments, or of a range all of its steps."""
    span = factor.range
    if span is None:
        return list(factor.treatments)
    own = dict(zip(factor.texts, factor.treatments, strict=True))  # its own objects: exclusions go by these
    steps = (span.at(number / span.step_count) for number in range(span.step_count + 1))
    found = {str(each): own.get(str(each), each) for each in steps}
    return [*found.values(), *(each for each in factor.treatments if each is INACTIVE)]


def baseline_findings(where: str, factors: Sequence[Factor], baseline: Mapping[str, Any]) -> Iterator[Finding]:
    """Say where a baseline is no combination of these factors."""
    known = {factor.name: factor for factor in factors}
    for name, treatment in baseline.items():
        if name not in known:
            yield Finding.error(where, f"the baseline names the factor {name!r}", did_you_mean(str(name), known))
            continue
        whole = known[name].with_treatments(settings(known[name]))
        if whole.position_of(treatment) is None:
            problem = f"the baseline has {treatment!r}, which is no treatment of {name}"
            yield Finding.error(where, problem, whole.suggestion(treatment))
    for factor in factors:
        if factor.name not in baseline and len(factor.treatments) > 1:
            problem = f"the baseline has no treatment of {factor.name}"
            yield Finding.error(where, problem, f"Add it, such as {factor.name!r}: {factor.treatments[0]!r}.")


def baseline_of(factors: Sequence[Factor], baseline: Mapping[str, Any]) -> Combination:
    """Return the combination that a baseline names, which has no findings; factors of one treatment need no mention."""
    treatments = []
    for factor in factors:
        whole = factor.with_treatments(settings(factor))
        place = whole.position_of(baseline.get(factor.name, factor.treatments[0])) or 0
        treatments.append(whole.treatments[place])
    return Combination(factor_places(factor.name for factor in factors), tuple(treatments))
