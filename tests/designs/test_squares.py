from __future__ import annotations

from collections import Counter
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError
from robot_runner.designs import GraecoLatinSquare, LatinSquare
from robot_runner.designs.squares import has_orthogonal_pair, orthogonal_pair

SEEDS = st.integers(0, 2**32 - 1)


def factors_of(order: int, *names: str) -> list[Factor]:
    return [Factor(name, range(order)) for name in names]


def assert_each_pair_once(runs: list, one: str, other: str, times: int = 1) -> None:
    pairs = Counter((run.combination[one], run.combination[other]) for run in runs)
    assert set(pairs.values()) == {times}
    assert len(pairs) == len({a for a, _ in pairs}) * len({b for _, b in pairs})


@settings(deadline=None, max_examples=30)
@given(order=st.integers(2, 9), repetitions=st.integers(1, 3), seed=SEEDS, shuffle=st.booleans())
def test_each_treatment_comes_once_in_each_row_and_column_of_each_square(
    order: int, repetitions: int, seed: int, shuffle: bool
) -> None:
    factors = factors_of(order, "Day", "Robot", "Planner")
    design = LatinSquare("Day", "Robot")
    model = RunTableModel(factors, repetitions=repetitions, seed=seed, shuffle=shuffle, design=design)
    runs = list(model.plan())
    assert len(runs) == order**2 * repetitions
    for number in range(1, repetitions + 1):
        square = [run for run in runs if run.repetition == number]
        for one, other in (("Day", "Robot"), ("Day", "Planner"), ("Robot", "Planner")):
            assert_each_pair_once(square, one, other)
    assert [run.combination["Day"] for run in runs] == [day for day in range(order) for _ in range(order)] * repetitions
    again = RunTableModel(factors, repetitions=repetitions, seed=seed, shuffle=shuffle, design=design)
    assert list(again.plan()) == runs, "the same seed gives the same plan"
    fewer = RunTableModel(factors, repetitions=1, seed=seed, shuffle=shuffle, design=design)
    assert list(fewer.plan()) == runs[: order**2], "further squares leave the first one as it is"


@pytest.mark.parametrize("order", [3, 4, 5, 7, 8, 9, 10, 12, 14, 15, 18, 20, 22, 26, 30, 34, 38])
def test_there_are_two_orthogonal_squares_of_each_order_but_2_and_6(order: int) -> None:
    """The orders of Bose, Shrikhande and Parker (1960), all constructions: fields, products, Parker's, Wilson's, 14."""
    pair = orthogonal_pair(order)
    symbols = list(range(order))
    for square in pair:
        assert all(sorted(row) == symbols for row in square)
        assert all(sorted(column) == symbols for column in zip(*square, strict=True))
    cells = product(range(order), repeat=2)
    assert len({(pair[0][row][column], pair[1][row][column]) for row, column in cells}) == order**2
    assert [each for each in range(1, 100) if not has_orthogonal_pair(each)] == [2, 6]


@settings(deadline=None, max_examples=15)
@given(order=st.sampled_from([3, 4, 5, 7, 10]), seed=SEEDS, repetitions=st.integers(1, 2))
def test_a_graeco_latin_square_shows_all_pairs_of_its_four_factors_once(
    order: int, seed: int, repetitions: int
) -> None:
    names = ("Day", "Robot", "Operator", "Planner")
    for greek in ("Operator", None):
        model = RunTableModel(
            factors_of(order, *names),
            repetitions=repetitions,
            seed=seed,
            shuffle=True,
            design=GraecoLatinSquare("Day", "Robot", greek),
        )
        for number in range(1, repetitions + 1):
            square = [run for run in model.plan() if run.repetition == number]
            for one, other in (pair for pair in product(names, repeat=2) if pair[0] < pair[1]):
                assert_each_pair_once(square, one, other)
        assert model.design_facts["block_columns"] == ["Day", "Robot", *(["Operator"] if greek else [])]


def test_the_treatments_of_a_square_may_be_combinations_that_exclusions_leave() -> None:
    factors = [*factors_of(3, "Day", "Robot"), Factor("Planner", ["A", "B"]), Factor("Speed", [0.1, 0.2])]
    without = [{"Planner": "B", "Speed": 0.2}]
    runs = list(RunTableModel(factors, without, design=LatinSquare("Day", "Robot")).plan())
    assert len(runs) == 9
    assert Counter((run.combination["Planner"], run.combination["Speed"]) for run in runs) == dict.fromkeys(
        [("A", 0.1), ("A", 0.2), ("B", 0.1)], 3
    )


@pytest.mark.parametrize(
    ("model", "problem", "fix"),
    [
        (
            lambda: RunTableModel(
                factors_of(6, "Day", "Robot", "Operator", "Planner"),
                design=GraecoLatinSquare("Day", "Robot", "Operator"),
            ),
            "there is no Graeco-Latin square of order 6",
            "5 or 7 treatments",
        ),
        (
            lambda: RunTableModel(factors_of(3, "Day", "Robot", "Planner"), design=LatinSquare("Day", "Robt")),
            "there is no factor 'Robt'",
            "Did you mean 'Robot'?",
        ),
        (
            lambda: RunTableModel(
                [*factors_of(3, "Day", "Robot"), Factor("Planner", ["A", "B"])],
                design=LatinSquare("Day", "Robot"),
            ),
            "Planner has 2 combinations, and the square has 3 rows and columns",
            "Have 3 of them",
        ),
        (
            lambda: RunTableModel(
                [Factor("Day", [1, 2]), *factors_of(3, "Robot", "Planner")], design=LatinSquare("Day", "Robot")
            ),
            "Day has 2, Robot has 3",
            "equally many",
        ),
        (
            lambda: RunTableModel(
                factors_of(3, "Day", "Robot", "Planner"), [{"Day": 1, "Planner": 2}], design=LatinSquare("Day", "Robot")
            ),
            "Planner=2 is excluded where Day=1, Robot=0, and not everywhere",
            "Exclude by 'Planner' alone",
        ),
        (
            lambda: RunTableModel(
                factors_of(3, "Day", "Robot", "A", "B"), [{"A": 1, "B": 2}], design=GraecoLatinSquare("Day", "Robot")
            ),
            "is excluded, and each pair of treatments comes once",
            "Leave the exclusion out",
        ),
        (
            lambda: RunTableModel(factors_of(3, "Day", "Robot", "A"), design=GraecoLatinSquare("Day", "Robot")),
            "1 factors are studied beside rows and columns, and a square holds two",
            "have two",
        ),
        (
            lambda: RunTableModel(factors_of(3, "Day", "Robot"), design=LatinSquare("Day", "Robot")),
            "no factor is left to be studied",
            "Add one",
        ),
        (
            lambda: RunTableModel(factors_of(3, "Day", "Robot", "P"), blocks="Day", design=LatinSquare("Day", "Robot")),
            "the design makes blocks of its own",
            "Leave blocks out",
        ),
    ],
)
def test_a_square_that_cannot_be_is_a_finding_with_its_fix(model: object, problem: str, fix: str) -> None:
    with pytest.raises(DesignError) as caught:
        model()
    assert problem in str(caught.value)
    assert fix in str(caught.value)
