"""Fractional factorials are orthogonal, have the resolution that they say, and name what they cannot tell apart."""

from __future__ import annotations

import time
from functools import reduce
from itertools import combinations, product
from operator import xor

import numpy as np
import pyDOE3
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.designs.factor_sets import NAMES, factors_of, findings_of, is_balanced, rows_of

from robot_runner import Factor, RunTableModel
from robot_runner.designs import FractionalFactorial

#: Runs of the smallest regular fraction of each resolution, by the number of factors: the catalogue of R's FrF2 2.3-4
#: (Groemping 2014, Journal of Statistical Software 56(1)), read from the package; up to 11 factors it is table 6.22 of
#: Box, Hunter & Hunter (2005).
SMALLEST = {
    3: {3: 4, 5: 8, 6: 8, 7: 8, 9: 16, 10: 16, 11: 16, 15: 16, 16: 32, 31: 32, 32: 64, 63: 64, 64: 128, 127: 128},
    4: {4: 8, 6: 16, 7: 16, 8: 16, 9: 32, 10: 32, 11: 32, 16: 32, 17: 64, 32: 64, 33: 128, 64: 128, 65: 256, 80: 256},
    5: {5: 16, 6: 32, 8: 64, 9: 128, 10: 128, 11: 128, 12: 256, 17: 256, 18: 512, 21: 512, 24: 1024, 29: 1024},
}
#: Where the greedy choice of generators takes twice as many, of resolution five.
LARGER = {22: 512, 23: 512, 30: 1024, 33: 1024}

#: Words of three and of four letters in the defining relation of the fractions of minimum aberration, by their runs
#: and factors (Chen, Sun & Wu 1993, International Statistical Review 61, 131-145).
LEAST_ALIASED = {
    16: {9: (4, 14), 10: (8, 18), 11: (12, 26), 12: (16, 39), 13: (22, 55), 14: (28, 77), 15: (35, 105)},
    32: {7: (0, 1), 8: (0, 3), 9: (0, 6), 10: (0, 10), 11: (0, 25), 12: (0, 38), 13: (0, 55), 16: (0, 140)},
    64: {8: (0, 0), 9: (0, 1), 10: (0, 2), 11: (0, 4), 12: (0, 6), 13: (0, 14)},
}
NAMES_OF_MANY = [f"F{place}" for place in range(16)]


def short_words(words: list[int]) -> tuple[int, int]:
    """Return how many words of three and of four letters the defining relation has."""
    basic = max(words).bit_length()
    lengths = [0] * (len(words) + 1)
    for chosen in product((False, True), repeat=len(words) - basic):
        generated = [word for word, is_chosen in zip(words[basic:], chosen, strict=True) if is_chosen]
        lengths[len(generated) + reduce(xor, generated, 0).bit_count()] += 1
    return lengths[3], lengths[4]


def signs(model: RunTableModel) -> np.ndarray:
    return np.array(
        [[2 * factor.position_of(run.combination[factor.name]) - 1 for factor in model.factors] for run in model.plan()]
    )


@pytest.mark.parametrize(
    ("resolution", "factors", "runs"), [(r, k, n) for r, of in SMALLEST.items() for k, n in of.items()]
)
def test_a_fraction_is_as_small_as_the_published_one(resolution: int, factors: int, runs: int) -> None:
    model = RunTableModel(factors_of([2] * factors), design=FractionalFactorial(resolution=resolution))
    assert len(model.plan()) == runs
    assert model.design_facts["resolution"] >= resolution


@pytest.mark.parametrize(
    ("runs", "factors", "published"),
    [(runs, factors, words) for runs, of in LEAST_ALIASED.items() for factors, words in of.items()],
)
def test_no_fewer_short_words_alias_main_effects_and_interactions_in_the_published_fractions(
    runs: int, factors: int, published: tuple[int, int]
) -> None:
    assert short_words(FractionalFactorial(runs=runs)._words(NAMES_OF_MANY[:factors])) == published


@pytest.mark.long
@pytest.mark.parametrize(("runs", "factors"), [*((16, each) for each in range(6, 16)), (32, 7), (32, 8)])
def test_no_fraction_of_this_size_has_fewer_short_words(runs: int, factors: int) -> None:
    basic = [1 << place for place in reversed(range(runs.bit_length() - 1))]
    others = [word for word in range(1, runs) if word not in basic]
    every = (short_words([*basic, *chosen]) for chosen in combinations(others, factors - len(basic)))
    assert short_words(FractionalFactorial(runs=runs)._words(NAMES_OF_MANY[:factors])) == min(every)


