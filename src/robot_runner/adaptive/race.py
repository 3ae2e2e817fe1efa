"""A race: combinations that are clearly worse than another one get no further runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from robot_runner.adaptive.explored import (
    Direction,
    Explored,
    best_of,
    confirmation,
    confirmed,
    count_findings,
    decided,
    direction_findings,
    explored,
    in_direction,
    shown,
    without_values,
)
from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.design import DesignedRuns, IsAllowed
from robot_runner.core.design.factor import Factor, texts_of
from robot_runner.core.design.full_factorial import full_factorial, full_size
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder, planned_runs
from robot_runner.core.design.precision import LEAST_REPETITIONS
from robot_runner.core.design.repeated_intervals import half_width_of, level_at_each_look
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.words import counted, listed

#: The probability, at most, that the best combination is dropped.
_ERROR = 0.05
#: The levels of single comparisons were checked for up to so many combinations.
_MOST_COMBINATIONS = 100
#: Values with a smaller relative difference count as equal, as in the statistics of the report.
_ROUNDING = 1e-13


@dataclass(frozen=True, slots=True, init=False)
class Race:
    """Execute all combinations repetition by repetition, and drop those that are clearly worse than another one.

    Each repetition is a block: every remaining combination once, in random order where the model shuffles. Combinations
    are compared within repetitions. One is dropped where the repeated interval (Jennison and Turnbull 1989) of its
    difference from another shows that it is worse, at a level with which the best one is dropped in at most 5 % of all
    races, over all looks and all other combinations (Bonferroni).

    Attributes:
        directions: which values of the measure are better.
        at_most: the largest number of repetitions; the model's `repetitions` are the smallest.
        confirm: how many further runs each remaining combination has at the end, analysed as a planned experiment; 0
            for none.

    Raises:
        DesignError: an attribute is invalid; `findings` lists all problems.

    Example:
        >>> Race("Energy", "minimise", at_most=30).as_mapping()["at_most"]
        30
    """

    directions: Mapping[str, Direction]
    at_most: int
    confirm: int

    def __init__(
        self, measure: str, direction: str | Direction = Direction.MINIMISE, *, at_most: int, confirm: int = 0
    ) -> None:
        where = f"Race({measure!r})"
        findings = [
            *direction_findings(where, {measure: direction} if isinstance(measure, str) else [measure]),
            *count_findings(where, LEAST_REPETITIONS, at_most=at_most),
            *count_findings(where, confirm=confirm),
        ]
        DesignError.refuse(findings)
        given = (MappingProxyType({measure: Direction(direction)}), at_most, confirm)
        for name, value in zip(self.__slots__, given, strict=True):
            object.__setattr__(self, name, value)

    @property
    def measures(self) -> Sequence[str]:
        """The measure by which it decides."""
        return tuple(self.directions)

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield errors: too many or too few combinations."""
        where = f"Race({self.measures[0]})"
        many = full_size(factors)
        if many == 1:
            problem = "no factor has two treatments, so that nothing can be dropped"
            yield Finding.error(where, problem, "Give a factor the treatments to choose from.")
        if many > _MOST_COMBINATIONS:
            problem = f"{many:,} combinations are more than the {_MOST_COMBINATIONS} that a race is made for"
            yield Finding.error(where, problem, "Search among them: Optimise(...).")

    def repetition_findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Yield errors: too few repetitions, or more than `at_most`."""
        del factors
        where = f"Race({self.measures[0]})"
        if repetitions < LEAST_REPETITIONS:
            problem = f"{counted(repetitions, 'repetition')} cannot show the spread, by which combinations are dropped"
            yield Finding.error(where, problem, "Plan repetitions=5 or more: the first look comes after them.")
        if self.at_most < repetitions:
            problem = f"at_most is {self.at_most}, and {repetitions} repetitions are planned"
            yield Finding.error(where, problem, "Plan fewer repetitions, or allow more: at_most counts all of them.")

    def as_mapping(self) -> Mapping[str, Any]:
        """Return the race as plain data."""
        return {
            "kind": "race",
            "directions": {name: each.value for name, each in self.directions.items()},
            "at_most": self.at_most,
            "confirm": self.confirm,
        }

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the first repetitions, each of them a block.

        Raises:
            DesignError: the exclusions leave nothing to choose from.
        """
        combinations = [each for each in full_factorial(factors) if is_allowed(each)]
        if len(combinations) < 2:  # noqa: PLR2004 - one would race against nobody
            problem = f"the exclusions leave {counted(len(combinations), 'combination')}"
            raise DesignError(problem, where="design", fix="Exclude fewer: a race takes two.")
        block_of = [number for number in range(repetitions) for _ in combinations]
        runs = planned_runs(combinations, repetitions, block_of, RunOrder(shuffle=shuffle, seed=seed))
        return DesignedRuns(runs, self._facts(len(combinations), repetitions))

    def asking(self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int) -> _Racing:
        """Return the object that decides which combinations remain."""
        del factors, is_allowed
        return _Racing(self, repetitions)

    def _facts(self, combinations: int, repetitions: int) -> dict[str, Any]:
        (name, direction), *_ = self.directions.items()
        decides = (
            f"from repetition {repetitions} on, which combinations are clearly worse than another one by {name} "
            f"({direction.value}) and get no further runs; at most {self.at_most} repetitions"
        )
        if self.confirm:
            decides += f"; then {counted(self.confirm, 'run')} of each that is left, which confirm it"
        most = combinations * (self.at_most + self.confirm)
        return {"kind": "race", "decides": decides, "most_runs": most}


