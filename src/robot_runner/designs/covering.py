"""Covering arrays: few combinations among which all pairs, triples or t-tuples of treatments occur."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, product
from math import prod
from random import Random
from typing import ClassVar

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.exclusions import Allowed
from robot_runner.core.design.factor import Factor, full_factorial, full_size
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.words import counted
from robot_runner.designs.choosing import Described, at_places, library_findings, number_findings

#: More t-tuples than this would take minutes.
_MOST_TUPLES = 500_000
#: An exclusion that is a function is asked of each combination, of so many at most.
_MOST_ASKED = 100_000
#: How many rows are made at a time, of which the one that covers most is taken (as in AETG, Cohen et al., 1997).
_CANDIDATES = 10
#: The pairwise search makes sizes that exclusions leave whole; it is tried where there are none.
_PAIRS, _TRIPLES = 2, 3

#: Places of treatments, by the factor's place.
_Partial = dict[int, int]
_Tuple = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class CoveringArray(Described):
    """Few combinations in which each pair of treatments of two factors occurs; with `strength=3` each triple.

    For finding out whether anything goes wrong, or screening many factors: it is not balanced, so that effects are
    estimated less precisely than by a factorial. Exclusions and conditions are constraints: each tuple that some
    allowed combination has is covered, and no other one.

    Attributes:
        strength: how many factors at a time have all combinations of their treatments covered.
        seed: what the search draws from.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> factors = [Factor(name, range(3)) for name in "ABCD"]
        >>> len(CoveringArray(strength=2).choose(factors, lambda combination: True).combinations)
        9
    """

    kind: ClassVar[str] = "covering_array"
    strength: int = 2
    seed: int = 0

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Say why it cannot be."""
        yield from library_findings("numpy")
        yield from number_findings("seed", self.seed, 0)
        wrong = list(number_findings("strength", self.strength, 2))
        yield from wrong
        if wrong:
            return
        if self.strength > len(factors):
            problem = f"strength={self.strength}, and there {'is' if len(factors) == 1 else 'are'} "
            fix = f"Give {len(factors)} or less." if len(factors) > 1 else "Leave the design out."
            yield Finding.error("design", problem + counted(len(factors), "factor"), fix)
        elif self.strength > _PAIRS or any(len(factor.treatments) > 2 for factor in factors):  # noqa: PLR2004 - exact
            yield from _size_findings(factors, self.strength)

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the array's combinations."""
        levels = [len(factor.treatments) for factor in factors]
        constraints = _Constraints(factors, is_allowed)
        if self.strength == _PAIRS and constraints.is_free:
            from robot_runner.designs.covering_search import pairwise_array  # noqa: PLC0415 - its library is an extra

            rows = [list(map(int, row)) for row in pairwise_array(levels, self.seed)]
        else:
            DesignError.refuse(_size_findings(factors, self.strength))
            rows = self._rows(levels, constraints)
        facts = {"kind": self.kind, "strength": self.strength, "model": "main"}
        return ChosenCombinations(at_places(factors, rows), facts)

    def _rows(self, levels: Sequence[int], constraints: _Constraints) -> list[list[int]]:
        """Return rows that are found one by one, or a construction's where it has fewer."""
        found = _greedy(levels, self.strength, constraints, Random(self.seed))  # noqa: S311 - reproducible
        if self.strength != _TRIPLES or not constraints.is_free:
            return found
        from robot_runner.designs.covering_triples import triples_array  # noqa: PLC0415 - its library is an extra

        made = [list(map(int, row)) for row in triples_array(levels, self.seed)]
        return min(found, _without_spare(made, _TRIPLES), key=len)


def _size_findings(factors: Sequence[Factor], strength: int) -> Iterator[Finding]:
    """Say whether there are too many tuples: their number is an elementary symmetric polynomial of the treatments'."""
    sums = [1] + [0] * strength
    for factor in factors:
        for size in range(strength, 0, -1):
            sums[size] += sums[size - 1] * len(factor.treatments)
    if sums[strength] > _MOST_TUPLES:
        problem = f"there are {sums[strength]:,} tuples of {strength} treatments; {_MOST_TUPLES:,} is the most"
        fix = "Give a lower strength, or choose FractionalFactorial for factors with two treatments."
        yield Finding.error("design", problem, fix)


# What exclusions and conditions leave.


