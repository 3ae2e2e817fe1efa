"""The stream of samples in columns: what was lost, what came twice, and when each sample was taken."""

from __future__ import annotations

import math
import struct
from array import array
from binascii import crc_hqx
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.core.sampling.device_clock import fit_clock

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.core.links.serial_line import Chunk

__all__ = ["DecoderCounts", "Frame", "FrameDecoder", "Hello", "Mark", "SampleFrame", "SampleStream", "StampedMark"]


_SYNC = b"\xa5\x5a"
_VERSION = 1
_HEADER_SIZE = 6
_LONGEST_PAYLOAD = 64
_CHECKSUM_SIZE = 2
_CRC_START = 0xFFFF

#: Version and type, then length of payload: the bytes behind the sync bytes. Then what follows them.
_SAMPLE_KIND, _SAMPLE = b"\x11\x08", struct.Struct("<HIhH")  # sequence, µs, shunt register, bus register
_HELLO_KIND, _HELLO = b"\x12\x0c", struct.Struct("<HIHIH")  # sequence, µs, Hz, µΩ, configuration register
_MARK_KIND, _MARK = b"\x13\x05", struct.Struct("<HIB")  # sequence, µs, whether it is on


class SampleFrame(NamedTuple):
    """One sample as the device sent it (a tuple, because there are some 19,000 in a run).

    Attributes:
        sequence: the number of the sample, modulo 65536.
        microseconds: the device's clock when the registers were read, modulo 2**32 µs.
        shunt_raw: the shunt voltage register, 10 µV a step.
        bus_raw: the bus voltage register, not shifted.
    """

    sequence: int
    microseconds: int
    shunt_raw: int
    bus_raw: int


@dataclass(frozen=True, slots=True)
class Hello:
    """What the device says of itself.

    Attributes:
        next_sequence: the number that the next sample will carry.
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
        next_sequence: the number that the next sample will carry.
        microseconds: the device's clock, modulo 2**32 µs.
        is_on: whether the measured window begins here; else it ends.
    """

    next_sequence: int
    microseconds: int
    is_on: bool


Frame = SampleFrame | Hello | Mark


@dataclass(frozen=True, slots=True)
class DecoderCounts:
    """What a decoder met besides good frames, from the first good frame on.

    Before it a line that was opened in the middle of a frame, or a boot loader, sends bytes that mean nothing.

    Attributes:
        corrupt: frames whose checksum was wrong.
        dropped_bytes: bytes that belonged to no good frame, those of corrupt frames included.
        foreign_versions: good frames of another version of the protocol.
    """

    corrupt: int = 0
    dropped_bytes: int = 0
    foreign_versions: int = 0


