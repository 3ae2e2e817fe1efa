from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import PluginError
from robot_runner.measuring.device_clock import ClockMap, fit_clock


def stamped(*, seconds: float, offset: float, skew: float, least_delay: float, jitter: float, seed: int = 1):
    """Return stamps of a device 200 times a second, and arrivals in pieces, with seeded jitter."""
    rng = random.Random(seed)  # noqa: S311 - jitter, no secret
    stamps = [number / 200 for number in range(int(seconds * 200))]
    arrivals = []
    for stamp in stamps:
        delay = least_delay + rng.expovariate(1 / jitter) if jitter else least_delay
        arrivals.append(max(offset + stamp * (1 + skew) + delay, arrivals[-1] if arrivals else float("-inf")))
    return stamps, arrivals


def test_a_constant_delay_becomes_part_of_the_offset():
    clock = fit_clock(*stamped(seconds=5, offset=100.0, skew=0.0, least_delay=0.002, jitter=0.0))
    assert clock.to_run(3.0) == pytest.approx(103.002)


def test_jitter_does_not_move_the_map_by_more_than_a_millisecond():
    clock = fit_clock(*stamped(seconds=5, offset=100.0, skew=0.0, least_delay=0.002, jitter=0.01))
    assert clock.to_run(3.0) == pytest.approx(103.002, abs=0.001)


@pytest.mark.parametrize("skew", [0.005, -0.005, 0.0002])
def test_a_clock_that_is_off_by_its_tolerance_is_found_out(skew):
    clock = fit_clock(*stamped(seconds=95, offset=7.0, skew=skew, least_delay=0.001, jitter=0.004))
    assert clock.rate == pytest.approx(1 + skew, abs=2e-5)
    assert clock.to_run(94.0) == pytest.approx(7.001 + 94.0 * (1 + skew), abs=0.001)


def test_over_a_short_time_jitter_is_not_taken_for_skew():
    assert fit_clock(*stamped(seconds=8, offset=0.0, skew=0.0, least_delay=0.0, jitter=0.02)).rate == 1.0


def test_a_skew_that_no_resonator_has_is_not_believed():
    stamps = [float(number) for number in range(100)]
    assert fit_clock(stamps, [1.5 * stamp for stamp in stamps]).rate == 1.0


def test_one_message_gives_an_offset():
    assert fit_clock([5.0], [12.0]).offset == 7.0


def test_of_messages_with_one_stamp_the_earliest_counts():
    assert fit_clock([0.0, 1.0, 1.0, 1.0], [5.9, 6.4, 6.1, 6.8]).offset == pytest.approx(5.1)


def test_no_messages_are_refused():
    with pytest.raises(PluginError, match="no messages"):
        fit_clock([], [])


@given(
    delays=st.lists(st.floats(0.0, 0.5), min_size=2, max_size=200),
    offset=st.floats(-1000.0, 1000.0),
)
def test_no_message_is_placed_after_its_arrival(delays, offset):
    stamps = [0.25 * number for number in range(len(delays))]
    arrivals = [offset + stamp + delay for stamp, delay in zip(stamps, delays, strict=True)]
    clock = fit_clock(stamps, arrivals)
    assert all(clock.to_run(stamp) <= arrival + 1e-6 for stamp, arrival in zip(stamps, arrivals, strict=True))


def test_many_times_are_brought_to_the_run_as_each_of_them():
    clock, moments = ClockMap(7.0123456, 1.0000037), [number / 200 for number in range(400)]
    assert clock.all_to_run(moments) == [clock.to_run(each) for each in moments]
