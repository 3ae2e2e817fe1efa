"""D-optimal designs are as efficient as can be, and choose only among what the exclusions leave."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.designs.factor_sets import excluded_designs, factors_of, findings_of, is_balanced, numeric, rows_of

from robot_runner import INACTIVE, Factor, Range, RunTableModel
from robot_runner.core.errors import DesignError
from robot_runner.designs import DOptimal, optimal


@pytest.mark.parametrize(("levels", "runs"), [([2] * 3, 4), ([2] * 7, 8), ([3] * 4, 9), ([2, 3], 6), ([4, 2, 2], 8)])
def test_an_orthogonal_design_is_found_where_there_is_one(levels: list[int], runs: int) -> None:
    model = RunTableModel(factors_of(levels), design=DOptimal(runs=runs))
    assert model.design_facts["d_efficiency"] == pytest.approx(1)
    assert is_balanced(rows_of(model), model.factors)


def test_the_best_subset_of_all_is_found() -> None:
    design = DOptimal(runs=7, model="interactions")
    model = RunTableModel(factors_of([2, 2, 2]), [{"F0": "t0", "F1": "t0", "F2": "t0"}], design=design)
    with_numbers = np.array([[1 if each == "t1" else -1 for each in row] for row in rows_of(model)])
    pairs = [with_numbers[:, one] * with_numbers[:, other] for one, other in combinations(range(3), 2)]
    matrix = np.column_stack([np.ones(7), with_numbers, *pairs])
    # The only seven that are left.
    assert model.design_facts["d_efficiency"] == pytest.approx(
        np.linalg.det(matrix.T @ matrix) ** (1 / 7) / 7, abs=1e-4
    )
    six = RunTableModel(factors_of([3, 3]), [{"F0": "t0", "F1": "t0"}], design=DOptimal(runs=6))
    assert six.design_facts["d_efficiency"] == pytest.approx(_best_efficiency(), abs=1e-4)


def _best_efficiency() -> float:
    """Return the efficiency of the best six of the eight combinations of two factors that are left, by trying all."""
    contrasts = np.array([[-1.2247449, -0.7071068], [1.2247449, -0.7071068], [0, 1.4142136]])
    rows = [
        np.concatenate([[1], contrasts[one], contrasts[other]])
        for one in range(3)
        for other in range(3)
        if (one, other) != (0, 0)
    ]
    determinants = (np.linalg.det(np.array(six).T @ np.array(six)) for six in combinations(rows, 6))
    return float(max(determinants) ** (1 / 5) / 6)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(excluded_designs(), st.integers(0, 6), st.sampled_from(["main", "interactions"]))
def test_no_excluded_combination_is_chosen_none_twice_and_as_many_as_are_asked_for(
    drawn: tuple[list[Factor], list[dict[str, object]]], more: int, of: str
) -> None:
    factors, exclusions = drawn
    allowed = rows_of(RunTableModel(factors, exclusions))
    runs = min(len(allowed), 3 + 2 * len(factors) + more)
    design = DOptimal(runs=runs, model=of)
    try:
        model = RunTableModel(factors, exclusions, design=design)
    except DesignError as error:
        assert "parameters" in str(error) or "apart" in str(error)  # noqa: PT017 - either is right here
        return
    rows = rows_of(model)
    assert set(rows) <= set(allowed)
    assert len(set(rows)) == len(rows) == runs
    assert rows_of(RunTableModel(factors, exclusions, design=design)) == rows


def test_squares_of_numeric_factors_bring_a_third_value() -> None:
    model = RunTableModel([*numeric("AB"), *factors_of([2])], design=DOptimal(runs=12, model="quadratic"))
    assert [factor.treatments for factor in model.factors[:2]] == [(0.0, 5.0, 10.0)] * 2
    assert len(RunTableModel(numeric("AB"), design=DOptimal(runs=4)).factors[0].treatments) == 2
    assert [*map(str, rows_of(model.repeated(2)))] == [*map(str, rows_of(model))] * 2


def test_a_conditional_factor_is_estimated_where_it_applies() -> None:
    inner = Factor("Inner", ["x", "y"], when={"F0": "t0"})
    rows = rows_of(RunTableModel([*factors_of([2, 3]), inner], design=DOptimal(runs=9, model="interactions")))
    assert all((row[2] is INACTIVE) == (row[0] == "t1") for row in rows)
    assert {row[2] for row in rows} == {"x", "y", INACTIVE}


@pytest.mark.long
def test_a_large_factorial_is_sampled() -> None:
    model = RunTableModel(factors_of([3] * 12), design=DOptimal(runs=27))
    assert model.design_facts["candidates"] == 4000
    assert model.design_facts["d_efficiency"] > 0.8


def test_none_is_chosen_twice_where_many_draws_of_a_large_factorial_are_one_combination(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(optimal, "_MOST_CANDIDATES", 100)
    inner = [Factor(f"Inner{number}", ["x", "y"], when={"F0": "t0"}) for number in range(7)]
    rows = rows_of(RunTableModel([*factors_of([2]), *inner], design=DOptimal(runs=24)))
    assert len(set(rows)) == len(rows) == 24


def test_what_cannot_be_estimated_is_said() -> None:
    factors = factors_of([2, 3])
    assert findings_of(factors, design=DOptimal(runs=3)) == [
        "design: runs=3, and the model 'main' has 4 parameters → Give 4 runs or more, or a smaller model."
    ]
    assert findings_of(factors, design=DOptimal(runs=7)) == [
        "design: runs=7, and the full factorial has 6 → Give 6 or fewer, or leave the design out."
    ]
    assert findings_of(factors, design=DOptimal(runs=4, model="mian")) == [
        "design: there is no model 'mian' → Did you mean 'main'?"
    ]
    coarse = [Factor("Speed", Range(0, 1)), *numeric("A")]
    assert "leave two values" in findings_of(coarse, design=DOptimal(runs=6, model="quadratic"))[0]
    assert findings_of(numeric("AB"), design=DOptimal(runs=5)) == [
        "design: runs=5, and there are 4 combinations of the values that the model takes → Give 4 runs or fewer."
    ]
    exclusions = [{"F0": "t0", "F1": ["t1", "t2"]}, {"F0": "t1", "F1": "t0"}]
    assert "the exclusions leave 3" in findings_of(factors, exclusions, design=DOptimal(runs=4))[0]
    assert (
        "apart"
        in findings_of(
            factors_of([2, 2, 2]), [{"F0": "t0", "F1": "t1"}, {"F0": "t1", "F1": "t0"}], design=DOptimal(runs=4)
        )[0]
    )
