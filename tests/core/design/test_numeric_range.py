"""A range says what a numeric factor may be set to; nothing outside it is ever planned."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError


def said(*arguments: Any, **keywords: Any) -> list[str]:
    with pytest.raises(DesignError) as caught:
        Range(*arguments, **keywords)
    return [str(finding) for finding in caught.value.findings]


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.floats(0, 1))
def test_a_value_is_within_the_range_near_its_share_and_short(lower: float, width: float, share: float) -> None:
    lower, upper = round(lower, 3), round(lower + width + 0.001, 3)
    span = Range(lower, upper)
    value = span.at(share)
    assert lower <= value <= upper
    assert abs(value - (lower + (upper - lower) * share)) <= (upper - lower) / 1000
    assert len(repr(value)) <= 16
    assert (span.at(0), span.at(1)) == (lower, upper)


def test_steps_and_whole_numbers_are_kept_to() -> None:
    assert [Range(0.05, 0.22, step=0.05).at(share / 3) for share in range(4)] == [0.05, 0.1, 0.15, 0.2]
    assert [Range(1, 4).at(share / 3) for share in range(4)] == [1, 2, 3, 4]
    assert type(Range(1, 4).at(0.4)) is int
    assert Range(0, 1.0).at(0.12345) == 0.123


@pytest.mark.parametrize("step", [0.3, 0.4, 0.6, 0.7, 0.1, 0.5, 1])
def test_a_range_ends_at_its_last_step_with_and_without_a_design(step: float) -> None:
    span = Range(0, 1, step=step)
    multiples = [round(number * step, 3) for number in range(11) if number * step < 1 + 1e-9]
    assert [span.at(number / span.step_count) for number in range(span.step_count + 1)] == multiples
    assert Factor("Load", span).treatments == (0, multiples[-1])


def test_what_is_no_range_is_told_at_once() -> None:
    assert said("a", True, unit=3) == [
        "Range: lower is 'a', of type str → Give a finite number.",
        "Range: upper is True, of type bool → Give a finite number.",
        "Range: the unit 3 is not text → Give it as in unit='m/s'.",
    ]
    assert said(2, 1) == ["Range: the lower end 2 is not below the upper end 1 → Give the lower end first."]
    assert "no wider than the range" in said(0, 1, step=2)[0]
    assert "finite" in said(0, float("inf"))[0]


def test_without_a_design_a_range_has_its_two_ends() -> None:
    model = RunTableModel([Factor("Speed", Range(0.05, 0.22, unit="m/s")), Factor("Load", [1, 2], unit="kg")])
    assert [run.combination["Speed"] for run in model.plan()] == [0.05, 0.05, 0.22, 0.22]
    assert [factor.unit for factor in model.factors] == ["m/s", "kg"]
    with pytest.raises(DesignError, match="is given beside a range"):
        Factor("Speed", Range(0, 1), unit="m/s")


def test_numbers_of_numpy_are_taken_as_pythons() -> None:
    numpy = pytest.importorskip("numpy")
    span = Range(numpy.float64(0.05), numpy.float64(0.22), step=numpy.float64(0.05))
    assert [span.at(share / 3) for share in range(4)] == [0.05, 0.1, 0.15, 0.2]
    assert Factor("Speed", Range(numpy.float64(0.05), numpy.float64(0.22))).treatments == (0.05, 0.22)
    assert {type(each) for each in (span.lower, span.upper, span.step)} == {float}


@pytest.mark.parametrize(("lower", "upper"), [(0, 10**400), (0, 5e-324), (-1.7e308, 1.7e308), (-(10**400), 0)])
def test_ends_between_which_nothing_can_be_computed_are_refused(lower: float, upper: float) -> None:
    assert said(lower, upper)
