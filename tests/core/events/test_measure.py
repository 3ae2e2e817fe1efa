from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import MeasureError
from robot_runner.core.events.measure import as_measure_value


@given(
    st.none()
    | st.booleans()
    | st.integers(-(2**1000), 2**1000)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text()
)
def test_plain_values_stay_what_they_are(value: object) -> None:
    taken = as_measure_value("Energy", value, where="config")
    assert taken == value
    assert type(taken) is type(value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
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


def test_a_decimal_is_refused_rather_than_rounded() -> None:
    with pytest.raises(MeasureError, match="Decimal"):
        as_measure_value("Energy", Decimal("0.1"), where="config")


@pytest.mark.parametrize(("value", "problem"), [("a\ud800", "UTF-8"), (1 << 1025, "1026 bits")])
def test_what_no_file_could_hold_is_refused(value: object, problem: str) -> None:
    with pytest.raises(MeasureError, match=problem):
        as_measure_value("Energy", value, where="config")
