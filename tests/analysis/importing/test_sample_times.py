"""Times as other tools write them."""

from __future__ import annotations

import pyarrow as pa
import pytest

from robot_runner.analysis.importing.sample_times import TimeKind, nanoseconds_of, time_kind, time_unit
from robot_runner.core.errors import AnalysisError


def test_a_time_of_day_that_is_missing_begins_no_other_day():
    times, valid = nanoseconds_of(pa.chunked_array([["23:59:58", None, "23:59:59", "00:00:01"]]), "clock", "meter.csv")
    assert valid.tolist() == [True, False, True, True]
    assert ((times[valid] - times[0]) / 1e9).tolist() == [0.0, 1.0, 3.0]


@pytest.mark.parametrize(
    ("heading", "first", "unit", "kind"),
    [
        ("time_ns", 5_000_000_000_000, "ns", TimeKind.COUNTED),  # since the computer was switched on
        ("timestamp_us", 500_000_000_000, "us", TimeKind.COUNTED),
        ("time_ms", 200_000_000, "ms", TimeKind.COUNTED),
        ("time_ns", 1_700_000_000_000_000_000, "ns", TimeKind.MOMENT),
        ("t_ms", 1_700_000_000_000, "ms", TimeKind.MOMENT),
        (
            "time_s",
            1_700_000_000_000,
            "ms",
            TimeKind.MOMENT,
        ),  # in seconds it would be the year 55,841
        ("timestamp", 1_700_000_000_000_000, "us", TimeKind.MOMENT),
    ],
)
def test_times_are_in_the_unit_of_their_heading_however_long_the_computer_has_been_on(heading, first, unit, kind):
    times = pa.chunked_array([[first, first + 1]])
    assert time_unit(heading, times, "power.csv") == unit
    assert time_kind(unit, times) is kind


@pytest.mark.parametrize("first", [40_000_000, 400_000_000, 1_900_000_000])  # 1900 s after the start: like 2030 in s
def test_times_that_would_be_days_apart_in_seconds_are_not_taken_for_seconds(first):
    """PX4 counts microseconds since the start of the autopilot, and its headings do not say so."""
    times = pa.chunked_array([[first + place * 100_000 for place in range(5)]])
    with pytest.raises(AnalysisError, match="the times in timestamp are 100,000 apart, so not in s") as raised:
        time_unit("timestamp", times, "battery.csv")
    assert raised.value.fix == "Say their unit: --samples battery.csv:timestamp:us, or ms."
    assert time_unit("timestamp", pa.chunked_array([[first, first + 1, first + 60]]), "battery.csv") == "s"


@pytest.mark.parametrize(
    ("unit", "texts"),
    [
        ("%H:%M:%S", ["23:59:58", None, "23:59:59", "00:00:01"]),
        ("%I:%M:%S %p", ["11:59:58 PM", None, "11:59:59 PM", "12:00:01 AM"]),
        ("%M:%S.%f", ["59:58.0", None, "59:59.0", "00:01.0"]),
    ],
)
def test_a_format_without_a_date_tells_times_of_day_which_go_on_past_midnight(unit, texts):
    column = pa.chunked_array([texts])
    assert time_kind(unit, column) is TimeKind.CLOCK  # and no moments of the year 1900
    times, valid = nanoseconds_of(column, unit, "meter.csv")
    assert valid.tolist() == [True, False, True, True]
    assert ((times[valid] - times[0]) / 1e9).tolist() == [0.0, 1.0, 3.0]


def test_a_format_with_a_date_tells_moments():
    column = pa.chunked_array([["05/03/2025 12:00:00", "05/03/2025 12:00:02"]])
    assert time_kind("%d/%m/%Y %H:%M:%S", column) is TimeKind.MOMENT
    assert nanoseconds_of(column, "%d/%m/%Y %H:%M:%S", "meter.csv")[0].tolist() == [
        1741176000 * 10**9,
        1741176002 * 10**9,
    ]
