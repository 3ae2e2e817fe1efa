"""Central composite and Box-Behnken designs are those of the books, within the ranges."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pyDOE3
import pytest
from tests.designs.factor_sets import NAMES, factors_of, findings_of, numeric, rows_of

from robot_runner import Factor, Range, RunTableModel
from robot_runner.designs import BoxBehnken, CentralComposite


def coded(model: RunTableModel) -> np.ndarray:
    """Return the points of ranges from 0 to 10 with coordinates from -1 to 1."""
    return np.array(rows_of(model)) / 5 - 1


def points(matrix: np.ndarray) -> Counter[tuple[float, ...]]:
    return Counter(tuple(float(round(each, 2)) + 0.0 for each in row) for row in matrix)


@pytest.mark.parametrize("factors", [2, 3, 4])
@pytest.mark.parametrize("axial", ["inscribed", "faced"])
def test_a_central_composite_design_is_that_of_pydoe(factors: int, axial: str) -> None:
    model = RunTableModel(numeric(NAMES[:factors]), design=CentralComposite(centre=4, axial=axial))
    theirs = pyDOE3.ccdesign(factors, center=(0, 4), alpha="rotatable", face=axial)
    if factors > 2:  # the book's rule for the corners of 3 factors and more is a fraction of resolution 5, or all
        assert len(model.plan()) == 2**factors + 2 * factors + 4
    assert points(coded(model)) == points(theirs)
    assert abs(coded(model)).max() <= 1


@pytest.mark.parametrize("factors", [3, 4, 5])
def test_a_box_behnken_design_is_that_of_pydoe(factors: int) -> None:
    model = RunTableModel(numeric(NAMES[:factors]), design=BoxBehnken(centre=3))
    assert points(coded(model)) == points(pyDOE3.bbdesign(factors, center=3))


@pytest.mark.parametrize(("factors", "runs"), [(6, 54), (7, 62)])
def test_triples_of_six_and_seven_factors_are_balanced_as_published(factors: int, runs: int) -> None:
    # Box & Behnken (1960), Technometrics 2(4), table 4: 48 + 6 and 56 + 6 runs; a second-order design without bias.
    matrix = coded(RunTableModel(numeric(NAMES[:factors]), design=BoxBehnken(centre=6)))
    assert len(matrix) == runs
    assert set(np.abs(matrix).sum(axis=1)) == {0, 3}
    assert not np.any(matrix.sum(axis=0))
    assert not np.any(matrix.T @ matrix - np.diag([24] * factors)), (
        "main effects are orthogonal, each at its ends 24 times"
    )


@pytest.mark.parametrize("design", [CentralComposite(), BoxBehnken()])
def test_all_coefficients_of_a_quadratic_surface_can_be_estimated(design: object) -> None:
    matrix = coded(RunTableModel(numeric("ABCDE"), design=design))
    pairs = [matrix[:, one] * matrix[:, other] for one in range(5) for other in range(one, 5)]
    model = np.column_stack([np.ones(len(matrix)), matrix, *pairs])
    assert np.linalg.matrix_rank(model) == model.shape[1] == 21


def test_exclusions_leave_points_out_and_say_so() -> None:
    model = RunTableModel(numeric("AB"), [lambda each: each["A"] == 10], design=CentralComposite(centre=1))
    assert 10 not in {run.combination["A"] for run in model.plan()}
    assert "the surface may not be estimable" in str(model.warnings[0])


def test_steps_that_are_too_coarse_for_the_points_are_said() -> None:
    whole = [Factor("Robots", Range(1, 4)), *numeric("A")]
    model = RunTableModel(whole, design=CentralComposite())
    (coarse,) = map(str, model.warnings)
    assert coarse.startswith("factor 'Robots': its steps leave 3 of the 5 values of the design: points fall together")
    assert not RunTableModel(whole, design=CentralComposite(axial="faced")).warnings
    for design in (CentralComposite(), CentralComposite(axial="faced"), BoxBehnken()):
        (two,) = findings_of([Factor("Robots", Range(1, 2)), *numeric("AB")], design=design)
        assert "its steps leave two values: a surface takes three" in two


def test_what_is_no_surface_is_said_at_once() -> None:
    assert findings_of([*numeric("A"), *factors_of([2])], design=BoxBehnken(centre=0)) == [
        "design: centre=0 is less than 1 → Give a whole number from 1.",
        (
            "factor 'F0': the factor has listed treatments: a surface takes numbers → Give it a range and no "
            "condition, as in Range(0.05, 0.22), or choose DOptimal."
        ),
        "design: there are 2 factors, and the design takes 3 → Add one, or choose another design.",
    ]
    assert "neither 'inscribed' nor 'faced'" in findings_of(numeric("AB"), design=CentralComposite(axial="out"))[0]
    assert "axial=['faced'] is neither" in findings_of(numeric("AB"), design=CentralComposite(axial=["faced"]))[0]
    assert "centre=1,000,000,000 is more" in findings_of(numeric("AB"), design=CentralComposite(centre=10**9))[0]
    assert "known for 3 to 7" in findings_of(numeric(NAMES), design=BoxBehnken())[0]
