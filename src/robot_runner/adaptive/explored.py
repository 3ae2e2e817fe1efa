"""The space of a search, which is not enumerated, and the combinations that were executed, with their values."""

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
from robot_runner.core.errors import DesignError, Finding, did_you_mean
from robot_runner.core.words import INACTIVE, counted, enumerated, listed

#: Larger values are refused, as their squares would overflow.
_LARGEST = 1e100


class Direction(Enum):
    """Which values of a measure are better."""

    MINIMISE = "minimise"
    MAXIMISE = "maximise"

    @property
    def sign(self) -> int:
        """The factor by which values are multiplied so that smaller is better."""
        return 1 if self is Direction.MINIMISE else -1


@dataclass(slots=True)
class Explored:
    """A combination that was executed in the search.

    Attributes:
        values: of each measure, by its name, by repetition.
        repetition: the highest one, those that confirm included.
        has_failed: whether a run of the search has no value although it was not excluded.
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
    """Return the executed combinations, in the order of their first runs, and warnings.

    Args:
        told: all runs; those of later batches confirm, and only their repetitions count here.
        measures: those of the search.

    Returns:
        the combinations, and problem and fix for values that are not numbers.
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
                why = "too large to compute with" if is_number(value) else "which is not a number"
                odd.append((f"{each.run.run_id} has {value!r} for {name}, {why}", "Name another measure."))
    searched = {each.run.combination.texts for each in told if each.run.batch == 1}
    return [each for key, each in found.items() if key in searched], odd


def best_of(points: Sequence[Explored], directions: Mapping[str, Direction]) -> list[Explored]:
    """Return the best combinations: the one with the best mean, or the Pareto front of several measures."""
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
    """Return problem and fix where no combination has a value."""
    return f"no combination has a value of {enumerated(measures)}", "See why its runs failed, or yielded none."


def shown(combination: Mapping[str, Any]) -> str:
    """Return a combination in words."""
    return ", ".join(f"{name} {treatment}" for name, treatment in combination.items()) or "all runs"


def in_direction(name: str, direction: Direction) -> str:
    """Return the aim of a search in words, such as `the least Energy`."""
    return f"the {'least' if direction is Direction.MINIMISE else 'most'} {name}"


def decided(name: str, words: str, facts: Mapping[str, Any], **more: Any) -> Decision:
    """Return a decision with its reason, for people and in its facts."""
    return Decision(name=name, in_words=words, facts={"why": words, **facts}, **more)


# Runs that confirm the result of a search.


def confirmation(points: Sequence[Explored], often: int, known: str, facts: Mapping[str, Any]) -> Decision:
    """Return the decision to confirm the result by `often` runs of each of these combinations."""
    # As written: each once, then all again.
    runs = [(each.combination, each.repetition + number) for number in range(1, often + 1) for each in points]
    what = listed(shown(each.combination) for each in points)
    words = f"{known}. Next: {counted(often, 'run')} each to confirm it, {what}"
    return decided("confirmation", words, facts, runs=runs, confirms=True)


def confirmed(told: Sequence[Told], found: Sequence[Explored], known: str) -> str:
    """Return what is known, with what the confirming runs are worth; they may be of what was the best before."""
    runs = [each for each in told if each.run.batch > 1]
    executed = {each.run.combination.texts: each.run.combination for each in runs}
    own = {each.combination.texts for each in found}
    if not own or not own <= executed.keys():
        return f"{known}. The confirming runs were of {listed(map(shown, executed.values()))}"
    if own <= {each.run.combination.texts for each in runs if each.values}:
        return f"{known}. The runs that confirm it are done"
    return f"{known}. The runs that were to confirm it have no value"


# Checks of arguments.


def direction_findings(where: str, directions: object) -> Iterator[Finding]:
    """Yield an error for each invalid measure or direction."""
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
    """Yield an error for each count that is not an integer of at least `least`."""
    for name, value in counts.items():
        if not is_whole(value):
            yield Finding.error(where, f"{name} is {value!r}, of type {type(value).__name__}", "Give a whole number.")
        elif value < least:
            yield Finding.error(where, f"{name} is {value}", f"Give a whole number from {least}.")


