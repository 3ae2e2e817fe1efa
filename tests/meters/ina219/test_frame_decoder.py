from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meters.scripted_meter import frame, hello, mark, sample

from robot_runner.meters.ina219.frames import Frame, FrameDecoder, Hello, Mark, SampleFrame

SAMPLES = [sample(number, 5000 * number) for number in range(20)]
TRUE = [SampleFrame(number, 5000 * number, 6130, 0x60E2) for number in range(20)]


def decoded(data: bytes, piece: int = 7) -> tuple[list[Frame], FrameDecoder]:
    decoder, frames = FrameDecoder(), []
    for at in range(0, len(data), piece):
        frames += decoder.feed(data[at : at + piece])
    return frames + decoder.finish(), decoder


def test_the_worked_examples_of_the_protocol_are_understood():
    frames, decoder = decoded(
        bytes.fromhex("a55a 120c 0000 00000000 c800 a0860100 cf1c 0b0d a55a 1108 0100 88130000 f217 e260 15df")
    )
    assert frames == [Hello(0, 0, 200, 0.1, 0x1CCF), SampleFrame(1, 5000, 6130, 0x60E2)]
    assert decoder.counts.dropped_bytes == 0


@pytest.mark.parametrize("piece", [1, 2, 5, 16, 17, 1000])
def test_frames_are_found_in_pieces_of_any_size(piece):
    assert decoded(b"".join(SAMPLES), piece)[0] == TRUE


def test_a_negative_shunt_register_is_read_as_such():
    assert decoded(sample(0, 0, shunt_raw=-250))[0][0].shunt_raw == -250


def test_what_comes_before_the_first_frame_is_neither_noise_nor_corrupt():
    frames, decoder = decoded(SAMPLES[0][5:] + b"boot loader \xa5\x5a\x00\x02" + b"".join(SAMPLES))
    assert frames == TRUE
    assert (decoder.counts.corrupt, decoder.counts.dropped_bytes) == (0, 0)


def test_noise_between_frames_is_dropped_and_counted():
    frames, decoder = decoded(b"".join(SAMPLES[:10]) + b"noise\xa5" + b"".join(SAMPLES[10:]))
    assert frames == TRUE
    assert decoder.counts.dropped_bytes == 6


def test_noise_after_the_last_frame_is_not_counted_because_it_may_be_the_beginning_of_one():
    assert decoded(SAMPLES[0] + SAMPLES[1][:9])[1].counts.dropped_bytes == 0


def test_each_damaged_frame_is_counted_once():
    stream = bytearray(b"".join(SAMPLES))
    for number in (3, 4, 11):
        stream[16 * number + 9] ^= 0x10
    frames, decoder = decoded(bytes(stream))
    assert frames == [one for number, one in enumerate(TRUE) if number not in {3, 4, 11}]
    assert (decoder.counts.corrupt, decoder.counts.dropped_bytes) == (3, 48)


def test_a_frame_whose_payload_looks_like_the_beginning_of_a_frame_is_counted_once_when_damaged():
    tricky = bytearray(sample(1, 0x5AA5, shunt_raw=0x08A5, bus_raw=0x11))
    tricky[15] ^= 1
    decoder = decoded(SAMPLES[0] + bytes(tricky) + b"".join(SAMPLES[2:]))[1]
    assert decoder.counts.corrupt == 1


@given(position=st.integers(0, 16 * 20 - 1), change=st.integers(1, 255), piece=st.integers(1, 64))
def test_one_changed_byte_costs_one_frame_at_most(position, change, piece):
    stream = bytearray(b"".join(SAMPLES))
    stream[position] ^= change
    frames, _ = decoded(bytes(stream), piece)
    hit = position // 16
    assert frames == TRUE[:hit] + TRUE[hit + 1 :]


@given(noise=st.binary(max_size=200), piece=st.integers(1, 64))
def test_the_decoder_finds_its_feet_after_any_noise(noise, piece):
    frames, _ = decoded(SAMPLES[0] + noise + b"".join(SAMPLES[1:]), piece)
    assert [each for each in frames if each in TRUE[1:]] == TRUE[1:]


def test_a_length_that_no_frame_has_does_not_hold_up_the_stream():
    assert FrameDecoder().feed(b"\xa5\x5a\x11\xff\x00\x00" + SAMPLES[0]) == [TRUE[0]]


def test_other_versions_are_counted_and_other_types_ignored():
    frames, decoder = decoded(frame(0x21, 0, b"newer") + frame(0x13, 0, b"?") + hello(0, 0, rate=100) + SAMPLES[0])
    assert [type(each) for each in frames] == [Hello, SampleFrame]
    assert decoder.counts.foreign_versions == 1


def test_a_mark_says_whether_it_is_on():
    frames, _ = decoded(mark(7, 35_000, is_on=True) + SAMPLES[7] + mark(8, 40_000, is_on=False))
    assert frames == [Mark(7, 35_000, is_on=True), TRUE[7], Mark(8, 40_000, is_on=False)]


def test_random_bytes_are_hardly_ever_taken_for_a_sample():
    rubbish = random.Random(1).randbytes(100_000)  # noqa: S311 - noise, no secret
    assert decoded(rubbish, 4096)[0] == []
