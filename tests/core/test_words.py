from __future__ import annotations

import math
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robot_runner.cli.console import Column, aligned, fitting
from robot_runner.core.words import enumerated, listed, one_line, plain, shown_duration, shown_value


@given(st.text())
def test_any_text_stays_on_one_line_and_commands_no_terminal(text: str) -> None:
    assert one_line(text).isprintable()


@given(st.floats(min_value=-1e300, max_value=1e300))
def test_four_digits_are_kept_of_any_number(number: float) -> None:
    shown = shown_value(number)
    assert float(shown) == pytest.approx(number, rel=6e-4)
    assert not shown.endswith(".")


@pytest.mark.parametrize("value", [math.inf, math.nan, "a\nb", True, 12345678901234567890])
def test_whatever_else_is_shown_as_it_is(value: object) -> None:
    assert shown_value(value) == one_line(str(value))


@pytest.mark.parametrize(("seconds", "shown"), [(0.9996, "1.0 s"), (9.96, "10 s"), (3599.6, "1 h 00 min")])
def test_durations_are_rounded_into_the_next_unit(seconds: float, shown: str) -> None:
    assert shown_duration(seconds) == shown


@example(0.06)
@example(59.5)
@example(3599.5)
@given(st.floats(min_value=0, max_value=1e7))
def test_durations_never_show_sixty_of_what_makes_the_next_unit(seconds: float) -> None:
    shown = shown_duration(seconds)
    assert not re.search(r"\b(1000 ms|60 s|60 min)$", shown), shown
    assert "60 min " not in shown


def test_lists_do_not_hide_a_single_name() -> None:
    assert listed("abcde") == "a, b, c, d, e"
    assert listed("abcdef") == "a, b, c, d and 2 more"


def test_an_enumeration_hides_nothing_and_may_be_empty() -> None:
    assert enumerated("abcdef") == "a, b, c, d, e and f"
    assert (enumerated([]), enumerated("a"), enumerated("ab")) == ("", "a", "a and b")


@given(st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.tuples(st.integers())))
def test_what_goes_into_json_is_something_that_json_has(value: object) -> None:
    result = plain(value)
    assert result is None or isinstance(result, bool | int | str) or math.isfinite(result)


@given(st.lists(st.text(min_size=1, max_size=30), min_size=1, max_size=5), st.integers(min_value=2, max_value=12))
def test_columns_stand_beneath_each_other(cells: list[str], width: int) -> None:
    columns = [Column("x", width, is_number=True) for _ in cells]
    texts = [one_line(cell) for cell in cells if one_line(cell).isascii()]
    line = aligned(columns[: len(texts)], texts)
    assert len(line) <= (width + 2) * len(texts)
    assert "\n" not in line


def test_a_cell_that_is_too_long_ends_in_dots() -> None:
    assert aligned([Column("x", 5)], ["abcdefgh"]) == "abcd…"
    assert aligned([Column("x", 5)], ["日本語日本"]) == "日本…"


@given(st.lists(st.integers(min_value=1, max_value=20), min_size=1), st.integers(min_value=0, max_value=200))
def test_as_many_columns_fit_as_there_is_room_for(widths: list[int], room: int) -> None:
    columns = [Column("x", width) for width in widths]
    count = fitting(columns, room)
    used = sum(widths[:count]) + 2 * (count - 1)
    assert count == 1 or used <= room
    if count < len(widths):
        assert used + 2 + widths[count] > room or count == 1


@pytest.mark.parametrize(
    ("value", "shown"), [(9999.4, "9999"), (9999.6, "10000"), (-9999.96, "-10000"), (1e12, "1.000e+12")]
)
def test_a_number_that_rounds_up_to_ten_thousand_has_no_exponent(value: float, shown: str) -> None:
    assert shown_value(value) == shown
