from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.measuring.device_clock import (
    ClockExchange,
    ClockMap,
    ClockOffset,
    ClockRecord,
    estimate_offset,
    fit_bent_clock,
    fit_clock,
)


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


def warming(*, seconds: float, change: float, held_up: tuple[float, float] = (0.0, 0.0)):
    """Return moments, a device's stamps of them, 20 a second, and arrivals; those of a time were held up to its end.

    The rate of the device's clock approaches `change`, parts of one, as it warms up for a quarter of an hour.
    """
    rng = random.Random(1)  # noqa: S311 - jitter, no secret
    moments = [number / 20 for number in range(int(seconds * 20))]
    stamps = [at + change * (at - 900 * (1 - math.exp(-at / 900))) for at in moments]
    begun, ended = held_up
    arrivals = [(ended if begun < at < ended else at) + 0.001 + rng.uniform(0, 0.015) for at in moments]
    return moments, stamps, arrivals


def placed(stamps: list[float], arrivals: list[float]) -> list[float]:
    maps = fit_bent_clock(stamps, arrivals)
    parts = pairwise([*maps, (len(stamps), maps[-1][1])])
    return [moment for (first, clock), (last, _) in parts for moment in clock.all_to_run(stamps[first:last])]


def distance(times: list[float], moments: list[float]) -> float:
    return max(abs(time - moment) for time, moment in zip(times, moments, strict=True))


@pytest.mark.long
@pytest.mark.parametrize("change", [0.001, -0.001, 0.0003, 0.0])
def test_a_clock_whose_rate_changes_with_its_temperature_is_followed_for_hours(change):
    """One line through an hour put samples a third of a second beside their times, and so parts of a mission."""
    moments, stamps, arrivals = warming(seconds=3600, change=change)
    times = placed(stamps, arrivals)
    assert distance(times, moments) < 0.005
    assert all(sooner <= later for sooner, later in pairwise(times))


@pytest.mark.long
@pytest.mark.parametrize("change", [0.0003, 0.0])
def test_messages_that_were_held_up_for_minutes_are_no_change_of_the_clock(change):
    moments, stamps, arrivals = warming(seconds=3600, change=change, held_up=(1500, 1760))
    times = placed(stamps, arrivals)
    assert distance(times, moments) < 0.005


@pytest.mark.long
@pytest.mark.parametrize(
    ("seconds", "held_up"), [(300, (0, 180)), (300, (240, 300)), (95, (40, 80)), (900, (0, 300)), (900, (600, 900))]
)
def test_messages_that_were_held_up_leave_an_even_clock_its_line(seconds, held_up):
    """Even those at the beginning and at the end, beyond which nothing tells how the clock went."""
    _, stamps, arrivals = warming(seconds=seconds, change=0.0, held_up=held_up)
    assert fit_bent_clock(stamps, arrivals) == [(0, fit_clock(stamps, arrivals))]


@pytest.mark.long
@pytest.mark.parametrize("change", [0.001, -0.001])
@pytest.mark.parametrize("held_up", [(0, 300), (900, 1800)])
def test_where_messages_tell_nothing_of_a_clock_that_is_followed_it_is_as_good_as_its_line(change, held_up):
    moments, stamps, arrivals = warming(seconds=1800, change=change, held_up=held_up)
    line = fit_clock(stamps, arrivals).all_to_run(stamps)
    times = placed(stamps, arrivals)
    assert times != line
    assert distance(times, moments) < distance(line, moments) + 0.005


@pytest.mark.long
def test_a_machine_that_delivers_all_messages_late_for_minutes_is_no_change_of_the_clock():
    _, stamps, arrivals = warming(seconds=900, change=0.0)
    late = [arrival + 0.06 if 200 < arrival < 600 else arrival for arrival in arrivals]
    assert fit_bent_clock(stamps, late) == [(0, fit_clock(stamps, late))]


def test_an_even_clock_has_one_map_however_long_it_goes():
    stamps = [10.0 * number for number in range(3600)]
    arrivals = [7.0 + stamp * 1.005 for stamp in stamps]
    assert fit_bent_clock(stamps, arrivals) == [(0, fit_clock(stamps, arrivals))]


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


delays = st.floats(0.0, 2.0)


