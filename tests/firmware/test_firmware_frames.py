"""What the firmware sends is what docs/ina219-protocol.md says, byte by byte."""

from __future__ import annotations

import os
import struct
import time
from itertools import pairwise

import pytest
from tests.firmware.measuring import MISSION, MISSIONS, VOLTS, measure
from tests.firmware.raw_line import decoded, intact, opened, read_until_unplugged
from tests.firmware.simulated_board import BoardClock, executed
from tests.meters.scripted_meter import frame, hello, mark, sample

from robot_runner.meters.ina219.frames import FrameDecoder, Hello, Mark, SampleFrame, Sensing


def encoded(one) -> bytes:
    """Encode a frame by the page of the protocol, with nothing of the decoder's."""
    if isinstance(one, SampleFrame):
        return sample(*one[:4])
    if isinstance(one, Sensing):
        ohm, lag = round(one.shunt_ohm * 1e6), round(one.lag_s * 1e6)
        payload = one.microseconds, one.address, ohm, one.configuration, lag, one.looks
        return frame(0x14, one.next_sequence, struct.pack("<IBIHIB", *payload))
    if isinstance(one, Mark):
        return mark(one.next_sequence, one.microseconds, is_on=one.is_on)
    ohm = round(one.shunt_ohm * 1e6)
    return hello(one.next_sequence, one.microseconds, rate=one.rate_hz, micro_ohm=ohm, configuration=one.configuration)


@pytest.fixture(scope="module")
def sent(built, tmp_path_factory) -> tuple[bytes, list]:
    """What the board sent while it was listened to, and the frames in it."""
    folder = tmp_path_factory.mktemp("sent")
    clock = BoardClock(folder / "clock")
    with executed(built, clock=clock, truth=folder / "truth", load="0:0.7", volts=VOLTS, noise=0) as meter:
        measure(meter, folder, 6.0)
        meter.facts()
    data = (folder / "truth").read_bytes()
    return data, FrameDecoder().feed(data)


def test_every_byte_is_that_of_the_protocol(sent):
    data, frames = sent
    again = b"".join(map(encoded, frames))
    assert data.startswith(again)
    assert len(data) - len(again) < 24  # the last frame was cut off


def test_registers_are_sent_as_the_sensor_holds_them(sent):
    _, frames = sent
    samples = [each for each in frames if isinstance(each, SampleFrame)]
    # 0.7 A through 0.1 ohm in steps of 10 uV; 11.1 V in steps of 4 mV from bit 3 on, CNVR set.
    assert {(each.shunt_raw, each.bus_raw) for each in samples} == {(7000, 2775 << 3 | 2)}


def test_samples_are_numbered_and_come_every_5_ms_and_a_hello_before_each_200th(sent):
    _, frames = sent
    samples = [each for each in frames if isinstance(each, SampleFrame)]
    assert len(samples) >= 1200
    assert [each.sequence for each in samples] == list(range(len(samples)))
    assert {round(each.microseconds / 5000) - each.sequence for each in samples} == {1}
    before = [following for each, following in pairwise(frames) if isinstance(each, Sensing)]
    assert [each.sequence for each in before] == list(range(0, len(samples), 200))
    assert {each.configuration for each in frames if isinstance(each, Hello)} == {0x19DD}


def test_what_the_sensor_averages_is_told_behind_each_hello(sent):
    _, frames = sent
    behind = [following for each, following in pairwise(frames) if isinstance(each, Hello)]
    # Eight conversions of 0.532 ms, held until the next ones, and half of the 5 ms between samples.
    assert {(each.address, each.configuration, each.looks) for each in behind} == {(0x40, 0x19DD, 5)}
    assert behind[0].lag_s == pytest.approx(8 * 532e-6 + 2.5e-3)


def test_a_question_mark_is_answered_with_a_hello_before_the_next_sample(free_board):
    decoder, hellos = FrameDecoder(), []
    with free_board(pace=1) as meter, opened(meter) as line:
        deadline = time.monotonic() + 20
        while len(hellos) < 2 and time.monotonic() < deadline:
            hellos += [each for each in decoder.feed(os.read(line, 4096)) if isinstance(each, Hello)]
            if len(hellos) == 1:
                os.write(line, b"x?")
    assert hellos[0].next_sequence == 0
    assert 0 < hellos[1].next_sequence < 200


@pytest.mark.long
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_every_corrupt_frame_is_detected_and_no_intact_one_is_lost(board, tmp_path, share):
    truth = tmp_path / "truth"
    with board(truth=truth, load=MISSION.words, volts=VOLTS, corrupt=share, seed=3, seconds=10) as meter:
        received = read_until_unplugged(meter)
        meter.facts()
    assert truth.stat().st_size - len(received) < 24, "only a frame that was cut off is not received"
    untouched, hit = intact(truth.read_bytes(), received)
    assert decoded(received) == untouched
    assert hit == pytest.approx(2_020 * (1 - (1 - share) ** 16), rel=0.1)


@pytest.mark.soak
def test_no_frame_is_lost_in_ten_minutes(board, tmp_path):
    with board(load=MISSIONS.words, volts=VOLTS) as meter:
        measured = measure(meter, tmp_path, 600.0)
    assert measured.quality["samples"]["got"] == pytest.approx(120_000, abs=2)
    assert measured.quality["samples"]["lost"] == 0
    assert measured.problems == []
    assert abs(measured.error_of("Energy", MISSIONS)) < 0.005
