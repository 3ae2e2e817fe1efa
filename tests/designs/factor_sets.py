"""Factors, exclusions and checks that the tests of the designs share."""

from __future__ import annotations

from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import strategies as st

from robot_runner import Factor, Range, RunTableModel
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from collections.abc import Sequence

NAMES = "ABCDEFGH"


def factors_of(levels: Sequence[int]) -> list[Factor]:
    return [Factor(f"F{place}", [f"t{value}" for value in range(count)]) for place, count in enumerate(levels)]


def numeric(names: str) -> list[Factor]:
    return [Factor(name, Range(0.0, 10.0, unit="m/s")) for name in names]


def findings_of(*arguments: Any, **keywords: Any) -> list[str]:
    with pytest.raises(DesignError) as caught:
        RunTableModel(*arguments, **keywords)
    return [str(finding) for finding in caught.value.findings]


def rows_of(model: RunTableModel) -> list[tuple[Any, ...]]:
    return [run.combination.treatments for run in model.plan()]


def tuples_in(rows: Sequence[tuple[Any, ...]], strength: int) -> set[Any]:
    """Return the t-tuples of treatments in some rows, each with the places of its factors."""
    if not rows:
        return set()
    return {
        (places, tuple(row[place] for place in places))
        for places in combinations(range(len(rows[0])), strength)
        for row in rows
    }


@st.composite
def excluded_designs(draw: st.DrawFn) -> tuple[list[Factor], list[dict[str, Any]]]:
    """Draw factors, of which one may depend on another, and exclusions that leave something."""
    levels = draw(st.lists(st.integers(1, 4), min_size=2, max_size=5))
    factors = factors_of(levels)
    if draw(st.booleans()):
        factors.append(Factor("Inner", ["x", "y"], when={"F0": "t0"}))
    exclusions = []
    for _ in range(draw(st.integers(0, 3))):
        named = draw(st.lists(st.sampled_from(factors), min_size=2, max_size=3, unique_by=lambda each: each.name))
        exclusions.append({each.name: draw(st.sampled_from(each.treatments)) for each in named})
    left = [
        each
        for each in full_factorial(factors)
        if not any(all(each[name] == value for name, value in one.items()) for one in exclusions)
    ]
    return factors, exclusions if left else []


def every_pair(levels: Sequence[int]) -> int:
    return sum(one * other for one, other in combinations(levels, 2))


def is_balanced(rows: Sequence[tuple[Any, ...]], factors: Sequence[Factor]) -> bool:
    """Whether each two factors have each pair of treatments equally often: what makes main effects orthogonal."""
    for one, other in combinations(range(len(factors)), 2):
        pairs = [(row[one], row[other]) for row in rows]
        wanted = len(rows) / (len(factors[one].treatments) * len(factors[other].treatments))
        if any(pairs.count(pair) != wanted for pair in product(factors[one].treatments, factors[other].treatments)):
            return False
    return True