class FrameDecoder:
    """Turns bytes, in pieces of any size, into frames, and finds its feet again after noise.

    Example:
        >>> decoder = FrameDecoder()
        >>> decoder.feed(bytes.fromhex("00ff a55a 1108 0100 88130000 f217 e260 15df"))
        [SampleFrame(sequence=1, microseconds=5000, shunt_raw=6130, bus_raw=24802)]
    """

    def __init__(self) -> None:
        self._buffer = b""
        self._has_seen_frame = False
        self._unexplained = 0  # bytes dropped since the last good frame
        self._doubted = 0  # up to where the buffer belongs to a frame that was found corrupt
        self._corrupt = 0
        self._dropped = 0
        self._foreign = 0

    @property
    def counts(self) -> DecoderCounts:
        """What was met besides good frames so far."""
        return DecoderCounts(self._corrupt, self._dropped, self._foreign)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are complete now; what may still become one is kept for the next call."""
        self._buffer += data
        return self._decode(is_last=False)

    def finish(self) -> list[Frame]:
        """Return the frames that were held back by the beginning of a frame that never became complete."""
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
        if found < 0:  # the partner of a lone first sync byte may still come
            found = len(buffer) - buffer.endswith(_SYNC[:1], at)
        self._unexplained += found - at
        return found

    def _doubt(self, at: int, end: int, size: int) -> None:
        """Count a corrupt frame, unless what looked like one began inside another one."""
        self._unexplained += 1
        if at < end <= size and at >= self._doubted:
            self._corrupt += self._has_seen_frame
            self._doubted = end

    def _opened(self, buffer: bytes, at: int) -> list[Frame]:
        """Return what an intact frame says; nothing for frames of other types and versions."""
        self._dropped += self._unexplained if self._has_seen_frame else 0
        self._has_seen_frame, self._unexplained = True, 0
        kind = buffer[at + 2 : at + 4]
        if kind == _SAMPLE_KIND:
            return [SampleFrame._make(_SAMPLE.unpack_from(buffer, at + 4))]
        if kind == _HELLO_KIND:
            sequence, stamp, rate, micro_ohm, configuration = _HELLO.unpack_from(buffer, at + 4)
            return [Hello(sequence, stamp, rate, micro_ohm / 1e6, configuration)]
        if kind == _MARK_KIND:
            sequence, stamp, level = _MARK.unpack_from(buffer, at + 4)
            return [Mark(sequence, stamp, bool(level))]
        self._foreign += buffer[at + 2] >> 4 != _VERSION
        return []


def _end_of_frame(buffer: bytes, at: int) -> int:
    """Return where the frame that begins here ends, the place where it begins if it cannot be one."""
    if len(buffer) - at < _HEADER_SIZE:
        return len(buffer) + 1
    payload = buffer[at + 3]
    return at + _HEADER_SIZE + payload + _CHECKSUM_SIZE if payload <= _LONGEST_PAYLOAD else at


def _is_intact(buffer: bytes, at: int, end: int) -> bool:
    if not at < end <= len(buffer):
        return False
    checked = end - _CHECKSUM_SIZE
    return crc_hqx(buffer[at + len(_SYNC) : checked], _CRC_START) == buffer[checked] | buffer[checked + 1] << 8


_SEQUENCES = 1 << 16
_STAMPS = 1 << 32
#: A difference of stamps this large means that time went back: the device was restarted (docs/ina219-protocol.md).
_BACKWARDS = 1 << 31
#: The device's clock cannot run ahead of ours by this much, s; a restart after more than 36 min looks so.
_IMPLAUSIBLE_LEAD = 60.0


@dataclass(frozen=True, slots=True)
class StampedMark:
    """When the meter's mark changed.

    Attributes:
        seconds: since the first sample, by the device's clock.
        is_on: whether the measured window begins here; else it ends.
    """

    seconds: float
    is_on: bool


class SampleStream:
    """Takes the chunks of a serial line and holds the samples in columns, in the order of arrival.

    Args:
        has_arrivals: whether the chunks say when they arrived; False for what was recorded without a clock, where the
            lives of a device that was restarted are laid end to end.

    Attributes:
        shunt_raw: the shunt voltage registers.
        bus_raw: the bus voltage registers.
        device_seconds: the device's clock at each sample, unwrapped, s since the first sample of its life; where there
            are no arrivals, since the first of all.
        hello: what the device said of itself last, or None.
        configurations: every configuration of the sensor that was told of; 0 where it did not answer the device.
        marks: when the mark changed.
        lost: samples that the sequence numbers say are missing.
        duplicates: samples that came twice; only the first is held.
        restarts: how often the device started anew.
    """

    def __init__(self, *, has_arrivals: bool = True) -> None:
        self.shunt_raw = array("h")
        self.bus_raw = array("H")
        self.device_seconds = array("d")
        self.hello: Hello | None = None
        self.configurations: set[int] = set()
        self.marks: list[StampedMark] = []
        self.lost = 0
        self.duplicates = 0
        self.restarts = 0
        self._decoder = FrameDecoder()
        self._received = array("d")
        self._lives = [0]  # where in the columns each life of the device begins
        self._last: SampleFrame | None = None
        self._has_arrivals = has_arrivals
        self._implausible_lead = _IMPLAUSIBLE_LEAD if has_arrivals else math.inf

    def __len__(self) -> int:
        return len(self.shunt_raw)

    @property
    def counts(self) -> DecoderCounts:
        """What the line brought besides good frames."""
        return self._decoder.counts

    def take(self, chunks: Iterable[Chunk]) -> None:
        """Decode what arrived."""
        for chunk in chunks:
            self._add(self._decoder.feed(chunk.data), chunk.received_at)

    def finish(self) -> None:
        """Decode what is held back; call it once nothing more will arrive."""
        if len(self):
            self._add(self._decoder.finish(), self._received[-1])

    def times(self) -> array[float]:
        """Return when each sample was taken, s on the run's clock, never falling.

        The stamps are the device's; they are brought to the run's clock by comparing them with the arrivals.
        """
        times = array("d")
        for begin, end in zip(self._lives, [*self._lives[1:], len(self)], strict=True):
            if begin == end:
                continue
            stamps = self.device_seconds[begin:end]
            clock = fit_clock(stamps, self._received[begin:end])
            offset, rate = clock.offset, clock.rate
            earliest = times[-1] if times else float("-inf")
            times.extend(max(offset + rate * stamp, earliest) for stamp in stamps)
        return times

    def _add(self, frames: Iterable[Frame], received_at: float) -> None:
        for frame in frames:
            if isinstance(frame, SampleFrame):
                self._add_sample(frame, received_at)
            elif isinstance(frame, Hello):
                self.hello = frame
                self.configurations.add(frame.configuration)
            else:
                self._add_mark(frame)

    def _add_sample(self, sample: SampleFrame, received_at: float) -> None:
        seconds = self._seconds_of(sample, received_at)
        if seconds is None:
            self.duplicates += 1
            return
        self.device_seconds.append(seconds)
        self._received.append(received_at)
        self.shunt_raw.append(sample.shunt_raw)
        self.bus_raw.append(sample.bus_raw)
        self._last = sample

    def _add_mark(self, mark: Mark) -> None:
        seconds = 0.0
        if self._last is not None:
            step = (mark.microseconds - self._last.microseconds) % _STAMPS
            seconds = self.device_seconds[-1] + (step * 1e-6 if step < _BACKWARDS else 0.0)
        self.marks.append(StampedMark(seconds, mark.is_on))

    def _seconds_of(self, sample: SampleFrame, received_at: float) -> float | None:
        """Return the seconds of the device's clock, unwrapped, or None for a sample that is there already."""
        last = self._last
        if last is None:
            return 0.0
        step = (sample.microseconds - last.microseconds) % _STAMPS
        if step == 0 and sample.sequence == last.sequence:
            return None
        elapsed = step * 1e-6
        if step >= _BACKWARDS or elapsed > received_at - self._received[-1] + self._implausible_lead:
            self.restarts += 1
            self._lives.append(len(self))
            return 0.0 if self._has_arrivals else self.device_seconds[-1]
        self.lost += (sample.sequence - last.sequence - 1) % _SEQUENCES
        return self.device_seconds[-1] + elapsed
