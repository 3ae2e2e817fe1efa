"""A bound is what a user says that would not matter."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.analysis.comparison.compared import Bound, Bounds
from robot_runner.core.errors import AnalysisError


@given(st.floats(min_value=1e-9, max_value=99.0))
def test_a_percentage_is_of_the_first_mean_whatever_its_sign(value):
    bound = Bound(value, is_relative=True)
    assert bound.in_units(-200.0) == bound.in_units(200.0) == pytest.approx(2 * value)


@pytest.mark.parametrize("text", ["", "%", "five", "5%%", "nan", "inf", "-1", "0", "100%", "150%", "5 J"])
def test_what_is_no_bound_is_refused_with_a_way_out(text):
    with pytest.raises(AnalysisError) as caught:
        Bound.parse(text)
    assert "--bound 5%" in caught.value.fix


def test_a_name_may_hold_an_equals_sign():
    assert Bounds.parse(["a=b=5%"]).own == {"a=b": Bound(5.0, is_relative=True)}


@pytest.mark.parametrize("texts", [["5%", "10"], ["E=5", "E=6"]])
def test_a_second_bound_is_refused(texts):
    with pytest.raises(AnalysisError, match="second bound"):
        Bounds.parse(texts)


def test_a_measure_without_a_bound_of_its_own_has_the_general_one():
    bounds = Bounds.parse(["5%", "Energy=10"])
    assert bounds.of("CPU") == Bound(5.0, is_relative=True)
    assert bounds.of("Energy") == Bound(10.0)
    assert Bounds.parse(["Energy=10"]).of("CPU") is None
