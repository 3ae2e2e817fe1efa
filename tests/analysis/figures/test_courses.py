"""Samples are thinned out without changing what they say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.analysis.figures.courses import bin_width, course_of_run, mean_course

values = st.floats(min_value=-1e6, max_value=1e6)


@given(st.floats(min_value=1e-3, max_value=1e6), st.floats(min_value=1e-6, max_value=10.0))
def test_bins_are_few_and_none_is_shorter_than_a_sample(duration, period):
    width = bin_width(duration, period)
    assert duration / width <= 500 * (1 + 1e-9)
    assert width >= period * (1 - 1e-9)
    mantissa = width / 10 ** np.floor(np.log10(width) + 1e-9)
    assert any(mantissa == pytest.approx(nice) for nice in (1, 2, 2.5, 5, 10))


@given(st.lists(values, min_size=1, max_size=200), st.floats(min_value=0.01, max_value=3.0))
def test_each_bin_has_the_mean_and_the_extremes_of_its_samples(samples, width):
    numbers = np.array(samples)
    time = np.arange(len(numbers)) * 0.1
    course = course_of_run("r_1", time, numbers, width)
    filled = np.isfinite(course.middle)
    for middle, low, high, centre in zip(
        course.middle[filled], course.low[filled], course.high[filled], course.time[filled], strict=True
    ):
        mine = numbers[np.floor(time / width) == round(centre / width - 0.5)]
        assert middle == pytest.approx(mine.mean(), abs=1e-6)
        assert (low, high) == (mine.min(), mine.max())


def test_a_gap_stays_a_gap():
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    course = course_of_run("r_1", time, np.ones(5), 1.0)
    assert list(np.isfinite(course.middle)) == [True, False, False, False, False, True]


def test_missing_samples_are_left_out():
    course = course_of_run("r_1", np.array([0.1, 0.2, 0.3]), np.array([1.0, np.nan, 3.0]), 1.0)
    assert course.middle[0] == 2.0


def test_a_run_without_samples_has_no_course():
    course = course_of_run("r_1", np.array([0.1]), np.array([np.nan]), 1.0)
    assert len(course.time) == 0
    assert mean_course("Video", [course], 1.0).runs == 0


def test_samples_before_the_start_of_measurement_keep_their_place():
    course = course_of_run("r_1", np.array([-0.5, 0.5]), np.array([1.0, 2.0]), 1.0)
    assert list(course.time) == [-0.5, 0.5]


def test_the_mean_of_runs_has_a_band_of_one_standard_deviation():
    courses = [course_of_run(f"r_{level}", np.array([0.5, 1.5]), np.full(2, level), 1.0) for level in (1.0, 2.0, 3.0)]
    mean = mean_course("Video", courses, 1.0)
    assert mean.runs == 3
    assert list(mean.middle) == [2.0, 2.0]
    assert list(mean.high - mean.middle) == [1.0, 1.0]


def test_runs_of_different_length_are_averaged_where_they_are():
    short = course_of_run("a", np.array([0.5]), np.array([1.0]), 1.0)
    long = course_of_run("b", np.array([0.5, 1.5]), np.array([3.0, 5.0]), 1.0)
    mean = mean_course("Video", [short, long], 1.0)
    assert list(mean.middle) == [2.0, 5.0]
    assert np.isnan(mean.low[1])