@pytest.mark.parametrize(("factors", "runs"), LARGER.items())
def test_fractions_of_resolution_five_for_many_factors_are_twice_the_published_ones_at_most(
    factors: int, runs: int
) -> None:
    model = RunTableModel(factors_of([2] * factors), design=FractionalFactorial(resolution=5))
    assert runs < len(model.plan()) <= 2 * runs
    assert model.design_facts["resolution"] >= 5


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 8), st.sampled_from([3, 4, 5]))
def test_main_effects_are_orthogonal_and_aliases_are_those_of_the_columns(factors: int, resolution: int) -> None:
    model = RunTableModel(factors_of([2] * factors), design=FractionalFactorial(resolution=resolution))
    assert is_balanced(rows_of(model), model.factors)
    columns = dict(zip([factor.name for factor in model.factors], signs(model).T, strict=True))
    effects = {(name,): column for name, column in columns.items()}
    effects |= {pair: columns[pair[0]] * columns[pair[1]] for pair in combinations(columns, 2)}
    aliased = {
        frozenset(map(tuple, pair)) for group in model.design_facts["aliases"] for pair in combinations(group, 2)
    }
    same = {
        frozenset((one, other)) for one, other in combinations(effects, 2) if (effects[one] == effects[other]).all()
    }
    assert aliased == same
    crossed = [effects[one] @ effects[other] for one, other in combinations(effects, 2) if {one, other} not in same]
    assert not np.any(crossed), "effects that are not aliased are orthogonal"


def test_generators_give_the_fraction_that_pydoe_gives() -> None:
    design = FractionalFactorial(generators={"D": ["A", "B"], "E": ["A", "C"]})
    model = RunTableModel([Factor(name, [-1, 1]) for name in NAMES[:5]], design=design)
    assert set(map(tuple, signs(model))) == set(map(tuple, pyDOE3.fracfact("a b c ab ac").astype(int)))
    assert [["D"], ["A", "B"]] in [group[:2] for group in model.design_facts["aliases"]]


def test_a_thousand_factors_are_planned_in_seconds() -> None:
    begin = time.process_time()
    model = RunTableModel(factors_of([2] * 1000), design=FractionalFactorial(resolution=3))
    assert len(model.plan()) == 1024
    assert model.design_facts["aliases_listed"] is False
    assert time.process_time() - begin < 10


def test_exclusions_are_never_in_the_plan_and_what_they_cost_is_said() -> None:
    model = RunTableModel(factors_of([2] * 4), [{"F0": "t0", "F1": "t0"}], design=FractionalFactorial())
    assert not [run for run in model.plan() if run.combination["F0"] == run.combination["F1"] == "t0"]
    assert [str(each) for each in model.warnings] == [
        (
            "exclude_combinations: the exclusions take 2 of the 8 combinations out of the design: its effects are no "
            "longer orthogonal → DOptimal(runs=...) chooses around exclusions."
        )
    ]


def test_all_that_keeps_a_fraction_from_being_is_said_at_once() -> None:
    assert findings_of(
        [*factors_of([2, 3, 2]), Factor("Inner", [1, 2], when={"F0": "t0"})], design=FractionalFactorial(runs=6)
    ) == [
        (
            "factor 'F1': the factor has 3 treatments, and a fraction takes two → Give it two, or choose "
            "CoveringArray or DOptimal, which take any number."
        ),
        (
            "factor 'Inner': the factor has 3 treatments, and a fraction takes two → Give it two, or choose "
            "CoveringArray or DOptimal, which take any number."
        ),
        "design: runs=6 is not a power of two → Give 8 or 16.",
    ]
    two = factors_of([2] * 5)
    assert findings_of(two, design=FractionalFactorial(generators={"F3": ["F0", "F9"], "F5": ["F1"]})) == [
        "generators['F3']: there is no factor 'F9' → Choose one of: 'F0', 'F1', 'F2', 'F4'.",
        "generators['F5']: there is no factor 'F5' → Choose one of: 'F0', 'F1', 'F2', 'F3', 'F4'.",
    ]
    for runs, fix in ((3, "Give 4."), (5, "Give 4 or 8."), (100, "Give 8.")):  # never more than the full factorial has
        count = 2 if runs == 3 else 3
        (odd,) = findings_of(factors_of([2] * count), design=FractionalFactorial(runs=runs))
        assert odd.endswith(f"not a power of two → {fix}")
    assert "could not be told apart" in findings_of(two, design=FractionalFactorial(generators={"F3": ["F0"]}))[0]
    assert "cannot tell the main effects" in findings_of(two, design=FractionalFactorial(runs=4))[0]
    many = findings_of(factors_of([2] * 40), design=FractionalFactorial(runs=2**40))
    assert many == ["design: runs=1,099,511,627,776 is more than 10,000,000 → Give 10,000,000 or less."]
    assert "no factor ['F0']" in findings_of(two, design=FractionalFactorial(generators={"F3": [["F0"], "F1"]}))[0]
    assert "none of 3, 4 and 5" in findings_of(two, design=FractionalFactorial(resolution=2))[0]
    assert "one follows from the other" in findings_of(two, design=FractionalFactorial(resolution=3, runs=8))[0]
    assert "more than 4,096 runs" in findings_of(factors_of([2] * 200), design=FractionalFactorial(resolution=5))[0]
