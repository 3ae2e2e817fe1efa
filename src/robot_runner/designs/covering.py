"""Covering arrays: few combinations that include all pairs, triples or t-tuples of treatments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import prod
from random import Random
from typing import ClassVar

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.exclusions import Allowed
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.full_factorial import full_factorial, full_size
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.words import counted
from robot_runner.designs.choosing import Described, at_places, library_findings, number_findings

#: The most t-tuples: more would take minutes.
_MOST_TUPLES = 500_000
#: The most combinations for exclusions that are functions, which are called for each combination.
_MOST_ASKED = 100_000
#: The number of candidates for each row; the one that covers most is taken (as in AETG, Cohen et al., 1997).
_CANDIDATES = 10
#: The strengths with a construction of their own, for experiments without exclusions.
_PAIRS, _TRIPLES = 2, 3

#: Treatment indices, by the index of the factor.
_Partial = dict[int, int]
_Tuple = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class CoveringArray(Described):
    """Few combinations that include each pair of treatments of any two factors; with `strength=3` each triple.

    Use it to find failures, or to screen many factors. It is not balanced, so effects are estimated less precisely than
    by a factorial. Exclusions and conditions are constraints: all tuples of allowed combinations are covered, and no
    others.

    Attributes:
        strength: the number of factors for which all combinations of their treatments are covered.
        seed: of the random search.

    Example:
        >>> from robot_runner import Factor
        >>> factors = [Factor(name, range(3)) for name in "ABCD"]
        >>> len(CoveringArray(strength=2).choose(factors, lambda combination: True).combinations)
        9
    """

    kind: ClassVar[str] = "covering_array"
    strength: int = 2
    seed: int = 0

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on libraries, parameters and the number of tuples."""
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
        """Return the combinations of the array."""
        levels = [len(factor.treatments) for factor in factors]
        constraints = _Constraints(factors, is_allowed)
        if self.strength == _PAIRS and constraints.is_free:
            from robot_runner.designs.covering_search import pairwise_array  # noqa: PLC0415 - its library is an extra

            rows = pairwise_array(levels, self.seed).tolist()
        else:
            DesignError.refuse(_size_findings(factors, self.strength))
            rows = self._rows(levels, constraints)
        facts = {"kind": self.kind, "strength": self.strength, "model": "main"}
        return ChosenCombinations(at_places(factors, rows), facts)

    def _rows(self, levels: Sequence[int], constraints: _Constraints) -> list[list[int]]:
        """Return the rows of the greedy search, or of a construction if it has fewer."""
        found = _greedy(levels, self.strength, constraints, Random(self.seed))  # noqa: S311 - reproducible
        if self.strength != _TRIPLES or not constraints.is_free:
            return found
        from robot_runner.designs.covering_search import triples_array  # noqa: PLC0415 - its library is an extra

        return min(found, _without_spare(triples_array(levels, self.seed).tolist(), _TRIPLES), key=len)


def _size_findings(factors: Sequence[Factor], strength: int) -> Iterator[Finding]:
    """Yield a finding if there are too many tuples: an elementary symmetric polynomial of the numbers of treatments."""
    sums = [1] + [0] * strength
    for factor in factors:
        for size in range(strength, 0, -1):
            sums[size] += sums[size - 1] * len(factor.treatments)
    if sums[strength] > _MOST_TUPLES:
        problem = f"there are {sums[strength]:,} tuples of {strength} treatments; {_MOST_TUPLES:,} is the most"
        fix = "Give a lower strength, or choose FractionalFactorial for factors with two treatments."
        yield Finding.error("design", problem, fix)


# Constraints: exclusions and conditions.


class _Constraints:
    """The constraints on combinations of treatments.

    Raises:
        DesignError: an exclusion is a function, and there are too many combinations to call it for all.
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
        """Return an allowed combination that includes `fixed`; None if there is none.

        Args:
            fixed: the treatment indices that are already chosen.
            order: the indices of the other factors, in the order in which they are chosen.
            values: returns the treatment indices of a factor in the order in which they are tried.
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
        """Return whether an exclusion that includes this factor matches."""
        return any(
            all(other in fixed and fixed[other] in places for other, places in each.items())
            for each in self._naming[place]
        )

    def is_possible(self, tuple_: _Tuple) -> bool:
        """Return whether an allowed combination has these treatments."""
        fixed = dict(tuple_)
        if self._allowed is not None:
            return any(all(row[place] == value for place, value in tuple_) for row in self._allowed)
        tied = sorted({place for each in self._forbidden for place in each} - set(fixed))  # all others are free
        return self.completed(fixed, tied, lambda place, _: range(self._levels[place])) is not None


def _asked(factors: Sequence[Factor], is_allowed: IsAllowed) -> set[tuple[int, ...]]:
    size = full_size(factors)
    if size > _MOST_ASKED:
        asked = f"an exclusion is a function, which would be asked of {size:,} combinations"
        fix = 'Give it as a mapping: {"Task": "Network", "Speed": 0.2}.'
        raise DesignError(f"{asked}; {_MOST_ASKED:,} is the most", where="exclude_combinations", fix=fix)
    place_of = [{id(each): place for place, each in enumerate(factor.treatments)} for factor in factors]
    return {
        tuple(places[id(each)] for places, each in zip(place_of, combination.treatments, strict=True))
        for combination in full_factorial(factors)
        if is_allowed(combination)
    }


# Row by row.


def _greedy(levels: Sequence[int], strength: int, constraints: _Constraints, random: Random) -> list[list[int]]:
    """Return rows, each the candidate that covers most new tuples, without redundant rows."""
    open_tuples = {each: None for each in _tuples(levels, strength) if constraints.is_possible(each)}
    rows: list[list[int]] = []
    while open_tuples:
        wanted = Counter(cell for each in open_tuples for cell in each)
        candidates = [_row(levels, strength, open_tuples, wanted, constraints, random) for _ in range(_CANDIDATES)]
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
    """Return an allowed row with the first open tuple; each other factor gets the treatment that covers most tuples.

    Ties are broken by the number of open tuples with a treatment (`wanted`), then at random.
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
    """Return the rows without redundant ones, whose tuples are all in other rows."""
    times = Counter(each for row in rows for each in _tuples_of(row, strength))
    kept = []
    for row in rows:
        own = list(_tuples_of(row, strength))
        if all(times[each] > 1 for each in own):
            for each in own:
                times[each] -= 1
        else:
            kept.append(row)
    return kept