class _Racing:
    """Decides which combinations remain; see `Asking`."""

    def __init__(self, design: Race, repetitions: int) -> None:
        self._design = design
        self._least = repetitions
        self.measures = design.measures

    def may_add(self, runs: Sequence[PlannedRun]) -> bool:
        """Return whether there may be another repetition, or runs that confirm the result."""
        raced = [run.repetition for run in runs if run.batch == 1]
        return max(raced) < self._design.at_most or (self._design.confirm > 0 and len(raced) == len(runs))

    def ask(self, told: Sequence[Told]) -> Decision:
        """Return the next repetition of the remaining combinations, then the runs that confirm them, then nothing."""
        design = self._design
        points, odd = explored(told, self.measures)
        raced = [each.run for each in told if each.run.batch == 1]
        now = max(run.repetition for run in raced)
        there = {run.combination.texts for run in raced if run.repetition == now}
        runners = [each for each in points if each.combination.texts in there]
        worse = self._worse(runners, len(points))
        # Where runs failed, each may be worse than another in the repetitions that they share.
        left = [each for each in runners if id(each) not in worse] or runners
        words = self._in_words(left, runners, worse, now)
        dropped = [texts_of(each.combination) for each in runners if id(each) in worse]
        kept = [texts_of(each.combination) for each in left]
        facts = {"known": {"repetitions": now, "left": kept, "dropped": dropped}}
        if any(each.run.batch > 1 for each in told):
            words = confirmed(told, left, words)
        elif not any(each.values for each in runners):
            # The combinations are not the cause: the remaining repetitions are not wasted.
            odd = [*odd, without_values(self.measures)]
        elif len(left) > 1 and now < design.at_most:
            words = f"{words}. Next: repetition {now + 1} of {counted(len(left), 'combination')}"
            runs = [(each.combination, now + 1) for each in left]
            return decided(f"repetition {now + 1}", words, facts, runs=runs, blocks=REPETITION)
        elif design.confirm:
            return confirmation(left, design.confirm, words, facts)
        return decided("end", words, facts, findings=odd)

    def _worse(self, runners: Sequence[Explored], raced: int) -> dict[int, str]:
        """Return the combinations that are clearly worse than another one, by `id`, and which one that is.

        Each pair has the same share of the error, and its interval covers at all looks; only errors to one side drop
        the best one, so that each interval has twice its share. A combination without values whose runs failed is
        dropped, too, but not one whose values were all left out.
        """
        (name, direction), *_ = self._design.directions.items()
        level = level_at_each_look(self._least, self._design.at_most, 1 - 2 * _ERROR / (raced - 1))
        found = {}
        has_values = [each for each in runners if each.values]
        for one in runners if has_values else ():
            if not one.values and one.has_failed:
                found[id(one)] = "any that has a value"
            for other in runners:
                differences = _within_repetitions(one, other, name, direction.sign)
                if len(differences) < self._least:
                    continue
                mean = math.fsum(differences) / len(differences)
                if mean > 0 and mean > half_width_of(differences, level):
                    found[id(one)] = shown(other.combination)
        return found

    def _in_words(
        self, left: Sequence[Explored], runners: Sequence[Explored], worse: Mapping[int, str], now: int
    ) -> str:
        (name, direction), *_ = self._design.directions.items()
        dropped = [f"{shown(each.combination)} (worse than {worse[id(each)]})" for each in runners if id(each) in worse]
        best = best_of(left, self._design.directions)
        ahead = f"{in_direction(name, direction)} has {shown(best[0].combination)}" if best else f"none has {name}"
        gone = f"; dropped: {listed(dropped)}" if dropped else ""
        # Where none has a value, the beginning says so.
        unknown = [shown(each.combination) for each in left if best and not each.values and not each.has_failed]
        gone += f"; of {listed(unknown)}, no value counts" if unknown else ""
        return f"after {counted(now, 'repetition')}, {ahead}, {counted(len(left), 'combination')} left{gone}"


def _within_repetitions(one: Explored, other: Explored, measure: str, sign: int) -> list[float]:
    """Return by how much `one` is worse in each repetition that has both; a difference by rounding counts as 0."""
    mine, its = one.values.get(measure, {}), other.values.get(measure, {})
    pairs = [(mine[each], its[each]) for each in sorted(mine.keys() & its.keys())]
    return [0.0 if math.isclose(*pair, rel_tol=_ROUNDING) else sign * (pair[0] - pair[1]) for pair in pairs]
