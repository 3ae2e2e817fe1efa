from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import PluginError
from robot_runner.meters.command_output import Aggregate, CommandColumn, TimeColumn, TimeKind, parse_csv, row_times
from robot_runner.plugins import Measure, Window

if TYPE_CHECKING:
    from collections.abc import Callable

MEASURE = Measure("Value", "W", "A value.")


WINDOW = Window(0.0, 2.0)


def value(aggregate: Aggregate, times, values, window=WINDOW, *, factor=1.0):
    column = CommandColumn("x", MEASURE, aggregate, factor)
    return column.value(times, [{"x": each} for each in values], window)


@pytest.mark.parametrize(
    ("aggregate", "expected"),
    [
        (Aggregate.MEAN, 4.0),  # 3 W for the first second and 5 W for the second
        (Aggregate.INTEGRAL, 8.0),
        (Aggregate.SUM, 8.0),
        (Aggregate.MINIMUM, 3.0),
        (Aggregate.MAXIMUM, 9.0),
        (Aggregate.LAST, 5.0),
    ],
)
def test_each_row_tells_of_the_time_since_the_row_before(aggregate, expected):
    assert value(aggregate, [0.0, 1.0, 2.0, 3.0], ["9", "3", "5", "100"]) == pytest.approx(expected)


def test_a_row_that_straddles_an_edge_counts_by_its_share():
    assert value(Aggregate.SUM, [-0.5, 0.5, 2.5], [0, 10, 20]) == pytest.approx(5.0 + 15.0)


def test_a_counter_is_read_at_the_edges_of_the_window():
    assert value(Aggregate.INCREASE, [-1.0, 1.0, 3.0], [10, 20, 40]) == pytest.approx(15.0)
    assert value(Aggregate.RATE, [-1.0, 1.0, 3.0], [10, 20, 40]) == pytest.approx(7.5)


@pytest.mark.parametrize("times", [[-1.0, 4.0, 9.0], [0.5, 5.0, 9.5], [1.0, 5.0, 20.0], [-5.0, 5.0, 15.0]])
def test_rows_that_do_not_reach_the_edges_yield_no_less(times):
    # A program that counts 3 a second, and says a row each few seconds.
    window, counts = Window(0.0, 10.0), [3.0 * (later - sooner) for sooner, later in pairwise([times[0] - 5.0, *times])]
    assert value(Aggregate.SUM, times, counts, window) == pytest.approx(30.0)
    assert value(Aggregate.INCREASE, times, [3.0 * time for time in times], window) == pytest.approx(30.0)
    assert value(Aggregate.RATE, times, [3.0 * time for time in times], window) == pytest.approx(3.0)


def test_a_counter_that_was_read_once_shows_no_growth():
    assert value(Aggregate.INCREASE, [1.0], [10]) is None


def test_rows_of_one_moment_are_added_up():
    assert value(Aggregate.SUM, [0.0, 1.0, 1.0, 2.0], [9, 3, 4, 5]) == pytest.approx(12.0)


def test_a_count_that_is_missing_is_taken_to_be_as_on_average():
    assert value(Aggregate.SUM, [0.0, 0.5, 1.0, 1.5, 2.0], ["9", "100", "", "100", ""]) == pytest.approx(400.0)


def test_a_counter_that_fell_tells_nothing():
    assert value(Aggregate.INCREASE, [0.0, 1.0, 2.0], [10, 20, 5]) is None


def test_cells_that_hold_no_number_are_missing():
    assert value(Aggregate.MEAN, [0.0, 1.0, 2.0], ["", "n/a", "4"]) is None
    assert value(Aggregate.LAST, [0.0, 1.0, 2.0], ["nan", "7", None]) == 7.0


def test_a_factor_brings_the_value_into_the_unit_of_the_measure():
    assert value(Aggregate.LAST, [1.0], ["2500"], factor=1e-3) == 2.5


@pytest.mark.parametrize("aggregate", Aggregate)
def test_no_rows_yield_no_value(aggregate):
    assert value(aggregate, [], []) is None


@given(
    steps=st.lists(st.floats(0.01, 10.0), min_size=2, max_size=30),
    watts=st.floats(0.1, 1000.0),
    share=st.floats(0.1, 0.9),
)
def test_the_integral_of_a_steady_power_is_power_times_time(steps, watts, share):
    times = [0.0]
    for step in steps:
        times.append(times[-1] + step)
    window = Window(0.0, times[-1] * share)
    assert value(Aggregate.INTEGRAL, times, [watts] * len(times), window) == pytest.approx(watts * window.duration)


