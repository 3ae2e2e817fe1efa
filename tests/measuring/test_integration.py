from __future__ import annotations

import math
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.events.window import Window
from robot_runner.measuring.series import (
    Series,
    cut,
    energy,
    energy_from_mean_power,
    integrate,
    mean,
    mean_of_intervals,
)


def test_a_constant_integrates_to_itself_times_the_window_however_uneven_the_stamps():
    series = Series([0.0, 0.1, 0.7, 5.0, 9.9], [8.0] * 5)
    assert energy(series, Window(0.05, 9.0)) == pytest.approx(8.0 * 8.95)


def test_a_straight_line_integrates_exactly():
    series = Series([0.0, 1.0, 4.0], [0.0, 2.0, 8.0])
    assert energy(series, Window(0.5, 3.0)) == pytest.approx(3.0**2 - 0.5**2)


def test_a_sine_integrates_within_a_thousandth():
    times = array("d", (number / 200 for number in range(19_001)))
    series = Series(times, array("d", (8.0 + 2.0 * math.sin(time) for time in times)))
    exact = 8.0 * 90.0 + 2.0 * (math.cos(2.5) - math.cos(92.5))
    assert energy(series, Window(2.5, 92.5)) == pytest.approx(exact, rel=1e-6)


def test_uneven_samples_do_not_weigh_more_where_they_are_denser():
    series = Series([0.0, 0.1, 0.2, 0.3, 10.0], [4.0, 4.0, 4.0, 4.0, 4.0])
    assert mean(series) == pytest.approx(4.0)
    dense_start = Series([0.0, 0.1, 0.2, 0.3, 1.0, 10.0], [9.0, 9.0, 9.0, 9.0, 1.0, 1.0])
    assert mean(dense_start) == pytest.approx((0.3 * 9 + 0.7 * 5 + 9.0) / 10)


@pytest.mark.parametrize("series", [Series([], []), Series([1.0], [5.0])])
def test_too_few_samples_have_no_integral(series):
    assert integrate(series) is None
    assert mean(series) is None


def test_samples_of_one_moment_have_no_mean():
    assert mean(Series([1.0, 1.0], [5.0, 7.0])) is None


def test_an_interval_mean_counts_only_the_part_of_each_interval_that_lies_in_the_window():
    series = Series([0.0, 1.0, 2.0, 4.0], [0.0, 10.0, 20.0, 30.0])
    assert mean_of_intervals(series, Window(0.5, 3.0)) == pytest.approx((0.5 * 10 + 20 + 30) / 2.5)


@pytest.mark.parametrize("window", [Window(10.0, 11.0), Window(1.0, 1.0)])
def test_an_interval_mean_of_nothing_is_missing(window):
    assert mean_of_intervals(Series([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]), window) is None


def test_the_papers_energy_is_the_mean_of_the_samples_times_the_duration():
    series = Series([0.0, 1.0, 2.0, 3.0], [5.0, 7.0, 9.0, 100.0])
    assert energy_from_mean_power(series, Window(0.0, 2.5)) == pytest.approx(7.0 * 2.5)


def test_the_papers_energy_of_no_samples_is_missing():
    assert energy_from_mean_power(Series([0.0], [5.0]), Window(1.0, 2.0)) is None


@given(
    values=st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=40),
    middle=st.floats(0.01, 0.99),
)
def test_the_integrals_of_two_neighbouring_windows_add_up(values, middle):
    series = Series([float(number) for number in range(len(values))], values)
    end = len(values) - 1.0
    left = energy(series, Window(0.0, middle * end))
    right = energy(series, Window(middle * end, end))
    assert left + right == pytest.approx(integrate(series), abs=1e-6)


@given(values=st.lists(st.floats(0.0, 100.0), min_size=2, max_size=40))
def test_a_mean_lies_between_the_smallest_and_the_largest_sample(values):
    series = Series([0.3 * number for number in range(len(values))], values)
    assert min(values) - 1e-9 <= mean(cut(series, Window(0.0, 0.3 * len(values)))) <= max(values) + 1e-9
