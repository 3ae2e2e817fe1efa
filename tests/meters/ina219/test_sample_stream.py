from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meters.scripted_meter import ScriptedMeter, hello, mark, sample

from robot_runner.meters.ina219.sample_stream import SampleStream, Trouble
from robot_runner.testing import Chunk


def streamed(chunks: list[Chunk]) -> SampleStream:
    stream = SampleStream()
    stream.take(chunks)
    stream.finish()
    return stream


def steady(**script) -> ScriptedMeter:
    return ScriptedMeter(lambda _: 8.0, **script)


def test_samples_are_placed_on_the_runs_clock():
    stream = streamed(steady(first_stamp=7_000_000, latency=0.001).chunks(start=100.0, end=101.0))
    assert len(stream) == 201
    assert list(stream.times()[:2]) == pytest.approx([100.001, 100.006])


def test_stamps_are_unwrapped_after_71_minutes():
    stream = streamed(steady(first_stamp=2**32 - 1_000_000).chunks(start=0.0, end=3.0))
    times = stream.times()
    assert times[-1] - times[0] == pytest.approx(3.0)
    assert (stream.troubles()[Trouble.LOST], stream.troubles()[Trouble.RESTART]) == (0, 0)


def test_sequence_numbers_begin_anew_after_65535():
    assert streamed(steady(first_sequence=65_500).chunks(start=0.0, end=1.0)).troubles()[Trouble.LOST] == 0


@pytest.mark.long
@given(left_out=st.sets(st.integers(1, 398), max_size=60))
def test_lost_samples_are_counted_exactly(left_out):
    stream = streamed(steady(left_out=left_out, first_sequence=65_400).chunks(start=0.0, end=2.0))
    assert stream.troubles()[Trouble.LOST] == len(left_out)
    assert len(stream) == 401 - len(left_out)


def test_a_damaged_sample_is_corrupt_and_lost():
    stream = streamed(steady(damaged={10, 20, 30}).chunks(start=0.0, end=1.0))
    assert (stream.counts.corrupt, stream.troubles()[Trouble.LOST]) == (3, 3)


def test_a_sample_that_came_twice_is_held_once():
    chunks = steady().chunks(start=0.0, end=1.0)
    stream = streamed([*chunks[:50], chunks[49], *chunks[50:]])
    assert (len(stream), stream.troubles()[Trouble.DUPLICATE], stream.troubles()[Trouble.LOST]) == (201, 1, 0)


@pytest.mark.parametrize("uptime", [5_000_000, 3_000_000_000])
def test_a_device_that_starts_anew_goes_on_in_the_runs_time(uptime):
    before = steady(first_stamp=uptime, first_sequence=9000).chunks(start=50.0, end=52.0)
    after = steady().chunks(start=54.0, end=56.0)
    stream = streamed([*before, *after])
    times = stream.times()
    assert (stream.troubles()[Trouble.RESTART], stream.troubles()[Trouble.LOST]) == (1, 0)
    assert times[401] - times[400] == pytest.approx(2.0, abs=0.01)


def test_what_a_false_beginning_held_back_is_not_lost():
    chunks = steady().chunks(start=0.0, end=1.0)
    chunks.insert(-1, Chunk(chunks[-2].received_at, b"\xa5\x5a\x11\x40"))  # says that 72 bytes belong to it
    assert len(streamed(chunks)) == 201


def test_a_clock_that_is_half_a_percent_slow_is_mended():
    stream = streamed(steady(skew=0.005).chunks(start=10.0, end=105.0))
    times = stream.times()
    assert times[-1] - times[0] == pytest.approx(95.0, abs=1e-4)


def test_the_saying_of_the_device_is_kept():
    assert streamed(steady().chunks(start=0.0, end=0.1)).hello.shunt_ohm == 0.1


def test_marks_are_stamped_by_the_devices_clock_also_where_it_wraps():
    late = 2**32 - 7000
    data = sample(0, late) + sample(1, late + 5000) + mark(2, late + 9000, is_on=True) + sample(2, late + 10_000)
    stream = streamed([Chunk(1.0, data)])
    assert [(round(each.seconds, 6), each.is_on) for each in stream.marks] == [(0.009, True)]
    assert len(stream) == 3


def test_every_configuration_that_the_sensor_had_is_kept():
    stream = streamed([Chunk(0.0, hello(0, 5000)), Chunk(1.0, hello(200, 1_005_000, configuration=0x399F))])
    assert stream.configurations == {0x1CCF, 0x399F}


def test_without_arrivals_the_lives_of_a_device_are_laid_end_to_end():
    stream = SampleStream(has_arrivals=False)
    stream.take([Chunk(0.0, sample(0, 4_000_000) + sample(1, 4_005_000) + sample(0, 5000) + sample(1, 10_000))])
    assert list(stream.device_seconds) == pytest.approx([0.0, 0.005, 0.005, 0.010])
    assert stream.troubles()[Trouble.RESTART] == 1


def test_nothing_gives_no_times():
    assert list(streamed([]).times()) == []


def test_one_sample_is_placed_at_its_arrival():
    assert list(streamed([Chunk(3.0, sample(0, 12345))]).times()) == [3.0]