def exchange(sent, there, back, *, ahead):
    """A question and its answer, with a clock that is so far ahead, over ways that take so long."""
    return ClockExchange(
        sent, sent + there + back, sent + there + ahead, sent + there + ahead, sent + (there + back) / 2
    )


def offset(at, steady, uncertainty=0.0):
    return ClockOffset(at, steady, wall_offset=0.0, round_trip=0.0, uncertainty=uncertainty, exchanges=1)


@given(ahead=st.floats(-1e6, 1e6), ways=st.lists(st.tuples(delays, delays), min_size=1, max_size=8))
def test_the_true_offset_is_within_the_uncertainty_however_uneven_the_ways_are(ahead, ways):
    exchanges = [exchange(10.0 * number, there, back, ahead=ahead) for number, (there, back) in enumerate(ways)]
    estimate = estimate_offset(exchanges)
    assert abs(estimate.wall_offset - ahead) <= estimate.uncertainty + 1e-6
    assert abs(estimate.steady - estimate.at - ahead) <= estimate.uncertainty + 1e-6


@given(ways=st.lists(st.tuples(delays, delays), min_size=2, max_size=8))
def test_the_exchange_with_the_least_delay_wins(ways):
    exchanges = [exchange(10.0 * number, there, back, ahead=3.0) for number, (there, back) in enumerate(ways)]
    least = min(there + back for there, back in ways)
    estimate = estimate_offset(exchanges)
    assert estimate.round_trip == pytest.approx(least, abs=1e-9)
    assert estimate.exchanges == len(ways)


def test_the_steps_of_a_coarse_clock_are_part_of_the_uncertainty():
    coarse = ClockExchange(0.0, 0.002, 5.0, 5.0, 0.001, resolution=0.01)
    assert estimate_offset([coarse]).uncertainty == pytest.approx(0.011)


def test_without_an_exchange_there_is_no_offset():
    with pytest.raises(LinkError, match="no exchange"):
        estimate_offset([])


@given(
    start=st.floats(-1e5, 1e5),
    drift=st.floats(-0.05, 0.05),
    seconds=st.floats(1.0, 1e4),
    share=st.floats(0.0, 1.0),
)
def test_a_clock_that_runs_fast_or_slow_is_brought_to_the_runs_time_everywhere(start, drift, seconds, share):
    def device(run):
        return start + run * (1.0 + drift)

    record = ClockRecord("pi", offset(0.0, device(0.0)), offset(seconds, device(seconds)))
    moment = share * seconds
    assert record.to_run.to_run(device(moment)) == pytest.approx(moment, abs=1e-4)
    assert record.drift == pytest.approx(drift, abs=1e-4)


def test_where_it_could_not_be_asked_again_the_clock_is_taken_to_be_even():
    record = ClockRecord("pi", offset(10.0, 500.0))
    assert record.to_run.to_run(503.0) == 13.0
    assert record.drift is None


def test_a_clock_that_went_back_is_not_believed_to_have_drifted():
    record = ClockRecord("pi", offset(10.0, 500.0), offset(20.0, 3.0))
    assert record.to_run.rate == 1.0


def test_a_steady_clock_that_lost_more_than_any_quartz_is_told_as_a_suspended_computer():
    (doubt,) = ClockRecord("pi", offset(0.0, 500.0, 0.001), offset(95.0, 590.0, 0.001)).doubts()
    assert doubt.startswith("while 95.000 s went by here, the steady clock of pi went on by 90.000 s")
    assert "up to 5.000 s" in doubt


@pytest.mark.parametrize(
    "after",
    [
        None,
        offset(95.0, 595.1, 0.001),  # 0.1 % fast
        offset(95.0, 595.5, 0.4),  # known no better
    ],
)
def test_a_steady_clock_that_goes_as_clocks_do_is_not_doubted(after):
    assert not list(ClockRecord("pi", offset(0.0, 500.0, 0.001), after).doubts())


def test_the_worse_of_both_estimates_is_the_uncertainty():
    record = ClockRecord("pi", offset(0.0, 0.0, 0.001), offset(10.0, 10.0, 0.004))
    assert record.uncertainty == 0.004
    assert record.facts()["uncertainty"] == 0.004
    assert record.facts()["before"]["at"] == 0.0
