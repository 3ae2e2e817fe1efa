from __future__ import annotations

from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.events.window import Window
from robot_runner.measuring.quality import jitter_of, quality_of

EVEN = [number / 10 for number in range(101)]


def test_even_samples_give_nothing_to_say():
    quality = quality_of(EVEN, Window(0.0, 10.0), 10.0)
    assert quality.warnings() == ()
    assert quality.is_sufficient
    assert (quality.expected, quality.got) == (100, 101)


def test_samples_outside_the_window_do_not_count():
    assert quality_of(EVEN, Window(2.0, 4.0), 10.0).got == 21


def test_a_gap_is_told_with_its_length_and_what_is_left():
    times = [time for time in EVEN if not 3.0 < time < 4.0]
    quality = quality_of(times, Window(0.0, 10.0), 10.0)
    assert quality.largest_gap == pytest.approx(1.0)
    assert quality.coverage == pytest.approx(90.0)
    assert not quality.is_sufficient
    assert any("the largest gap between samples is 1.000 s" in warning for warning in quality.warnings())
    assert any("92 samples arrived of 100 expected" in warning for warning in quality.warnings())


def test_a_sensor_that_died_half_way_leaves_a_gap_to_the_end_of_the_window():
    quality = quality_of(EVEN, Window(0.0, 20.0), 10.0)
    assert quality.largest_gap == pytest.approx(10.0)
    assert quality.coverage == pytest.approx(50.0)


def test_single_missing_samples_are_no_gap():
    times = [time for index, time in enumerate(EVEN) if index % 50]
    quality = quality_of(times, Window(0.0, 10.0), 10.0)
    assert quality.coverage == 100.0


@pytest.mark.parametrize(
    ("lost", "overdue"),
    [((0.6,), 1.0), ((4.6,), 1.0), ((9.6,), 1.0), ((3.6, 4.6), 2.0), ((), 0.0), ((-0.4,), 0.6), ((10.6,), 0.4)],
)
def test_a_sample_that_is_missing_from_a_short_window_or_beside_its_edge_is_told(lost, overdue):
    times = [number - 0.4 for number in range(-1, 13) if number - 0.4 not in lost]
    quality = quality_of(times, Window(0.0, 10.0), 1.0)
    assert quality.overdue == pytest.approx(overdue)
    assert bool(quality.warnings()) is (overdue > 0.5)
    assert quality.is_sufficient


@pytest.mark.parametrize(
    ("window", "unreached"),
    [(Window(0.5, 34.5), 4.5), (Window(-1.0, 30.0), 1.0), (Window(-1.0, 34.5), 5.5), (Window(1.0, 29.0), 0.0)],
)
def test_the_time_that_no_sample_reaches_is_told_from_a_twentieth_of_the_window_on(window, unreached):
    quality = quality_of([5.0 * number for number in range(7)], window, 0.2)
    assert quality.unreached == pytest.approx(unreached)
    told = f"samples leave out {unreached:.3f} s at the ends of the measured window of {window.duration:.3f} s"
    assert quality.warnings() == ((told,) if unreached > 4.0 else ())
    assert quality.is_sufficient


def test_a_sample_that_is_missing_from_a_long_window_is_not_told():
    times = [number - 0.4 for number in range(-1, 43) if number != 1]
    assert quality_of(times, Window(0.0, 40.0), 1.0).warnings() == ()


@given(shifts=st.lists(st.floats(-0.2, 0.2), min_size=7, max_size=60), start=st.floats(0.0, 1.0))
def test_samples_that_all_came_are_never_called_overdue(shifts, start):
    times = [number + shift for number, shift in enumerate(shifts)]
    assert quality_of(times, Window(1.0 + start, len(times) - 3.0 + start), 1.0).warnings() == ()


def test_no_samples_are_not_sufficient_even_in_a_short_window():
    quality = quality_of([], Window(0.0, 0.1), 10.0)
    assert not quality.is_sufficient
    assert quality.warnings() == ("no sample arrived in the measured window, where 1 were expected",)


def test_a_window_of_no_length_covers_nothing():
    assert not quality_of(EVEN, Window(1.0, 1.0), 10.0).is_sufficient


def test_what_was_lost_damaged_or_doubled_is_told_in_figures():
    quality = quality_of(EVEN, Window(0.0, 10.0), 10.0, lost=1, corrupt=2, duplicates=3)
    assert quality.warnings() == (
        "1 sample was lost",
        "2 samples were damaged and left out",
        "3 samples were received twice",
    )


def test_even_samples_have_no_jitter():
    jitter = quality_of(EVEN, Window(0.0, 10.0), 10.0).jitter
    assert (jitter.p50, jitter.p95, jitter.p99) == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize("count", [2, 5, 7, 12, 21, 60, 113, 150])
def test_jitter_names_bounds_that_so_many_of_the_times_between_samples_keep(count):
    times = list(accumulate(1.0 + (number * 0.618) % 1.0 for number in range(count + 1)))
    between = [later - sooner for sooner, later in pairwise(times)]
    median, jitter = sorted(between)[round((count - 1) / 2)], jitter_of(times)
    for bound, percent in ((jitter.p50, 50), (jitter.p95, 95), (jitter.p99, 99)):
        assert sum(abs(each - median) <= bound for each in between) * 100 >= percent * count


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60))
def test_jitter_is_that_of_the_times_between_samples_whatever_the_rate(shifts):
    times = [number + shift / 3 for number, shift in enumerate(shifts)]
    jitter = jitter_of(times)
    if len(times) == 1:
        assert jitter is None
    else:
        assert 0.0 <= jitter.p50 <= jitter.p95 <= jitter.p99 <= 2 / 3 + 1e-9


def test_uneven_samples_are_told_of():
    times = sorted(number / 10 + (0.08 if number % 2 else 0.0) for number in range(100))
    (warning,) = quality_of(times, Window(0.0, 9.9), 10.0).warnings()
    assert warning.startswith("the samples are uneven: 1 in 20 came 0.160 s or more off")


def test_readings_at_the_end_of_the_range_are_told_of():
    assert quality_of(EVEN, Window(0.0, 10.0), 10.0, saturated=2).warnings() == (
        "2 samples were at the end of the sensor's range: the true value lies beyond",
    )


def test_readings_that_failed_are_told_with_what_the_first_one_said():
    quality = quality_of(EVEN, Window(0.0, 10.0), 10.0, failed=1, first_failure="OSError: unplugged")
    assert quality.warnings() == ("1 reading failed, the first with: OSError: unplugged",)


@pytest.mark.parametrize(("uncertainty", "warnings"), [(0.05, 0), (0.2, 1), (None, 0)])
def test_a_clock_that_is_not_known_well_enough_for_the_window_is_told_of(uncertainty, warnings):
    quality = quality_of(EVEN, Window(0.0, 10.0), 10.0, clock_offset=3.0, clock_uncertainty=uncertainty)
    assert len(quality.warnings()) == warnings


def test_a_profiler_that_loads_what_it_measures_is_told_of():
    assert quality_of(EVEN, Window(0.0, 10.0), 10.0, cpu_seconds=0.1).warnings() == ()
    (warning,) = quality_of(EVEN, Window(0.0, 10.0), 10.0, cpu_seconds=1.5).warnings()
    assert warning == "the profiler itself kept 15.0 % of one core busy"