def test_csv_knows_its_heading_and_passes_over_the_rest():
    records = ["# powered by x", "", "a,b", "1,2", "torn", 'x,"y,z"', "a,b"]
    rows = parse_csv(records)
    assert rows == [None, None, None, {"a": "1", "b": "2"}, None, {"a": "x", "b": "y,z"}, None]


def test_a_progress_bar_between_the_rows_is_no_row():
    rows = parse_csv(["10 %\r20 %\r30 %", "a,b", "1,2", "40 %\r50 %", "3,4\r"])
    assert rows == [None, None, {"a": "1", "b": "2"}, None, {"a": "3", "b": "4"}]


def test_without_a_column_a_row_was_taken_when_it_arrived():
    assert row_times([{}, {}], [5.0, 6.0], None, utc_offset=0.0) == [5.0, 6.0]


def test_utc_stamps_are_brought_to_the_runs_clock():
    rows = [{"t": 1_000_500}, {"t": 1_001_000}, {"t": 1_000_900}]
    column = TimeColumn("t", TimeKind.UTC, unit=0.001)
    assert row_times(rows, [0.0] * 3, column, utc_offset=-1000.0) == pytest.approx([0.5, 1.0, 1.0])


def test_stamps_in_whole_seconds_are_refined_by_the_arrivals_of_their_rows():
    rows = [{"t": "1000"}, {"t": "1000"}, {"t": "1001"}, {"t": "1002"}, {"t": "1004"}]
    received = [0.3, 0.8, 1.8, 9.0, 3.9]  # the fourth was held up, and the last stamp was rounded up
    times = row_times(rows, received, TimeColumn("t"), utc_offset=-1000.0)
    assert times == pytest.approx([0.3, 0.8, 1.8, 2.5, 3.9])


def test_stamps_with_a_fraction_and_of_another_clock_are_not_refined():
    received = [0.9, 1.9]
    assert row_times([{"t": "1000"}, {"t": "1000.5"}], received, TimeColumn("t"), utc_offset=-1000.0) == [0.0, 0.5]
    assert row_times([{"t": "4600"}, {"t": "4601"}], received, TimeColumn("t"), utc_offset=-1000.0) == [3600.5, 3601.5]


def test_power_by_whole_seconds_is_that_of_the_mission_and_not_of_the_second_before():
    taken = [98.7 + number for number in range(15)]
    rows = [{"t": str(int(time)), "watts": "25" if 100.0 < time < 110.5 else "5"} for time in taken]
    times = row_times(rows, [time + 0.01 for time in taken], TimeColumn("t"), utc_offset=0.0)
    column = CommandColumn("watts", Measure("MeanPower", "W", "Power."))
    truth = column.value(taken, rows, Window(100.0, 110.0))
    assert column.value(times, rows, Window(100.0, 110.0)) == pytest.approx(truth, rel=0.002)


def test_spans_are_laid_on_the_runs_clock_by_the_quickest_row():
    rows = [{"span": 1.0}, {"span": 1.0}, {"span": 1.0}]
    received = [101.3, 102.1, 103.4]
    times = row_times(rows, received, TimeColumn("span", TimeKind.SPAN), utc_offset=0.0)
    assert times == pytest.approx([101.1, 102.1, 103.1])


def test_a_time_column_that_is_not_there_is_told():
    with pytest.raises(PluginError, match="no time in column 'when'"):
        row_times([{"t": 1}], [0.0], TimeColumn("when"), utc_offset=0.0)


def test_the_unit_of_times_is_how_many_seconds_it_has_and_not_its_name() -> None:
    with pytest.raises(PluginError, match="unit is 'ms'") as refused:
        TimeColumn("t", TimeKind.UTC, "ms")  # type: ignore[arg-type]
    assert "Give unit a number above 0" in str(refused.value)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: TimeColumn("t", "SPAN"), "kind is 'SPAN' .* Give kind one of: TimeKind.UTC, TimeKind.SPAN, "),
        (lambda: TimeColumn(0), "source is 0 .* Give source a str"),
        (lambda: CommandColumn("W", "Power"), "measure is 'Power' .* Give measure a Measure"),
        (lambda: CommandColumn("W", Measure("Power", "W"), "mean"), "aggregate is 'mean' .* one of: Aggregate.MEAN, "),
        (lambda: CommandColumn("W", Measure("Power", "W"), factor="0.001"), "factor is '0.001' .* factor a number"),
    ],
    ids=["kind", "heading", "measure", "aggregate", "factor"],
)
def test_a_column_that_is_described_by_other_things_is_refused(make: Callable[[], object], told: str) -> None:
    with pytest.raises(PluginError, match=told):
        make()
