"""A cell's text and its value: exact for what we write, lenient for what people and spreadsheets write."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import MeasureError
from robot_runner.core.storage.cells import (
    RunStatus,
    are_stamps,
    checked_measure,
    csv_text,
    is_same_number,
    measure_text,
    number_of,
    plain_value,
    quoted,
    status_of_word,
    treatment_position,
    typed_value,
    typed_values,
)

texts = st.text(st.characters(exclude_categories=["Cs"]))


def same(one: object, other: object) -> bool:
    return type(one) is type(other) and one == other


@given(st.lists(texts, min_size=2))
def test_a_quoted_row_is_read_back_as_it_was(cells: list[str]) -> None:
    line = ",".join(map(quoted, cells)) + "\n"
    assert csv_text([cells]) == line
    assert list(csv.reader(io.StringIO(line, newline=""), strict=True)) == [cells]


@given(st.integers(-(2**1023), 2**1023) | st.floats(allow_nan=False, allow_infinity=False) | st.booleans() | st.none())
def test_a_measure_that_is_no_text_comes_back_with_its_type(value: Any) -> None:
    assert same(plain_value(measure_text(value)), value)


@pytest.mark.parametrize("kind", [None, "any", "number", "integer"])
def test_digits_beyond_the_largest_float_are_text_and_nothing_computes_with_them(kind: str | None) -> None:
    cells = [f"{sign}{'9' * count}" for sign in ("", "-") for count in (308, 309, 400)]
    values = [typed_values([cell], kind)[0] for cell in cells]
    assert [type(value) for value in values] == [int, str, str] * 2
    assert typed_values(cells, kind) == values


@given(texts.filter(bool))
def test_a_text_comes_back_as_text_where_the_schema_says_so(text: str) -> None:
    assert typed_value(measure_text(text), "string") == text


@pytest.mark.parametrize(
    "text", ["007", "+5", "1_000", "1,5", "nan", "inf", "1e999", "5 J", "0x10", "\u0661", "-", ".", "e"]
)
def test_what_python_would_not_write_as_a_number_is_text(text: str) -> None:
    assert plain_value(text) == text


@given(
    st.lists(st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False), texts, st.none())), st.data()
)
def test_many_cells_are_read_as_each_alone_is(values: list[Any], data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from([None, "any", "number", "integer", "boolean", "string"]))
    cells = list(map(measure_text, values))
    together = typed_values(cells, kind)
    assert all(same(one, typed_value(cell, kind)) for one, cell in zip(together, cells, strict=True))
    assert len(together) == len(cells)


@pytest.mark.parametrize(
    "cells", [["1", "2"], ["-1.5", "2.0"], ["1e5", "2e-05"], ["1", "2.5"], ["1.5.2", "3"], ["", ""], ["1", ""]]
)
def test_columns_of_plain_numbers_keep_their_types(cells: list[str]) -> None:
    values = typed_values(cells, None)
    assert list(map(measure_text, values)) == [text.replace("1e5", "100000.0") for text in cells]


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("", "number", None),
        ("", "string", None),
        ("TRUE", "boolean", True),
        ("WAHR", "boolean", True),
        ("WAHR", "any", "WAHR"),
        (" false ", "boolean", False),
        ("yes", "boolean", "yes"),
        ("+5", "number", 5),
        (" 5 ", "integer", 5),
        (".5", "number", 0.5),
        ("1.0", "integer", 1.0),
        ("n/a", "number", "n/a"),
        ("1", "string", "1"),
        ("TRUE", None, True),
        ("0.50", None, 0.5),
    ],
)
def test_a_cell_is_read_as_its_columns_type_says(text: str, kind: str | None, value: object) -> None:
    assert same(typed_value(text, kind), value)


@pytest.mark.parametrize("text", ["1e5", "1.50", "-0", "007", "true", "TRUE", "nan", "5", "-0.0", "True", "1e+22", "a"])
def test_in_a_column_of_texts_and_numbers_no_cell_is_rewritten(text: str) -> None:
    assert measure_text(typed_value(text, "any")) == text
    assert list(map(measure_text, typed_values([text, "2.5", "x"], "any"))) == [text, "2.5", "x"]
    assert measure_text(typed_values([text], "any")[0]) == text


def test_a_decimal_comma_counts_only_where_cells_are_split_by_semicolons() -> None:
    assert number_of("0,5", decimal_comma=True) == 0.5
    assert number_of("0,5") is None
    assert typed_value("0,5", "number", decimal_comma=True) == 0.5
    assert number_of("1e999") is None


@pytest.mark.parametrize(
    ("treatments", "text", "place"),
    [
        (["Video", "video"], "video", 1),
        (["Video", "Network"], "video", 0),
        (["Video", "Network"], " Network ", 1),
        (["Video", "video"], "VIDEO", None),
        ([" Video"], " Video", 0),
        ([1, 2], "1.0", 0),
        ([0.5, 2], "5e-1", 0),
        ([1, 1.0], "1.00", None),
        ([1, 1.0], "1.0", 1),
        ([True, False], "TRUE", 0),
        ([True, 1], "1", 1),
        ([True, False], "1", None),
        (["1", 2], "1", 0),
        ([None, 1], "None", 0),
        ([float("nan"), 1], "NaN", 0),
        (["", "a"], "", 0),
        (["a"], "", None),
        ([True, False], "ONWAAR", 1),
        (["wahr", True], "WAHR", 0),
        (["True", "False"], "WAHR", None),
        (["1.10", "007"], "1.1", 0),
        (["1.10", "007"], "7", 1),
        (["1E5", "1-2"], "1.00E+05", 0),
        (["1.10", "1.1"], "1.100", None),
        (["007", 7], "7", 1),
    ],
)
def test_a_treatment_is_recognised_exactly_first_and_then_leniently(
    treatments: list[Any], text: str, place: int | None
) -> None:
    assert treatment_position(Factor("X", treatments), text) == place


@pytest.mark.parametrize("value", [1, -2.5, True, "text", "日本", None])
def test_what_the_run_table_can_hold_is_taken(value: Any) -> None:
    assert checked_measure("Energy", value) is value


def test_an_empty_text_is_a_missing_value() -> None:
    assert checked_measure("Energy", "") is None


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ([1], "[1] is of type list"),
        (1j, "1j is of type complex"),
        (math.nan, "nan is not a finite number"),
        (-math.inf, "-inf is not a finite number"),
        (1 << 20_000, "a number of 20001 bits is too large"),
        ("\ud800", "'\\ud800' holds what UTF-8 cannot hold"),
    ],
    ids=["list", "complex", "nan", "inf", "large", "surrogate"],
)
def test_what_the_run_table_cannot_hold_is_refused(value: object, problem: str) -> None:
    with pytest.raises(MeasureError) as caught:
        checked_measure("Energy", value)
    assert str(caught.value) == (
        f"measure 'Energy': {problem} → Give a finite number, a bool, a string, or None for a missing value."
    )


@pytest.mark.parametrize(
    ("stamps", "verdict"),
    [
        ([], True),
        (["2026-01-31T12:00:00.250Z", "2026-01-31T12:00:01.000Z"], True),
        (["2026-01-31T12:00:00Z"], False),
        (["2026-01-31T12:00:00.250Z", "yesterday"], False),
        (["2026-01-31T12:00:00.250Z\n"], False),
    ],
)
def test_time_stamps_are_told_from_other_text(stamps: list[str], verdict: bool) -> None:
    assert are_stamps(stamps) is verdict


@pytest.mark.parametrize(
    ("value", "found"),
    [
        (11, 11.0),
        (20.833333333333332, 20.8333333333333),  # R, LibreOffice
        (20.833333333333332, 20.83333333),  # Excel
        (1.2345678e-06, 1.23457e-06),
        (9007199254740993, 9007199254740992),  # a double
        (9007199254740993, 9.0072e15),
        (-20.833333333333332, -20.83333333),
    ],
)
def test_a_number_that_a_program_rounded_as_it_saved_the_table_is_the_same(value: float, found: float) -> None:
    assert is_same_number(value, found)


@pytest.mark.parametrize(
    ("value", "found"),
    [
        (20.833333333333332, 20.8333),
        (21.5, 21.6),
        (1769860800.25, 1769860801.25),  # a moment, s: a second makes 6e-10 of it
        (0.123456789, 0.123457),
        (1, True),
        (1, "1"),
        (None, 0),
    ],
)
def test_a_number_that_somebody_rounded_or_corrected_is_another(value: object, found: object) -> None:
    assert not is_same_number(value, found)


# The words for how far a run has come.


@pytest.mark.parametrize("status", list(RunStatus))
def test_each_status_is_known_by_the_word_that_is_written(status: RunStatus) -> None:
    assert status_of_word(status.value) is status


@pytest.mark.parametrize("word", ["", " ", "-", "–", "—", "todo", "TODO", "To do"])  # noqa: RUF001 - dashes are meant
def test_many_words_say_that_a_run_is_to_do(word: str) -> None:
    assert status_of_word(word) is RunStatus.TODO


def test_the_case_of_letters_does_not_matter() -> None:
    assert [status_of_word(word) for word in ("DONE", "done", " Failed ")] == [
        RunStatus.DONE,
        RunStatus.DONE,
        RunStatus.FAILED,
    ]


def test_other_words_say_nothing() -> None:
    assert status_of_word("dnoe") is None
