"""Covering arrays cover every allowed tuple, have no excluded combination, and are about as small as published ones."""

from __future__ import annotations

from itertools import combinations
from math import prod

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.designs.factor_sets import every_pair, excluded_designs, factors_of, findings_of, rows_of, tuples_in
from tests.long_cases import soak_but

from robot_runner import Factor, RunTableModel
from robot_runner.designs import CoveringArray
from robot_runner.designs.covering_search import _orthogonal, _starter, pairwise_array, triples_array

#: The least rows that are published. The first six: the best of the tools at pairwise.org/efficiency.html (2^100 is
#: optimal: Kleitman & Spencer, 1973). The others: the product of the two largest numbers of levels, below which
#: there is nothing; Cohen, Gibbons, Mugridge & Colbourn (2003), ICSE, reach it, but for 21 in place of 20.
PUBLISHED = {
    "3^4": ([3] * 4, 9),
    "3^13": ([3] * 13, 15),
    "4^15 3^17 2^29": ([4] * 15 + [3] * 17 + [2] * 29, 29),
    "4^1 3^39 2^35": ([4] + [3] * 39 + [2] * 35, 21),
    "2^100": ([2] * 100, 10),
    "10^20": ([10] * 20, 180),
    "5^1 3^8 2^2": ([5] + [3] * 8 + [2] * 2, 15),
    "5^1 4^4 3^11 2^5": ([5] + [4] * 4 + [3] * 11 + [2] * 5, 20),
    "6^1 5^1 4^6 3^8 2^3": ([6, 5] + [4] * 6 + [3] * 8 + [2] * 3, 30),
    "7^1 6^1 5^1 4^5 3^8 2^3": ([7, 6, 5] + [4] * 5 + [3] * 8 + [2] * 3, 42),
}


#: Triples, likewise. 3^4, 4^6 and 5^6 are orthogonal arrays (Bush, 1952): as many rows as the product of the three
#: largest numbers of symbols, below which there is nothing. 12 rows for up to 11 columns of two symbols: Johnson &
#: Entringer (1989), in Lawrence, Kacker, Lei, Kuhn & Forbes, A survey of binary covering arrays (2011). The others are
#: of Cohen, Gibbons, Mugridge & Colbourn (2003), ICSE, by simulated annealing, which takes longer than loading a config
#: may. The last figure is how many times as many ours has at most.
PUBLISHED_TRIPLES = {
    "3^4": ([3] * 4, 27, 1.0),
    "4^6": ([4] * 6, 64, 1.0),
    "5^6": ([5] * 6, 125, 1.0),
    "2^11": ([2] * 11, 12, 1.0),
    "10^1 6^2 4^3 3^1": ([10, 6, 6, 4, 4, 4, 3], 360, 1.1),
    "6^6": ([6] * 6, 300, 1.1),
    "5^7": ([5] * 7, 201, 1.15),
    "5^2 4^2 3^2": ([5, 5, 4, 4, 3, 3], 100, 1.15),
    "3^6": ([3] * 6, 33, 1.4),
}


def covered_pairs(array: np.ndarray, levels: list[int]) -> int:
    """Count the pairs of symbols that are covered, by a matrix of its own: the search counts another way."""
    starts = np.cumsum([0, *levels[:-1]])
    is_in = np.zeros((len(array), sum(levels)), dtype=np.int64)
    for row in range(len(array)):
        is_in[row, starts + array[row]] = 1
    together = is_in.T @ is_in > 0
    for start, count in zip(starts, levels, strict=True):
        together[start : start + count, start : start + count] = False
    return int(together.sum()) // 2


@pytest.mark.long
@pytest.mark.parametrize("problem", soak_but({*PUBLISHED} - {"10^20", "4^15 3^17 2^29"}, PUBLISHED))
def test_an_array_is_at_most_a_tenth_larger_than_the_best_published(problem: str) -> None:
    levels, published = PUBLISHED[problem]
    array = pairwise_array(levels, seed=0)
    assert covered_pairs(array, levels) == every_pair(levels)
    assert len(array) <= 1.1 * published


