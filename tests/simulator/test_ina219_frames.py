"""The frames of the power meter are those of the documented protocol."""

from __future__ import annotations

import binascii
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.simulator.power_meter import HELLO_SIZE, SAMPLE_SIZE, hello_frame, sample_frames

PROTOCOL = Path(__file__).parents[2] / "docs" / "ina219-protocol.md"


def documented_frames():
    """The worked examples, as printed in the document: hexadecimal bytes, the head line of each block."""
    blocks = re.findall(r"```text\n(A5 5A [0-9A-F ]+?) *\n", PROTOCOL.read_text(encoding="utf-8"))
    return [bytes.fromhex(block) for block in blocks]


def frames_of(*samples):
    columns = np.array(samples, dtype=np.int64).reshape(-1, 4).T
    sequences, times, shunts, buses = columns
    return sample_frames(sequences=sequences, times=times, shunts=shunts, buses=buses)


def test_a_sample_is_the_documented_example():
    sample, _ = documented_frames()
    assert frames_of((1, 5000, 6130, 0x60E2)) == sample


def test_a_hello_is_the_documented_example():
    _, hello = documented_frames()
    assert hello_frame(sequence=0, time=0, rate=200, shunt=100_000, configuration=0x1CCF) == hello


@given(
    st.lists(
        st.tuples(st.integers(0, 2**40), st.integers(0, 2**40), st.integers(-32768, 32767), st.integers(0, 65535)),
        min_size=1,
        max_size=20,
    )
)
def test_any_samples_come_out_as_the_document_lays_them_out(samples):
    data = frames_of(*samples)
    assert len(data) == SAMPLE_SIZE * len(samples)
    for index, (sequence, time, shunt, bus) in enumerate(samples):
        frame = data[index * SAMPLE_SIZE : (index + 1) * SAMPLE_SIZE]
        assert struct.unpack("<2sBBHIhH", frame[:14]) == (
            b"\xa5\x5a",
            0x11,
            8,
            sequence % 2**16,
            time % 2**32,
            shunt,
            bus,
        )
        assert struct.unpack("<H", frame[14:])[0] == binascii.crc_hqx(frame[2:14], 0xFFFF)


@pytest.mark.parametrize(("number", "sent"), [(65535, 65535), (65536, 0), (70000, 4464)])
def test_numbers_wrap(number, sent):
    assert struct.unpack_from("<H", frames_of((number, 0, 0, 0)), 4)[0] == sent
    hello = hello_frame(sequence=number, time=2**32 + 7, rate=200, shunt=1, configuration=0)
    assert struct.unpack_from("<HI", hello, 4) == (sent, 7)
    assert len(hello) == HELLO_SIZE