class _Constraints:
    """Which treatments can be in one combination.

    Raises:
        DesignError: an exclusion is a function, and there are too many combinations to ask it of all.
    """

    def __init__(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> None:
        place_of = {factor.name: place for place, factor in enumerate(factors)}
        self._levels = [len(factor.treatments) for factor in factors]
        forbidden = is_allowed.forbidden if isinstance(is_allowed, Allowed) else ()
        self._forbidden = [{place_of[name]: places for name, places in each.items()} for each in forbidden]
        self._allowed: set[tuple[int, ...]] | None = None
        if not isinstance(is_allowed, Allowed) or is_allowed.predicates:
            self._allowed = _asked(factors, is_allowed)
        self._naming = [[each for each in self._forbidden if place in each] for place in range(len(factors))]

    @property
    def is_free(self) -> bool:
        """Whether everything is allowed."""
        return not self._forbidden and (self._allowed is None or len(self._allowed) == prod(self._levels))

    def completed(
        self, fixed: _Partial, order: Sequence[int], values: Callable[[int, _Partial], Sequence[int]]
    ) -> _Partial | None:
        """Return an allowed combination that has what `fixed` has; None where there is none.

        Args:
            fixed: what is decided already.
            order: the places of the other factors, in the order in which they are decided.
            values: the places of a factor's treatments, in the order in which they are tried beside what is fixed.
        """
        if any(self._is_broken(fixed, place) for place in fixed):
            return None
        if not order:
            whole = tuple(fixed[place] for place in sorted(fixed))
            return fixed if self._allowed is None or whole in self._allowed else None
        for value in values(order[0], fixed):
            found = self.completed({**fixed, order[0]: value}, order[1:], values)
            if found is not None:
                return found
        return None

    def _is_broken(self, fixed: _Partial, place: int) -> bool:
        """Return whether an exclusion that names a factor matches."""
        return any(
            all(other in fixed and fixed[other] in places for other, places in each.items())
            for each in self._naming[place]
        )

    def is_possible(self, tuple_: _Tuple) -> bool:
        """Return whether some allowed combination has these treatments."""
        fixed = dict(tuple_)
        if self._allowed is not None:
            return any(all(row[place] == value for place, value in tuple_) for row in self._allowed)
        tied = sorted({place for each in self._forbidden for place in each} - set(fixed))  # all others are free
        return self.completed(fixed, tied, lambda place, _: range(self._levels[place])) is not None


def _asked(factors: Sequence[Factor], is_allowed: IsAllowed) -> set[tuple[int, ...]]:
    size = full_size(factors)
    if size > _MOST_ASKED:
        problem = (
            f"an exclusion is a function, which would be asked of {size:,} combinations; {_MOST_ASKED:,} is the most"
        )
        fix = 'Give it as a mapping: {"Task": "Network", "Speed": 0.2}.'
        raise DesignError(problem, where="exclude_combinations", fix=fix)
    place_of = [{id(each): place for place, each in enumerate(factor.treatments)} for factor in factors]
    return {
        tuple(places[id(each)] for places, each in zip(place_of, combination.treatments, strict=True))
        for combination in full_factorial(factors)
        if is_allowed(combination)
    }


# Row by row.


def _greedy(levels: Sequence[int], strength: int, constraints: _Constraints, random: Random) -> list[list[int]]:
    """Return rows, each of which covers as many new tuples as the best of some candidates, without those in vain."""
    open_tuples = {each: None for each in _tuples(levels, strength) if constraints.is_possible(each)}
    rows: list[list[int]] = []
    while open_tuples:
        wanted = Counter(cell for each in open_tuples for cell in each)
        make = partial(_row, levels, strength, open_tuples, wanted, constraints)
        candidates = [make(random) for _ in range(_CANDIDATES)]
        covered = [[each for each in _tuples_of(row, strength) if each in open_tuples] for row in candidates]
        best = max(range(len(candidates)), key=lambda place: len(covered[place]))
        for each in covered[best]:
            del open_tuples[each]
        rows.append(candidates[best])
    return _without_spare(rows, strength)


def _tuples(levels: Sequence[int], strength: int) -> Iterator[_Tuple]:
    for places in combinations(range(len(levels)), strength):
        for values in product(*(range(levels[place]) for place in places)):
            yield tuple(zip(places, values, strict=True))


def _tuples_of(row: Sequence[int], strength: int) -> Iterator[_Tuple]:
    return combinations(enumerate(row), strength)


def _row(
    levels: Sequence[int],
    strength: int,
    open_tuples: Mapping[_Tuple, None],
    wanted: Mapping[tuple[int, int], int],
    constraints: _Constraints,
    random: Random,
) -> list[int]:
    """Return an allowed row with the first open tuple; each other factor has what covers most with those before it.

    Between equals decides in how many open tuples each is `wanted`, and then chance.
    """
    fixed = dict(next(iter(open_tuples)))
    order = [place for place in range(len(levels)) if place not in fixed]
    random.shuffle(order)

    def by_worth(place: int, before: _Partial) -> list[int]:
        groups = list(combinations(before.items(), strength - 1))
        worth = []
        for value in range(levels[place]):
            new = sum(tuple(sorted((*each, (place, value)))) in open_tuples for each in groups)
            worth.append((-new, -wanted.get((place, value), 0), random.random(), value))
        return [value for *_, value in sorted(worth)]

    row = constraints.completed(fixed, order, by_worth)
    if row is None:  # never: the tuple is possible
        raise DesignError("a tuple cannot be covered", where="design", fix="Exclude fewer.")
    return [row[place] for place in range(len(levels))]


def _without_spare(rows: list[list[int]], strength: int) -> list[list[int]]:
    """Return the rows without those whose tuples others have."""
    times: dict[_Tuple, int] = {}
    for row in rows:
        for each in _tuples_of(row, strength):
            times[each] = times.get(each, 0) + 1
    kept = []
    for row in rows:
        own = list(_tuples_of(row, strength))
        if all(times[each] > 1 for each in own):
            for each in own:
                times[each] -= 1
        else:
            kept.append(row)
    return kept
