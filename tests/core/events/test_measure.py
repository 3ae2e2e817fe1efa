from __future__ import annotations

import re
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import MeasureError
from robot_runner.core.events.measure import Measure, Over, as_measure_value


@given(
    st.none()
    | st.booleans()
    | st.integers(-(2**1000), 2**1000)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(min_size=1)
)
def test_plain_values_stay_what_they_are(value: object) -> None:
    taken = as_measure_value("Energy", value, where="config")
    assert taken == value
    assert type(taken) is type(value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf"), Fraction(10**400, 3)])
def test_a_number_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(MeasureError, match="not a finite number"):
        as_measure_value("Energy", value, where="config")


@pytest.mark.parametrize("value", [[1.0], {"a": 1}, object(), b"1", 1j])
def test_what_no_cell_can_hold_is_refused_with_its_type(value: object) -> None:
    with pytest.raises(MeasureError, match=type(value).__name__):
        as_measure_value("Energy", value, where="config")


def test_numbers_of_other_libraries_become_plain() -> None:
    numpy = pytest.importorskip("numpy")
    for value, expected in [
        (numpy.float32(0.5), 0.5),
        (numpy.int64(7), 7),
        (numpy.bool_(True), True),
        (numpy.array(2.5), 2.5),
        (Fraction(1, 2), 0.5),
    ]:
        taken = as_measure_value("Energy", value, where="config")
        assert taken == expected
        assert type(taken) is type(expected)


def test_an_array_of_several_numbers_is_refused() -> None:
    numpy = pytest.importorskip("numpy")
    with pytest.raises(MeasureError):
        as_measure_value("Energy", numpy.array([1.0, 2.0]), where="config")


def test_what_is_masked_or_a_time_is_no_number() -> None:
    numpy = pytest.importorskip("numpy")
    masked = numpy.ma.array([1.0, 2.0], mask=True)
    times = (numpy.timedelta64(15, "ns"), numpy.datetime64(1, "ns"))
    for value in (masked.mean(), numpy.ma.array(3.5, mask=True), *times):
        with pytest.raises(MeasureError, match="which is of type"):
            as_measure_value("Energy", value, where="config")
    assert as_measure_value("Energy", numpy.ma.array([1.0, 2.0], mask=[True, False]).mean(), where="config") == 2.0
    assert as_measure_value("Energy", numpy.ma.array(3.5), where="config") == 3.5


def test_an_empty_text_is_a_missing_value_as_in_the_run_table() -> None:
    assert as_measure_value("Mode", "", where="config") is None


def test_a_decimal_is_refused_rather_than_rounded() -> None:
    with pytest.raises(MeasureError, match="Decimal"):
        as_measure_value("Energy", Decimal("0.1"), where="config")


@pytest.mark.parametrize(
    ("value", "problem"), [("a\ud800", "UTF-8"), (1 << 1025, "1026 bits"), (2**1024 - 1, "1024 bits")]
)
def test_what_no_file_could_hold_is_refused(value: object, problem: str) -> None:
    with pytest.raises(MeasureError, match=problem):
        as_measure_value("Energy", value, where="config")


class _Mode(str, Enum):  # noqa: UP042 - as it was written before Python 3.11, with another str()
    FAST = "fast"


def test_a_text_that_is_a_whole_file_is_refused_with_where_to_write_it() -> None:
    """The journal shortened one of 16 MB in silence; forty of 9 MB made a run table that nothing could read again."""
    assert as_measure_value("Log", "x" * 1_000_000, where="Chatty") == "x" * 1_000_000
    with pytest.raises(MeasureError, match="'Log' got a text of 1,000,001 characters") as refused:
        as_measure_value("Log", "x" * 1_000_001, where="Chatty")
    assert "raw_data_folder" in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_text_of_another_class_becomes_the_plain_text_that_it_is() -> None:
    numpy = pytest.importorskip("numpy")
    for value in (_Mode.FAST, numpy.str_("fast")):
        taken = as_measure_value("Mode", value, where="config")
        assert (taken, type(taken), str(taken)) == ("fast", str, "fast")


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"name": 7}, "the name is of type int"),
        ({"name": "run_id"}, "the run table has a column of that name already"),
        ({"name": "Mean\nPower"}, "which no heading can hold"),
        ({"unit": None}, "unit is None"),
        ({"description": 3}, "description is 3"),
        ({"over": "sum"}, "over is 'sum'"),
        ({"low": "1"}, "low is '1'"),
        ({"high": float("nan")}, "high is nan"),
        ({"low": True}, "low is True"),
    ],
)
def test_a_measure_that_cannot_be_is_refused_where_it_is_declared(given: dict[str, Any], problem: str) -> None:
    with pytest.raises(MeasureError, match=re.escape(problem)) as caught:
        Measure(**{"name": "Energy", **given})
    assert caught.value.fix


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (25.0000001, "the value, 25.0000001 W, is above 25 W, the largest that is plausible"),
        (0.1, "the value, 0.1 W, is below 0.5 W, the least that is plausible"),
        (1234567.5, "the value, 1234567.5 W, is above 25 W, the largest that is plausible"),
        (10**308, f"the value, {10**308} W, is above 25 W, the largest that is plausible"),
        (2**1024 - 1, f"the value, {2**1024 - 1} W, is above 25 W, the largest that is plausible"),
        (25, ""),
    ],
)
def test_what_is_not_plausible_is_told_as_it_is(value: float, told: str) -> None:
    assert Measure("MeanPower", "W", low=0.5, high=25.0).implausible(value) == told


@pytest.mark.parametrize("over", Over)
@pytest.mark.parametrize("low", [None, -5.0, 0.0, 4.0])
def test_a_part_of_a_sum_or_of_a_maximum_may_be_less_than_the_least_of_the_whole(over, low):
    may_be_less = over in {Over.SUM, Over.MAXIMUM} and low == 4.0
    phase = Measure("Energy", "J", "Energy drawn.", over=over, low=low, high=30.0).in_phase("drive")
    assert (phase.low, phase.high) == (None if may_be_less else low, 30.0)