#: A combination as the index of each factor's treatment.
Places = tuple[int, ...]

#: How many combinations are drawn, at most, to find one that is allowed and new.
_DRAWS = 2000
#: A space with at most so many combinations is enumerated if drawing finds none.
_FEW = 20_000


class SearchedSpace:
    """The combinations from which a search chooses.

    Numbers have indices in ascending order, other treatments in their listed order; a range has all its steps. Of a
    conditional factor `INACTIVE` comes last.

    Args:
        factors: what is varied.
        is_allowed: returns whether a combination is not excluded.

    Attributes:
        levels: the treatments of each factor, by index.
        active: how many of them each factor has besides `INACTIVE`.
        are_numbers: whether those of each factor are numbers.
        conditions: the index of each conditional factor, behind those that it depends on; with the indices of these
            factors, and of their treatments under which it applies.

    Example:
        >>> from robot_runner import Factor
        >>> space = SearchedSpace([Factor("Speed", [0.2, 0.1])], lambda combination: True)
        >>> space.combination((0,))["Speed"], space.places(space.combination((1,)))
        (0.1, (1,))
    """

    def __init__(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> None:
        own = [[each for each in settings(factor) if not (factor.when and each is INACTIVE)] for factor in factors]
        self.are_numbers = [all(map(is_number, treatments)) for treatments in own]
        self.active = list(map(len, own))
        self.levels: list[list[Any]] = [
            [*(sorted(treatments) if is_numeric else treatments), *([INACTIVE] if factor.when else [])]
            for factor, treatments, is_numeric in zip(factors, own, self.are_numbers, strict=True)
        ]
        self._is_allowed = is_allowed
        self._names = factor_places(factor.name for factor in factors)
        self._place_of = [{str(level): place for place, level in enumerate(levels)} for levels in self.levels]
        self.conditions = self._conditions({factor.name: factor for factor in factors})

    @property
    def size(self) -> int:
        """How many combinations there are, those that are not allowed included."""
        return prod(map(len, self.levels))

    def combination(self, places: Places) -> Combination:
        """Return the combination of treatments at these indices."""
        treatments = (levels[place] for levels, place in zip(self.levels, places, strict=True))
        return Combination(self._names, tuple(treatments))

    def places(self, combination: Combination) -> Places | None:
        """Return the indices of a combination's treatments; None where the config does not have them any more."""
        try:
            return tuple(own[str(each)] for own, each in zip(self._place_of, combination.treatments, strict=True))
        except KeyError:
            return None

    def is_allowed(self, places: Places) -> bool:
        """Return whether a combination is not excluded, and each factor applies where it has a treatment."""
        # Exclusions know only the ends of a range, not its steps, so that its conditions are checked here.
        for place, wanted in self.conditions:
            if _applies(places, wanted) is (places[place] == self.active[place]):
                return False
        return self._is_allowed(self.combination(places))

    def _conditions(self, by_name: Mapping[str, Factor]) -> list[tuple[int, list[tuple[int, list[int]]]]]:
        ordered: list[str] = []
        left = [name for name, factor in by_name.items() if factor.when]
        while left:  # no condition depends on itself
            ordered += [each for each in left if not set(left) & set(by_name[each].when)]
            left = [each for each in left if each not in ordered]
        found = []
        for name in ordered:
            depends = [
                (self._names[other], _named(by_name[other], wanted)) for other, wanted in by_name[name].when.items()
            ]
            conditions = [(place, [self._place_of[place][text] for text in texts]) for place, texts in depends]
            found.append((self._names[name], conditions))
        return found

    def _fitted(self, places: Sequence[int]) -> Places:
        """Return a combination in which factors that do not apply have no treatment."""
        fitted = list(places)
        for place, wanted in self.conditions:
            if not _applies(fitted, wanted):
                fitted[place] = self.active[place]
        return tuple(fitted)

    def where_it_applies(self, combination: Combination) -> Combination:
        """Return a combination of treatments that are known here, without those of factors that do not apply."""
        places = zip(self._place_of, combination.treatments, strict=True)
        return self.combination(self._fitted([own[str(each)] for own, each in places]))

    def spread(self, count: int, seed: str) -> list[Places]:
        """Return `count` combinations, spread over the space, or all that are allowed if these are fewer.

        A Latin hypercube that includes both ends of each factor, where the best one often is.
        """
        if count < 2:  # noqa: PLR2004 - one combination has no ends
            return self._filled([], count, seed)
        seeds = [Random(f"{seed} {own}").getrandbits(32) for own in self._names]  # noqa: S311 - reproducible, not secret
        orders = [arranged(count, None, RunOrder(shuffle=True, seed=each)) for each in seeds]
        pairs = list(zip(orders, self.active, strict=True))
        spread = [
            self._fitted([round(order[number] * (levels - 1) / (count - 1)) for order, levels in pairs])
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
        drawn = ([int(draw() * levels) for levels in self.active] for _ in range(_DRAWS))
        # The first factor changes fastest: another order would give other runs for the same seed.
        listed = (each[::-1] for each in product(*map(range, reversed(self.active))))
        candidates = map(self._fitted, chain(drawn, listed) if self.size <= _FEW else drawn)
        return next((each for each in candidates if each not in tried and self.is_allowed(each)), None)


def _applies(places: Sequence[int], conditions: Sequence[tuple[int, Sequence[int]]]) -> bool:
    return all(places[other] in wanted for other, wanted in conditions)


def _named(factor: Factor, wanted: Any) -> list[str]:
    """Return the texts of the treatments that a condition names."""
    named = map(factor.position_of, factor.named(wanted))
    return [factor.texts[place] for place in named if place is not None]


def settings(factor: Factor) -> list[Any]:
    """Return the treatments of a factor, or all steps of its range."""
    span = factor.range
    if span is None:
        return list(factor.treatments)
    # Its own objects, which exclusions compare: an end may be 0 where the steps are 0.0, 0.1, and so on.
    own = {each: each for each in factor.treatments if each is not INACTIVE}
    steps = (span.at(number / span.step_count) for number in range(span.step_count + 1))
    found = dict.fromkeys(own.get(each, each) for each in steps)
    return [*found, *(each for each in factor.treatments if each is INACTIVE)]


def baseline_findings(where: str, factors: Sequence[Factor], baseline: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield errors where a baseline is not a combination of these factors."""
    known = {factor.name: factor for factor in factors}
    for name, treatment in baseline.items():
        if name not in known:
            yield Finding.error(where, f"the baseline names the factor {name!r}", did_you_mean(str(name), known))
            continue
        whole = known[name].with_treatments(settings(known[name]))
        if whole.position_of(treatment) is None:
            problem = f"the baseline has {treatment!r}, which is not a treatment of {name}"
            yield Finding.error(where, problem, whole.suggestion(treatment))
    for factor in factors:
        if factor.name not in baseline and len(factor.treatments) > 1 and not factor.when:
            yield _left_out(where, factor)


def _left_out(where: str, factor: Factor) -> Finding:
    problem = f"the baseline has no treatment of {factor.name}"
    return Finding.error(where, problem, f"Add it, such as {factor.name!r}: {factor.treatments[0]!r}.")


def baseline_of(factors: Sequence[Factor], baseline: Mapping[str, Any]) -> Combination:
    """Return the combination of a baseline without findings, in which factors that do not apply have no treatment.

    Factors with one treatment may be left out, and conditional ones that do not apply.

    Raises:
        DesignError: a conditional factor that applies is left out.
    """
    treatments = []
    for factor in factors:
        whole = factor.with_treatments(settings(factor))
        place = whole.position_of(baseline.get(factor.name, factor.treatments[0])) or 0
        treatments.append(whole.treatments[place])
    given = Combination(factor_places(factor.name for factor in factors), tuple(treatments))
    found = SearchedSpace(factors, lambda _: True).where_it_applies(given)
    DesignError.refuse(
        _left_out("design", factor)
        for factor in factors
        if factor.when and factor.name not in baseline and found[factor.name] is not INACTIVE
    )
    return found
