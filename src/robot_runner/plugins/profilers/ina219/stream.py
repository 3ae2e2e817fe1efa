"""The stream of samples in columns: what was lost, what came twice, and when each sample was taken."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.plugins.profilers.ina219.frames import FrameDecoder, Hello, Mark, SampleFrame
from robot_runner.plugins.sampling.device_clock import fit_clock

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.links.serial import Chunk
    from robot_runner.plugins.profilers.ina219.frames import DecoderCounts, Frame

__all__ = ["SampleStream", "StampedMark"]

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
