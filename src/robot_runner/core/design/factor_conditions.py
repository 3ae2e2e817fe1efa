"""Conditional factors, which apply under some treatments of others only, and the combinations that this excludes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol

from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import INACTIVE


class _Factor(Protocol):
    """The part of `factor.Factor` that is needed here; that module imports this one."""

    @property
    def name(self) -> str: ...

    @property
    def treatments(self) -> tuple[Any, ...]: ...

    @property
    def when(self) -> Mapping[str, tuple[Any, ...]]: ...

    def position_of(self, value: Any) -> int | None: ...

    def named(self, wanted: Any) -> Sequence[Any]: ...

    def suggestion(self, value: Any) -> str: ...


def condition_findings(factors: Sequence[_Factor]) -> Iterator[Finding]:
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
            yield Finding.error(where, "its conditions depend on itself", "Remove one of the conditions.")


def impossible_treatments(factors: Sequence[_Factor]) -> Iterator[dict[str, frozenset[int]]]:
    """Yield what the conditions of factors exclude: indices of treatments that are never together, by factor."""
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
    factors: Sequence[_Factor], excluded: Iterable[Mapping[str, frozenset[int]]]
) -> list[list[tuple[str, set[int]]]]:
    """Return exclusions with the `id` of each treatment for its index: combinations hold the factors' objects."""
    by_name = {factor.name: factor for factor in factors}
    return [
        [(name, {id(by_name[name].treatments[place]) for place in places}) for name, places in each.items()]
        for each in excluded
    ]
