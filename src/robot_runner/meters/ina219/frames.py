"""The frames of docs/ina219-protocol.md, and the decoder that finds them in the bytes of a line."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import NamedTuple

_SYNC = b"\xa5\x5a"
_VERSION = 1
_HEADER_SIZE = 6
_LONGEST_PAYLOAD = 64
_CHECKSUM_SIZE = 2
_CRC_START = 0xFFFF

#: The bytes after the sync bytes (version and type, then length of payload), and the payload after them.
_SAMPLE_KIND, _SAMPLE = b"\x11\x08", struct.Struct("<HIhH")  # sequence, µs, shunt register, bus register
_HELLO_KIND, _HELLO = b"\x12\x0c", struct.Struct("<HIHIH")  # sequence, µs, Hz, µΩ, configuration register
_MARK_KIND, _MARK = b"\x13\x05", struct.Struct("<HIB")  # sequence, µs, whether it is on
_SENSING_KIND, _SENSING = b"\x14\x10", struct.Struct("<HIBIHIB")  # sequence, µs, address, µΩ, configuration, µs, looks
_FURTHER_KIND, _FURTHER = b"\x15\x09", struct.Struct("<HIBhH")  # sequence, µs, address, shunt register, bus register
#: The whole frame of a sample: its beginning, payload and checksum; and the part of it that the checksum covers.
_SAMPLE_FRAME, _SAMPLE_CHECKED = struct.Struct("<4sHIhHH"), struct.Struct("<2x12s2x")
_SAMPLE_START = _SYNC + _SAMPLE_KIND
SAMPLE_BYTES = _SAMPLE_FRAME.size

#: Stands for the address of the first sensor, whose samples carry none.
FIRST_SENSOR = 0


class SampleFrame(NamedTuple):
    """One sample as the device sent it (a tuple, because there are some 19,000 in a run).

    Attributes:
        sequence: the number of the sample, modulo 65536.
        microseconds: the device's clock when the registers were read, modulo 2**32 µs.
        shunt_raw: the shunt voltage register, 10 µV a step.
        bus_raw: the bus voltage register, not shifted.
        address: of the sensor, where it is not the first one.
    """

    sequence: int
    microseconds: int
    shunt_raw: int
    bus_raw: int
    address: int = FIRST_SENSOR


class SampleColumns(NamedTuple):
    """Many samples of the first sensor, each a place in every column; the columns are those of `SampleFrame`."""

    sequences: Sequence[int]
    microseconds: Sequence[int]
    shunt_raw: Sequence[int]
    bus_raw: Sequence[int]


@dataclass(frozen=True, slots=True)
class Hello:
    """The device's description of itself.

    Attributes:
        next_sequence: the number of the next sample.
        microseconds: the device's clock, modulo 2**32 µs.
        rate_hz: samples a second.
        shunt_ohm: resistance of the shunt that the firmware was built for, ohm.
        configuration: the sensor's configuration register.
    """

    next_sequence: int
    microseconds: int
    rate_hz: int
    shunt_ohm: float
    configuration: int


@dataclass(frozen=True, slots=True)
class Mark:
    """The meter's mark was set or taken back: its input was pulled low or released.

    Attributes:
        next_sequence: the number of the next sample.
        microseconds: the device's clock, modulo 2**32 µs.
        is_on: whether the measured window begins here; else it ends.
    """

    next_sequence: int
    microseconds: int
    is_on: bool


@dataclass(frozen=True, slots=True)
class Sensing:
    """The device's description of one of its sensors, and of how it reads it; sent with each hello.

    Attributes:
        next_sequence: the number of the next sample.
        microseconds: the device's clock, modulo 2**32 µs.
        address: of the sensor on the device's bus.
        shunt_ohm: resistance of its shunt, ohm.
        configuration: its configuration register.
        lag_s: from the middle of the time that a sample averages to its time stamp, s.
        looks: how often its register is read for one sample.
    """

    next_sequence: int
    microseconds: int
    address: int
    shunt_ohm: float
    configuration: int
    lag_s: float
    looks: int


Frame = SampleFrame | Hello | Mark | Sensing


class DecoderCounts(NamedTuple):
    """A decoder's counts, from the first good frame on (a tuple, as there is one for each piece).

    Before that frame come meaningless bytes, if the line was opened in the middle of a frame, or from a boot loader.

    Attributes:
        corrupt: frames whose checksum was wrong.
        dropped_bytes: bytes outside of good frames, including those of corrupt frames.
        foreign_versions: good frames of another version of the protocol.
        frames: good frames.
    """

    corrupt: int = 0
    dropped_bytes: int = 0
    foreign_versions: int = 0
    frames: int = 0


class FrameDecoder:
    """Decodes bytes, in pieces of any size, to frames, and resynchronises after noise.

    Attributes:
        frames: the number of good ones.

    Example:
        >>> decoder = FrameDecoder()
        >>> decoder.feed(bytes.fromhex("00ff a55a 1108 0100 88130000 f217 e260 15df"))
        [SampleFrame(sequence=1, microseconds=5000, shunt_raw=6130, bus_raw=24802, address=0)]
    """

    def __init__(self) -> None:
        self._buffer = b""
        self._has_seen_frame = False
        self._unexplained = 0  # bytes dropped since the last good frame
        self._doubted = 0  # the end, in the buffer, of a frame that was found corrupt
        self._corrupt = 0
        self._dropped = 0
        self._foreign = 0
        self.frames = 0

    @property
    def is_sound(self) -> bool:
        """Whether there were only good frames so far."""
        return not (self._corrupt or self._dropped or self._foreign)

    @property
    def counts(self) -> DecoderCounts:
        """The counts so far."""
        return DecoderCounts(self._corrupt, self._dropped, self._foreign, self.frames)

    def take_samples(self, pieces: Sequence[bytes]) -> SampleColumns | None:
        """Return the samples of pieces, if each piece is one whole sample, as usual on a line with pauses between them.

        Otherwise, or if the buffer still has undecoded bytes, return None and take nothing.

        Args:
            pieces: one or more, of `SAMPLE_BYTES` each.
        """
        if self._buffer or self._unexplained:
            return None
        data = b"".join(pieces)
        checked = chain.from_iterable(_SAMPLE_CHECKED.iter_unpack(data))
        starts, *said, checksums = zip(*_SAMPLE_FRAME.iter_unpack(data), strict=True)
        if set(starts) != {_SAMPLE_START} or tuple(map(crc_hqx, checked, repeat(_CRC_START))) != checksums:
            return None
        self._has_seen_frame = True
        self.frames += len(pieces)
        return SampleColumns(*said)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are complete now; bytes that may become one are kept for the next call."""
        self._buffer += data
        return self._decode(is_last=False)

    def finish(self) -> list[Frame]:
        """Return the frames that were held back after the beginning of a frame that never became complete."""
        return self._decode(is_last=True)

    def _decode(self, *, is_last: bool) -> list[Frame]:
        buffer, at, frames = self._buffer, 0, []
        while True:
            at = self._skip_to_sync(buffer, at)
            end = _end_of_frame(buffer, at)
            if at == len(buffer) or (end > len(buffer) and not is_last):
                break
            if _is_intact(buffer, at, end):
                frames += self._opened(buffer, at)
                at = end
            else:
                self._doubt(at, end, len(buffer))
                at += 1
        self._buffer = buffer[at:]
        self._doubted = max(self._doubted - at, 0)
        return frames

    def _skip_to_sync(self, buffer: bytes, at: int) -> int:
        found = buffer.find(_SYNC, at)
        if found < 0:  # the second sync byte may still come
            found = len(buffer) - buffer.endswith(_SYNC[:1], at)
        self._unexplained += found - at
        return found

    def _doubt(self, at: int, end: int, size: int) -> None:
        """Count a corrupt frame, unless its beginning is inside another one."""
        self._unexplained += 1
        if at < end <= size and at >= self._doubted:
            self._corrupt += self._has_seen_frame
            self._doubted = end

    def _opened(self, buffer: bytes, at: int) -> list[Frame]:
        """Return an intact frame, decoded; an empty list for other types and versions."""
        self._count_frame()
        kind = buffer[at + 2 : at + 4]
        if kind == _SAMPLE_KIND:
            return [SampleFrame(*_SAMPLE.unpack_from(buffer, at + 4))]
        if kind == _HELLO_KIND:
            sequence, stamp, rate, micro_ohm, configuration = _HELLO.unpack_from(buffer, at + 4)
            return [Hello(sequence, stamp, rate, micro_ohm / 1e6, configuration)]
        if kind == _MARK_KIND:
            sequence, stamp, level = _MARK.unpack_from(buffer, at + 4)
            return [Mark(sequence, stamp, bool(level))]
        if kind == _FURTHER_KIND:
            sequence, stamp, address, shunt_raw, bus_raw = _FURTHER.unpack_from(buffer, at + 4)
            return [SampleFrame(sequence, stamp, shunt_raw, bus_raw, address)]
        if kind == _SENSING_KIND:
            sequence, stamp, address, micro_ohm, configuration, lag, looks = _SENSING.unpack_from(buffer, at + 4)
            return [Sensing(sequence, stamp, address, micro_ohm / 1e6, configuration, lag / 1e6, looks)]
        self._foreign += buffer[at + 2] >> 4 != _VERSION
        return []

    def _count_frame(self) -> None:
        self._dropped += self._unexplained if self._has_seen_frame else 0
        self._has_seen_frame, self._unexplained = True, 0
        self.frames += 1


def _end_of_frame(buffer: bytes, at: int) -> int:
    """Return the end of the frame that begins at `at`, or `at` if it cannot be a frame."""
    if len(buffer) - at < _HEADER_SIZE:
        return len(buffer) + 1
    payload = buffer[at + 3]
    return at + _HEADER_SIZE + payload + _CHECKSUM_SIZE if payload <= _LONGEST_PAYLOAD else at


def _is_intact(buffer: bytes, at: int, end: int) -> bool:
    if not at < end <= len(buffer):
        return False
    checked = end - _CHECKSUM_SIZE
    return crc_hqx(buffer[at + len(_SYNC) : checked], _CRC_START) == buffer[checked] | buffer[checked + 1] << 8
