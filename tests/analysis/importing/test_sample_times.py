"""Times as other tools write them."""

from __future__ import annotations

import pyarrow as pa

from robot_runner.analysis.importing.sample_times import nanoseconds_of


def test_a_time_of_day_that_is_missing_begins_no_other_day():
    times, valid = nanoseconds_of(pa.chunked_array([["23:59:58", None, "23:59:59", "00:00:01"]]), "clock", "meter.csv")
    assert valid.tolist() == [True, False, True, True]
    assert ((times[valid] - times[0]) / 1e9).tolist() == [0.0, 1.0, 3.0]
