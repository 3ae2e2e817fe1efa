"""The stream of samples in columns: lost and repeated samples, and the time of each one."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, groupby, pairwise
from operator import le, sub
from typing import TYPE_CHECKING

from robot_runner.measuring.device_clock import fit_bent_clock
from robot_runner.meters.ina219.frames import (
    FIRST_SENSOR,
    SAMPLE_BYTES,
    DecoderCounts,
    Frame,
    FrameDecoder,
    Hello,
    Mark,
    SampleColumns,
    SampleFrame,
    Sensing,
)

if TYPE_CHECKING:
    from robot_runner.core.events.window import Window
    from robot_runner.measuring.serial_line import Chunk

_SEQUENCES = 1 << 16
#: The differences between the numbers of consecutive samples: numbers wrap.
_ONE_FURTHER = {1, 1 - _SEQUENCES}
_STAMPS = 1 << 32
#: A difference of stamps this large is a step back, by a restart of the device (docs/ina219-protocol.md).
_BACKWARDS = 1 << 31
#: The device's clock cannot run ahead of ours by this much, s; a restart after more than 36 min looks like that.
_IMPLAUSIBLE_LEAD = 60.0
#: The largest skew of the device's clock that is corrected by the arrivals, in parts of one: these are always right.
_LARGEST_SKEW = 0.5
#: Decimals of a time in s: stamps are whole microseconds, so that one moment has one time, whenever the device was
#: reset.
_DIGITS = 6


class Trouble(Enum):
    """The faults of a stream."""

    LOST = "samples that the sequence numbers say are missing"
    DUPLICATE = "samples that came twice"
    RESTART = "the device started anew"
    CORRUPT = "frames whose checksum was wrong"
    DROPPED = "bytes that belonged to no good frame"
    FOREIGN = "frames of another version"
    STANDING_STAMP = "samples with the time stamp of the one before"
    STANDING_NUMBER = "samples with the number of the one before"


@dataclass(frozen=True, slots=True)
class StampedMark:
    """A change of the meter's mark.

    Attributes:
        seconds: since the first sample, by the device's clock.
        is_on: whether the measured window begins here; else it ends.
    """

    seconds: float
    is_on: bool


class SampleStream:
    """Decodes the chunks of a serial line to columns with the samples of one sensor, in the order of arrival.

    A device has a new life after each restart.

    Args:
        has_arrivals: whether the chunks have times of arrival; False for a recording without a clock, in which the
            lives of the device follow one another without gaps.
        address: of the sensor on the device's bus; `FIRST_SENSOR` for the first one, whatever its address is.

    Attributes:
        shunt_raw: the shunt voltage registers.
        bus_raw: the bus voltage registers.
        device_seconds: the device's clock at each sample, unwrapped, s since the first sample of its life; without
            arrivals, since the first sample of all.
        hello: the device's last hello, or None.
        sensing: the last description of this sensor, or None: the first firmware sends none.
        configurations: all configurations of the sensor that were sent; 0 if it did not answer the device.
        shunts: all resistances of its shunt that were sent, ohm.
        marks: the changes of the mark.
        bytes: how many bytes came.
        bytes_since_frame: how many of them came after the last chunk that completed a frame.
        drift: the error of the device's clock, in parts of one, positive if it is slow; known after `times`.
    """

    def __init__(self, *, has_arrivals: bool = True, address: int = FIRST_SENSOR) -> None:
        self.address = address
        self.shunt_raw = array("h")
        self.bus_raw = array("H")
        self.device_seconds = array("d")
        self.hello: Hello | None = None
        self.sensing: Sensing | None = None
        self.configurations: set[int] = set()
        self.shunts: set[float] = set()
        self.marks: list[StampedMark] = []
        self.bytes = 0
        self.bytes_since_frame = 0
        self.drift = 0.0
        self._first_address = FIRST_SENSOR  # the first sensor's, once the device has sent it
        self._is_behind_hello = False
        self._troubles: list[tuple[int, Trouble, int]] = []  # the next sample, the trouble, and how often
        self._decoder = FrameDecoder()
        self._counted = self._decoder.counts  # the counts that are among the troubles already
        self._received = array("d")
        self._lives = [0]  # where each life of the device begins in the columns
        self._last: SampleFrame | None = None
        self._has_arrivals = has_arrivals
        self._implausible_lead = _IMPLAUSIBLE_LEAD if has_arrivals else math.inf
        self._times = array("d")
        self._timed = (0, 0.0)  # the number of samples whose times are known, and their lag

    def __len__(self) -> int:
        return len(self.shunt_raw)

    @property
    def counts(self) -> DecoderCounts:
        """The decoder's counts."""
        return self._decoder.counts

    @property
    def lag(self) -> float:
        """From the middle of the time that a sample averages to its stamp, s; 0 if the device does not send it."""
        return self.sensing.lag_s if self.sensing is not None else 0.0

    def troubles(self, window: Window | None = None, times: Sequence[float] = ()) -> Mapping[Trouble, int]:
        """Return how often each trouble happened, in a window of `times` or altogether."""
        low, high = 0, len(self)
        if window is not None:
            low, high = bisect_left(times, window.start), bisect_right(times, window.end)
        found: Counter[Trouble] = Counter()
        for before, trouble, count in self._troubles:
            if low <= before <= high:
                found[trouble] += count
        return found

    def take(self, chunks: Iterable[Chunk]) -> None:
        """Decode chunks."""
        for size, alike in groupby(chunks, lambda chunk: len(chunk.data)):
            some = list(alike)
            arrivals, pieces = zip(*some, strict=True)
            samples = self._decoder.take_samples(pieces) if size == SAMPLE_BYTES else None
            if samples is not None:
                self._take_samples(samples, arrivals)
                continue
            for chunk in some:
                self._take_one(chunk)

    def _take_samples(self, samples: SampleColumns, arrivals: Sequence[float]) -> None:
        """Take samples that came in a chunk each."""
        self._is_behind_hello = False
        self.bytes += len(arrivals) * SAMPLE_BYTES
        if self.is_ours(FIRST_SENSOR) and not self._add_in_order(samples, arrivals):
            for sample, received_at in zip(map(SampleFrame, *samples), arrivals, strict=True):
                self._add_sample(sample, received_at)

    def _take_one(self, chunk: Chunk) -> None:
        data, frames_before = chunk.data, self._decoder.frames
        self.bytes += len(data)
        self._add(self._decoder.feed(data), chunk.received_at)
        if self._decoder.frames > frames_before:
            self.bytes_since_frame = 0
        else:
            self.bytes_since_frame += len(data) if self._has_arrivals else len(data.strip(b"\0"))
        if not self._decoder.is_sound:
            self._note_faults()

    def finish(self) -> None:
        """Decode the bytes that are held back; call it once nothing more will arrive."""
        frames = self._decoder.finish()
        if frames:
            self.bytes_since_frame = 0
        if len(self):
            self._add(frames, self._received[-1])
        self._note_faults()

    def times(self) -> array[float]:
        """Return the middle of the time that each sample averages, s on the run's clock, never decreasing.

        They are the device's stamps, converted to the run's clock by comparing them with the arrivals.
        """
        if self._timed != (len(self), self.lag):
            self._times = self._times_of_all()
            self._timed = (len(self), self.lag)
        return self._times

    def _times_of_all(self) -> array[float]:
        times = array("d")
        self.drift = 0.0
        for begin, end in zip(self._lives, [*self._lives[1:], len(self)], strict=True):
            if begin == end:
                continue
            stamps = self.device_seconds[begin:end]
            clocks = fit_bent_clock(stamps, self._received[begin:end], largest_skew=_LARGEST_SKEW)
            for (first, clock), (last, _) in pairwise([*clocks, (len(stamps), clocks[-1][1])]):
                self.drift = max(self.drift, clock.drift, key=abs)
                moments = clock.all_to_run(stamps[first:last])
                if lag := self.lag:
                    moments = [round(moment - lag, _DIGITS) for moment in moments]
                if times and moments and moments[0] < times[-1]:  # the clocks of two lives overlap
                    moments = [max(moment, times[-1]) for moment in moments]
                times.extend(moments)
        return times

    def _add(self, frames: Iterable[Frame], received_at: float) -> None:
        for frame in frames:
            if isinstance(frame, SampleFrame):
                if self.is_ours(frame.address):
                    self._add_sample(frame, received_at)
            elif isinstance(frame, Hello):
                self.hello = frame
                if self.address == FIRST_SENSOR:
                    self.configurations.add(frame.configuration)
                    self.shunts.add(frame.shunt_ohm)
            elif isinstance(frame, Sensing):
                self._take_sensing(frame)
            else:
                self._add_mark(frame)
            self._is_behind_hello = isinstance(frame, Hello)

    def is_ours(self, address: int) -> bool:
        """Whether samples with this address are of this sensor; those of the device's first sensor have no address."""
        return address == self.address or (address == FIRST_SENSOR and self.address == self._first_address)

    def _take_sensing(self, sensing: Sensing) -> None:
        """Take the description of this sensor; that of the first sensor comes right after the hello."""
        if self._is_behind_hello:
            self._first_address = sensing.address
        if sensing.address == self.address or (self._is_behind_hello and self.address == FIRST_SENSOR):
            self.sensing = sensing
            self.configurations.add(sensing.configuration)
            self.shunts.add(sensing.shunt_ohm)

    def _note(self, trouble: Trouble, count: int = 1) -> None:
        if count:
            self._troubles.append((len(self), trouble, count))

    def _note_faults(self) -> None:
        before, now = self._counted, self._decoder.counts
        self._note(Trouble.CORRUPT, now.corrupt - before.corrupt)
        if self._has_arrivals:  # a recording has zeros after the end of each mark, and after its last frame
            self._note(Trouble.DROPPED, now.dropped_bytes - before.dropped_bytes)
        self._note(Trouble.FOREIGN, now.foreign_versions - before.foreign_versions)
        self._counted = now

    def _add_sample(self, sample: SampleFrame, received_at: float) -> None:
        seconds = self._seconds_of(sample, received_at)
        if seconds is None:
            self._note(Trouble.DUPLICATE)
            return
        self.device_seconds.append(seconds)
        self._received.append(received_at)
        self.shunt_raw.append(sample.shunt_raw)
        self.bus_raw.append(sample.bus_raw)
        self._last = sample

    def _add_in_order(self, samples: SampleColumns, arrivals: Sequence[float]) -> bool:
        """Add samples as `_add_sample` would, but by columns; return False, and add none, where that is not possible.

        It is possible in the usual case, and takes a quarter of the time for the 19,000 samples of a run. It is not if
        there is a trouble to note, or if the stamps wrap, once in 71 min.
        """
        last = self._last
        if last is None or not all(map(le, arrivals, arrivals[1:])) or arrivals[0] < self._received[-1]:
            return False
        numbers, stamps = (last.sequence, *samples.sequences), (last.microseconds, *samples.microseconds)
        steps = list(map(sub, stamps[1:], stamps))
        longest = max(steps)
        has_steps = min(steps) > 0 and longest < _BACKWARDS and longest * 1e-6 <= self._implausible_lead
        if not has_steps or not _ONE_FURTHER.issuperset(map(sub, numbers[1:], numbers)):
            return False
        elapsed = [step * 1e-6 for step in steps]
        elapsed[0] += self.device_seconds[-1]
        self.device_seconds.extend(accumulate(elapsed))
        self._received.extend(arrivals)
        self.shunt_raw.extend(samples.shunt_raw)
        self.bus_raw.extend(samples.bus_raw)
        self._last = SampleFrame(*(column[-1] for column in samples))
        return True

    def _add_mark(self, mark: Mark) -> None:
        seconds = 0.0
        if self._last is not None:
            step = (mark.microseconds - self._last.microseconds) % _STAMPS
            seconds = self.device_seconds[-1] + (step * 1e-6 if step < _BACKWARDS else 0.0)
        self.marks.append(StampedMark(seconds, mark.is_on))

    def _seconds_of(self, sample: SampleFrame, received_at: float) -> float | None:
        """Return the seconds of the device's clock, unwrapped, or None for a sample that is a repetition."""
        last = self._last
        if last is None:
            return 0.0
        step = (sample.microseconds - last.microseconds) % _STAMPS
        if step == 0 and sample.sequence == last.sequence:
            return None
        elapsed = step * 1e-6
        if step >= _BACKWARDS or elapsed > received_at - self._received[-1] + self._implausible_lead:
            self._note(Trouble.RESTART)
            self._lives.append(len(self))
            return 0.0 if self._has_arrivals else self.device_seconds[-1]
        if sample.sequence == last.sequence:
            self._note(Trouble.STANDING_NUMBER)
        elif missing := (sample.sequence - last.sequence - 1) % _SEQUENCES:
            self._note(Trouble.LOST, missing)
        if step == 0:
            self._note(Trouble.STANDING_STAMP)
        return self.device_seconds[-1] + elapsed
