"""The combinations of a full factorial, and conditional factors, which apply under some treatments of others only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product, repeat
from math import prod

from robot_runner.core.design.factor import Combination, Factor, factor_places
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import INACTIVE


def condition_findings(factors: Sequence[Factor]) -> Iterator[Finding]:
    """Yield an error for conditions with unknown names, or that depend on each other in a circle."""
    by_name = {factor.name: factor for factor in factors}
    for factor in factors:
        where = f"factors: {factor.name!r} applies when"
        for name, wanted in factor.when.items():
            other = by_name.get(name)
            if other is None or name == factor.name:
                known = [each for each in by_name if each != factor.name]
                yield Finding.error(where, f"there is no other factor {name!r}", did_you_mean(name, known))
                continue
            for value in other.named(wanted):
                if other.position_of(value) is None:
                    yield Finding.error(where, f"{value!r} is not a treatment of {name!r}", other.suggestion(value))
        seen, open_names = set[str](), list(factor.when)
        while open_names:
            name = open_names.pop()
            if name not in seen and name in by_name:
                seen.add(name)
                open_names += by_name[name].when
        if factor.name in seen:
            yield Finding.error(where, "the conditions are circular", "Remove one of the conditions.")


def impossible_treatments(factors: Sequence[Factor]) -> Iterator[dict[str, frozenset[int]]]:
    """Yield combinations that the conditions of factors exclude: indices of treatments, by factor."""
    by_name = {factor.name: factor for factor in factors}
    for factor in factors:
        if not factor.when:
            continue
        inactive = frozenset(place for place, each in enumerate(factor.treatments) if each is INACTIVE)
        active = frozenset(range(len(factor.treatments))) - inactive
        applies = {
            name: frozenset(
                place for place in map(by_name[name].position_of, by_name[name].named(wanted)) if place is not None
            )
            for name, wanted in factor.when.items()
        }
        yield {**applies, factor.name: inactive}
        for name, places in applies.items():
            yield {name: frozenset(range(len(by_name[name].treatments))) - places, factor.name: active}


def identified(
    factors: Sequence[Factor], excluded: Iterable[Mapping[str, frozenset[int]]]
) -> list[list[tuple[str, set[int]]]]:
    """Return exclusions with the `id` of each treatment for its index: combinations hold the factors' objects."""
    by_name = {factor.name: factor for factor in factors}
    return [
        [(name, {id(by_name[name].treatments[place]) for place in places}) for name, places in each.items()]
        for each in excluded
    ]


def full_factorial(factors: Sequence[Factor]) -> list[Combination]:
    """Return every combination of the factors' treatments that their conditions allow; the first changes slowest."""
    places = factor_places(factor.name for factor in factors)
    every = list(map(Combination, repeat(places), product(*(factor.treatments for factor in factors))))
    for excluded in identified(factors, impossible_treatments(factors)):
        every = [each for each in every if not all(id(each[name]) in treatments for name, treatments in excluded)]
    return every


def full_size(factors: Sequence[Factor]) -> int:
    """Return how many combinations the full factorial has; only factors that conditions tie together are multiplied."""
    tied = {name for factor in factors if factor.when for name in (factor.name, *factor.when)}
    free = prod(len(factor.treatments) for factor in factors if factor.name not in tied)
    return free * (len(full_factorial([each for each in factors if each.name in tied])) if tied else 1)