@pytest.mark.long
@pytest.mark.parametrize("problem", soak_but({*PUBLISHED_TRIPLES} - {"10^1 6^2 4^3 3^1", "6^6"}, PUBLISHED_TRIPLES))
def test_an_array_of_triples_is_not_much_larger_than_published_ones(problem: str) -> None:
    levels, published, times = PUBLISHED_TRIPLES[problem]
    rows = rows_of(RunTableModel(factors_of(levels), design=CoveringArray(strength=3)))
    assert len(rows) <= times * published
    triples = {
        (places, tuple(row[each] for each in places)) for row in rows for places in combinations(range(len(levels)), 3)
    }
    assert len(triples) == sum(prod(each) for each in combinations(levels, 3))


@pytest.mark.parametrize(("symbols", "columns"), [(2, 22), (3, 8), (3, 13), (4, 12), (7, 5), (9, 4)])
def test_constructed_arrays_have_all_triples(symbols: int, columns: int) -> None:
    array = triples_array([symbols] * columns, seed=0)
    for places in combinations(range(columns), 3):
        assert len(np.unique(array[:, places], axis=0)) == symbols**3


def test_ingredients_are_what_they_are_called() -> None:
    for order in (2, 3, 4, 5, 7, 8, 9, 11, 16):
        assert covered_pairs(_orthogonal(order), [order] * (order + 1)) == every_pair([order] * (order + 1))
        assert _orthogonal(order).shape == (order**2, order + 1)
    starter = _starter(6, 10)
    assert starter is not None
    assert starter.shape == (10 * 5 + 1, 10)
    assert covered_pairs(starter, [6] * 10) == every_pair([6] * 10)


@pytest.mark.long
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(excluded_designs(), st.integers(2, 3), st.integers(0, 3))
def test_exactly_the_tuples_that_some_allowed_combination_has_are_covered(
    drawn: tuple[list[Factor], list[dict[str, object]]], strength: int, seed: int
) -> None:
    factors, exclusions = drawn
    strength = min(strength, len(factors))
    design = CoveringArray(strength=strength, seed=seed)
    model = RunTableModel(factors, exclusions, design=design)
    allowed = rows_of(RunTableModel(factors, exclusions))
    rows = rows_of(model)
    assert set(rows) <= set(allowed)
    assert len(set(rows)) == len(rows) <= len(allowed), "no combination twice, and no more than all"
    assert tuples_in(rows, strength) == tuples_in(allowed, strength)
    assert rows_of(RunTableModel(factors, exclusions, design=design)) == rows


def test_an_exclusion_may_be_a_function_and_one_of_too_many_combinations_is_refused() -> None:
    factors = factors_of([3] * 4)

    def is_out(combination: dict[str, str]) -> bool:
        return combination["F0"] == combination["F1"]

    rows = rows_of(RunTableModel(factors, [is_out], design=CoveringArray()))
    assert all(row[0] != row[1] for row in rows)
    assert tuples_in(rows, 2) == tuples_in(rows_of(RunTableModel(factors, [is_out])), 2)
    assert findings_of(factors_of([3] * 12), [is_out], design=CoveringArray()) == [
        (
            "exclude_combinations: an exclusion is a function, which would be asked of 531,441 combinations; 100,000 "
            'is the most → Give it as a mapping: {"Task": "Network", "Speed": 0.2}.'
        )
    ]


def test_a_thousand_factors_of_two_treatments_need_no_more_runs_than_the_theorem_says() -> None:
    # Kleitman & Spencer (1973): comb(12, 7) = 792 factors at most with 13 runs, comb(13, 7) = 1716 with 14.
    assert len(RunTableModel(factors_of([2] * 1000), design=CoveringArray()).plan()) == 14


def test_all_that_keeps_an_array_from_being_is_said_at_once() -> None:
    assert findings_of(factors_of([2, 2]), design=CoveringArray(strength=1, seed=-1)) == [
        "design: seed=-1 is less than 0 → Give a whole number from 0.",
        "design: strength=1 is less than 2 → Give a whole number from 2.",
    ]
    assert findings_of(factors_of([2, 2]), design=CoveringArray(strength=3)) == [
        "design: strength=3, and there are 2 factors → Give 2 or less."
    ]
    assert "500,000 is the most" in findings_of(factors_of([3] * 60), design=CoveringArray(strength=4))[0]
    everything = [{"F0": ["t0", "t1"]}]
    assert "no run of the design" in findings_of(factors_of([2, 2]), everything, design=CoveringArray())[0]
