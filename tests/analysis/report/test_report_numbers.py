"""Numbers are shown in as many digits as they deserve."""

from __future__ import annotations

import json
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.report.document import plain, report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.wording import (
    MINUS,
    MISSING,
    TIMES,
    digits_beside,
    shown_coefficient,
    shown_number,
    shown_p,
    shown_share,
    shown_test,
    with_unit,
)


def read(shown):
    """Return the number that a reader sees."""
    mantissa, _, power = shown.partition(f"{TIMES}10")
    return float(f"{mantissa.replace(',', '')}e{power.translate(str.maketrans('⁰¹²³⁴⁵⁶⁷⁸⁹⁻', '0123456789-')) or 0}")


@given(st.floats(min_value=1e-300, max_value=1e300))
def test_a_number_is_shown_within_half_of_its_fourth_digit(value):
    assert read(shown_number(value)) == pytest.approx(value, rel=5.1e-4)
    assert shown_number(-value) == f"{MINUS}{shown_number(value)}"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0, "0"),
        (0.0, "0"),
        (16, "16"),
        (285000, "285,000"),
        (2**60 + 1, "1,152,921,504,606,846,977"),
        (16.0, "16.00"),
        (9999.6, "10,000"),
        (12345.6, "12,346"),
        (2.5e-5, f"2.500{TIMES}10⁻⁵"),
        (1006000000.0, f"1.006{TIMES}10⁹"),
        (-1.23456e123, f"{MINUS}1.235{TIMES}10¹²³"),
    ],
)
def test_numbers_as_a_reader_sees_them(value, shown):
    assert shown_number(value) == shown


@pytest.mark.parametrize(
    ("value", "spread", "shown"),
    [
        (3.4523812, 0.0001476, "3.45238"),
        (877.1234, 4.7, "877.1"),
        (1234567.891, 0.034, "1,234,567.891"),
        (123456.78, 9.0, "123,456.8"),
        (123456.78, 12.0, "123,457"),
        (-1700000000.25, 0.5, f"{MINUS}1.70000000025{TIMES}10⁹"),
        (5.0, 1e-30, "5.000"),
        (5.1, 9e-16, "5.100"),
        (12.3, None, "12.30"),
        (5.0, 0.0, "5.000"),
        (0.0, 0.1, "0"),
    ],
)
def test_a_mean_is_shown_to_the_second_digit_of_its_spread_unless_that_is_rounding(value, spread, shown):
    assert shown_number(value, digits_beside(value, spread)) == shown


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_what_is_missing_is_a_dash(value):
    assert shown_number(value) == shown_p(value) == with_unit(value, "J") == MISSING


def test_a_count_has_no_unit():
    assert with_unit(3, "1") == "3"


@given(st.floats(min_value=0.0, max_value=1.0))
def test_a_p_value_is_never_shown_as_zero(p_value):
    assert shown_p(p_value) != "0.000"


@pytest.mark.parametrize(
    ("p_value", "shown"),
    [
        (0.0496, "0.0496"),
        (0.0504, "0.0504"),
        (0.049_999_7, "0.0499997"),
        (0.05, "0.050"),
        (0.0098, "0.0098"),
        (0.010_49, "0.0105"),
        (0.001_2, "0.001"),
        (0.0996, "0.0996"),
        (0.2, "0.200"),
        (float(stats.f.sf(19, 2, 2)), "0.050"),  # 0.05 but for rounding
    ],
)
def test_a_p_value_is_not_rounded_to_the_level_that_it_lies_below_or_above(p_value, shown):
    assert shown_p(p_value) == shown


@given(st.floats(min_value=0.0, max_value=1.0))
def test_a_p_value_is_shown_on_its_side_of_each_usual_level(p_value):
    shown = shown_p(p_value)
    for level in (0.1, 0.05, 0.01, 0.005):
        if p_value == pytest.approx(level, rel=1e-12):
            assert float(shown) == level
            continue
        assert (float(shown.removeprefix("< ")) < level) == (p_value < level)


@given(st.floats(min_value=0.0, max_value=1.0))
def test_a_coefficient_or_a_share_below_1_is_not_shown_as_1(value):
    assert (read(shown_coefficient(value)) < 1) == (float(shown_share(value).rstrip("%")) < 100) == (value < 1)
    assert read(shown_coefficient(value)) == pytest.approx(value, rel=5.1e-3)
    assert shown_coefficient(-value).lstrip(MINUS) == shown_coefficient(value)


def test_a_coefficient_or_a_statistic_that_is_missing_is_a_dash():
    assert shown_coefficient(None) == shown_coefficient(math.nan) == MISSING
    assert shown_test("t", (8, 2.5), None) == f"t(8, 2.50) = {MISSING}"


@pytest.mark.parametrize("sign", [1, -1])
def test_a_number_is_rounded_alike_in_sentences_tables_and_captions(make_folder, sign):
    energies = [sign * (30 * (place % 2) + place) for place in range(40)]
    rows = [("ab"[place % 2], energy, energy + 0.3 * (place % 3)) for place, energy in enumerate(energies)]
    folder = make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "Time": "s"})
    results = load_results(folder.root)
    statistics = analyse(results)
    made = report_document(Material(results, statistics), made="")
    cells = {
        table.name: [dict(zip([column.name for column in table.columns], row, strict=True)) for row in table.rows]
        for table in made.tables
    }
    for measure in statistics.measures:
        [effect] = cells[f"test {measure.name}"]
        conclusion = measure.test.effects[0].conclusion
        assert effect["Statistic"].text in conclusion
        if measure.test.effects[0].is_significant:
            assert effect["Effect size"].text.partition(" [")[0] in conclusion
        for check, row in zip(measure.assumptions, cells[f"assumptions {measure.name}"], strict=True):
            assert f" = {row['Statistic'].text}, p " in check.conclusion
        [caption] = [each.caption for each in made.figures if each.name == f"order {measure.name}"]
        rho = shown_coefficient(measure.drift.correlation)
        assert f"= {rho})" in caption
        assert f"(rho = {rho}, p " in measure.drift.warning
    [correlation] = cells["correlations"]
    assert correlation["Pearson's r"].text.startswith("0.999")
    assert correlation["CI"].text.endswith(f"{shown_coefficient(statistics.correlations[0].pearson_interval.high)}]")


def test_plain_values_are_what_json_knows():
    given_values = {
        "a": np.float64(1.5),
        "b": np.int64(2),
        "c": math.nan,
        "d": pd.NA,
        "e": pd.NaT,
        "f": pd.Timestamp("2026-01-31T12:00:00Z"),
        "g": (1, {2}),
        "h": np.bool_(True),
        3: object,
    }
    written = plain(given_values)
    assert json.loads(json.dumps(written, allow_nan=False)) == written
    assert (written["a"], written["b"], written["c"], written["d"], written["e"]) == (1.5, 2, None, None, None)
    assert written["f"] == "2026-01-31T12:00:00Z"
    assert written["h"] is True
