from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.measuring.cpu_counters import CoreCounters
from robot_runner.measuring.device_clock import ClockMap
from robot_runner.measuring.on_board_sampler import counter_sample, file_sample


def test_a_core_that_is_switched_off_leaves_its_place_empty():
    sample = counter_sample(["1.5", ":300:200,0:100:50,2:200:150", "8:4", ""])
    assert sample.cores == (CoreCounters(100, 50), None, CoreCounters(200, 150))
    assert sample.whole == CoreCounters(300, 200)
    assert (sample.memory_total, sample.memory_available) == (8192.0, 4096.0)
    assert sample.processes == ()


@pytest.mark.parametrize(
    "fields",
    [
        [],
        ["1.5"],
        ["x", ":1:1", "8:4", ""],
        ["1.5", "0:1:1", "8:4", ""],
        ["1.5", ":1", "8:4", ""],
        ["1.5", ":1:1", "8", ""],
        ["1.5", ":1:1", "8:4", "0:7:5"],
    ],
)
def test_a_damaged_line_is_no_sample(fields):
    assert counter_sample(fields) is None


@given(st.lists(st.text(max_size=30), max_size=6))
def test_whatever_arrives_raises_nothing(fields):
    counter_sample(fields)
    file_sample(fields, ClockMap(0.0), files=1)


def test_lines_of_files_that_are_not_there_are_missing_and_empty_ones_are_empty():
    sample = file_sample(["2.0", "=41500", "-", "="], ClockMap(1.0), files=3)
    assert (sample.time, sample.lines) == (3.0, ("41500", None, ""))
    assert file_sample(["2.0", "=1"], ClockMap(0.0), files=2) is None
