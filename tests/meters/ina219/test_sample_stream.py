from __future__ import annotations

import struct
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meters.scripted_meter import ScriptedMeter, frame, hello, mark, sample

from robot_runner.meters.ina219.frames import FrameDecoder
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


def late(chunks: list[Chunk], seconds: float) -> list[Chunk]:
    return [Chunk(chunk.received_at + seconds, chunk.data) for chunk in chunks]


SENSING = frame(0x14, 0, struct.pack("<IBIHIB", 0, 0x40, 100_000, 0x1CCF, 2000, 1))
STEADY = steady(first_sequence=65_500).chunks(start=0.0, end=0.5)
NEXT = partial(steady, first_sequence=65_601)
COURSES = {
    "as usual": STEADY,
    "with one lost": [*STEADY[:40], *STEADY[41:]],
    "with one that came twice": [*STEADY[:40], STEADY[39], *STEADY[40:]],
    "with one damaged": steady(damaged={30}).chunks(start=0.0, end=0.5),
    "with noise between two": [*STEADY[:40], Chunk(STEADY[40].received_at, b"\xa5noise"), *STEADY[40:]],
    "with noise as long as a sample": [*STEADY[:40], Chunk(STEADY[40].received_at, b"noise of 16 byte"), *STEADY[40:]],
    "with a mark": [*STEADY[:40], Chunk(STEADY[40].received_at, mark(65_540, 200_000, is_on=True)), *STEADY[40:]],
    "with a false beginning": [*STEADY[:40], Chunk(STEADY[40].received_at, b"\xa5\x5a\x11\x20"), *STEADY[40:]],
    "with a device that starts anew": [*STEADY, *late(steady(first_stamp=9).chunks(start=0.0, end=0.5)[1:], 7.0)],
    "with stamps that leap ahead": [*STEADY, *late(NEXT(first_stamp=2**30).chunks(start=0.0, end=0.1)[1:], 1.0)],
    "with stamps that step back": [*STEADY, *late(NEXT(first_stamp=9).chunks(start=0.0, end=0.1)[1:], 1.0)],
    "with a sensor that is told of later": [*STEADY[:40], Chunk(STEADY[40].received_at, SENSING), *STEADY[40:]],
    "with stamps that stand still": steady(skew=1.0).chunks(start=0.0, end=0.5),
    "with arrivals that step back": [*STEADY[:40], *late(STEADY[40:], -61.0)],
    "with arrivals that step back at once": [*STEADY[:9], *late(STEADY[9:], -61.0)],
}


@pytest.mark.parametrize("chunks", COURSES.values(), ids=COURSES)
@pytest.mark.parametrize("of", [{}, {"address": 0x41}, {"has_arrivals": False}], ids=str)
def test_samples_that_are_taken_together_are_what_they_are_one_by_one(chunks, of, monkeypatch):
    def told() -> tuple[object, ...]:
        stream = SampleStream(**of)
        stream.take(chunks[:9])
        stream.take(chunks[9:])
        stream.finish()
        columns = [list(each) for each in (stream.device_seconds, stream.shunt_raw, stream.bus_raw, stream.times())]
        facts = stream.troubles(), stream.counts, stream.marks, stream.sensing, stream.bytes, stream.bytes_since_frame
        return columns, facts

    together = told()
    monkeypatch.setattr(FrameDecoder, "take_samples", lambda *_: None)
    assert together == told()
