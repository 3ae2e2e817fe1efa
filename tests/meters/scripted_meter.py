"""A power meter that sends what a test writes down, built from docs/ina219-protocol.md and from nothing of ours."""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.testing import Chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

SHUNT_OHM = 0.1
PERIOD_US = 5000
#: What one step of noise adds to four samples on end; nothing on average.
NOISE = (0, 1, 0, -1)


def frame(version_and_type: int, sequence: int, payload: bytes) -> bytes:
    checked = struct.pack("<BBH", version_and_type, len(payload), sequence % 65536) + payload
    return b"\xa5\x5a" + checked + struct.pack("<H", binascii.crc_hqx(checked, 0xFFFF))


def sample(sequence: int, microseconds: int, shunt_raw: int = 6130, bus_raw: int = 0x60E2) -> bytes:
    return frame(0x11, sequence, struct.pack("<IhH", microseconds % 2**32, shunt_raw, bus_raw))


def hello(
    sequence: int, microseconds: int, *, rate: int = 200, micro_ohm: int = 100_000, configuration: int = 0x1CCF
) -> bytes:
    return frame(0x12, sequence, struct.pack("<IHIH", microseconds % 2**32, rate, micro_ohm, configuration))


def mark(sequence: int, microseconds: int, *, is_on: bool) -> bytes:
    return frame(0x13, sequence, struct.pack("<IB", microseconds % 2**32, is_on))


@dataclass
class ScriptedMeter:
    """Sends samples of a power that is known at every moment.

    Attributes:
        power: W at a time on the run's clock, s.
        volts: the voltage of the bus, V.
        rate: samples a second.
        latency: how long each frame takes to arrive, s.
        skew: how much slower the device's clock goes than the run's.
        first_stamp: what the device's clock shows at the first sample, µs.
        first_sequence: the number of the first sample.
        left_out: samples (counted from 0) that are never sent.
        damaged: samples whose shunt register is changed on the way.
        noise: steps by which the shunt register is off by turns, as one that measures is; 0 for a sensor that is stuck.
        says_hello: whether it says a hello before the first sample.
    """

    power: Callable[[float], float]
    volts: float = 11.1
    rate: int = 200
    latency: float = 0.002
    skew: float = 0.0
    first_stamp: int = 0
    first_sequence: int = 0
    left_out: Collection[int] = ()
    damaged: Collection[int] = ()
    noise: int = 1
    says_hello: bool = True
    micro_ohm: int = 100_000

    def chunks(self, *, start: float, end: float) -> list[Chunk]:
        """Return what arrives of the samples that are taken from `start` to `end` on the run's clock."""
        chunks = [Chunk(start, hello(self.first_sequence, self.first_stamp, rate=self.rate, micro_ohm=self.micro_ohm))]
        for number in range(int((end - start) * self.rate) + 1):
            time = start + number / self.rate
            if number not in self.left_out:
                chunks.append(Chunk(time + self.latency, self._frame(number, time, start)))
        return chunks if self.says_hello else chunks[1:]

    def _frame(self, number: int, time: float, start: float) -> bytes:
        stamp = self.first_stamp + round((time - start) * (1 - self.skew) * 1e6)
        amperes = self.power(time) / self.volts
        shunt_raw, bus_raw = round(amperes * SHUNT_OHM / 10e-6), round(self.volts / 4e-3) << 3
        shunt_raw = min(max(shunt_raw + self.noise * NOISE[number % 4], -32000), 32000)
        sent = bytearray(sample(self.first_sequence + number, stamp, shunt_raw, bus_raw))
        if number in self.damaged:
            sent[10] ^= 0x40
        return bytes(sent)


def recording(
    count: int,
    *,
    marks: Sequence[tuple[int, bool]] = (),
    start_us: int = 5000,
    first: int = 0,
    says_hello: bool = True,
    noise: int = 1,
) -> bytes:
    """A recording of so many samples of a constant power; `marks` are (before which sample, is it on)."""
    pieces = [hello(first, start_us)] if says_hello else []
    for number in range(count):
        now = start_us + number * PERIOD_US
        pieces += [mark(first + number, now, is_on=is_on) for at, is_on in marks if at == number]
        pieces.append(sample(first + number, now, 6130 + noise * NOISE[number % 4]))
    whole = b"".join(pieces)
    return whole + bytes(-len(whole) % 512)
