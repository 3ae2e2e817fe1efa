"""The meter on a serial line: one run's samples, from the opening of the line to the end of the window."""

from __future__ import annotations

import threading
from array import array
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.events.early_end import undivided
from robot_runner.core.events.window import Window
from robot_runner.measuring.serial_line import Chunk
from robot_runner.meters.ina219.doubts import silence
from robot_runner.meters.ina219.frames import FIRST_SENSOR, FrameDecoder, SampleFrame
from robot_runner.meters.ina219.registers import DEFAULT_SHUNT, Calibration, Evaluation, evaluate_registers
from robot_runner.meters.ina219.sample_stream import SampleStream

if TYPE_CHECKING:
    from robot_runner.measuring.serial_line import SerialLine


class Meter(Protocol):
    """The sensor during one run.

    Attributes:
        has_samples_at_once: whether the samples are complete when the measurement has ended; else they come later.
    """

    has_samples_at_once: bool

    def begin(self) -> None:
        """Start taking samples.

        Raises:
            LinkError: the sensor cannot be reached.
        """

    def end(self) -> None:
        """Stop taking samples; a second call does nothing.

        Raises:
            LinkError: the connection to the sensor was lost; the samples until then are kept.
        """

    def evaluate(self, window: Window | None, part: Window | None = None) -> Evaluation:
        """Return the evaluated samples, after `end`.

        Args:
            window: the run's measured window on its clock; None for the whole time of sampling.
            part: a phase within it to evaluate; None for the whole window.

        Raises:
            LinkError: there are no samples.
        """


@runtime_checkable
class PromptMeter(Protocol):
    """A meter that shows its last sample during the measurement, for live displays."""

    def latest_power(self) -> float | None:
        """Return the power of the last sample, W, from any thread; None where there is none yet.

        Raises:
            LinkError: the connection to the sensor was lost.
        """


#: How long to wait for the first sample, s: a board that was reset by opening its port needs up to two for its boot
#: loader and one for its card (docs/ina219-protocol.md).
_PATIENCE = 4.0
_POLL = 0.01
#: The usual time until the sample after the end arrives, s: a period, its lag, and the latency of a USB bridge (16 ms).
_AFTERMATH = 0.03
#: The longest wait for it, s, as a busy machine delivers bytes late.
_LONGEST_AFTERMATH = 0.5
#: How much is decoded for the current power: a bridge delivers a few samples at a time, of 16 bytes each.
_LATEST_BYTES = 256
#: How many chunks are decoded at a time: those of ten hours take gigabytes as objects.
_AT_ONCE = 1 << 14


class SharedLine:
    """One line for the profilers of several sensors: it keeps all bytes for each of them, without an object for each.

    Args:
        line: to the device; the caller closes it.
    """

    def __init__(self, line: SerialLine) -> None:
        self._line = line
        self._data = bytearray()
        self._arrivals = array("d")
        self._ends = array("Q")  # of each chunk, in the data
        self._lock = threading.Lock()  # live displays read in their own thread

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated device is at the other end."""
        return self._line.is_simulated

    def since(self, count: int) -> list[Chunk]:
        """Return the next chunks after the first `count`, `_AT_ONCE` at most, and fewer only where these are all.

        Raises:
            LinkError: the line was lost, and there are none.
        """
        with self._lock:
            try:
                with undivided:  # what was taken from the line is kept, also where the mission ends now
                    for chunk in self._line.drain():
                        self._data += chunk.data
                        self._arrivals.append(chunk.received_at)
                        self._ends.append(len(self._data))
            except LinkError:
                if count == len(self._ends):
                    raise
            arrivals, ends = self._arrivals[count : count + _AT_ONCE], self._ends[count : count + _AT_ONCE]
            begins = [self._ends[count - 1] if count else 0, *ends]
            pieces = (bytes(self._data[begin:end]) for begin, end in zip(begins, ends, strict=False))
            return list(map(Chunk, arrivals, pieces))

    def latest(self) -> bytes:
        """Return the last bytes that arrived, enough for a few samples; a `LinkError` as of `since`."""
        self.since(len(self._ends))
        return bytes(self._data[-_LATEST_BYTES:])

    def close(self) -> None:
        """Do nothing."""


class LineMeter:
    """Takes samples from a line that keeps the arriving bytes, so that nothing has to be read during the mission.

    Args:
        line: on which the samples arrive.
        clock: the run's.
        address: of the sensor on the device's bus.
        shunt_ohm: resistance of the shunt, ohm; None takes the device's.
        rate_hz: nominal rate, Hz; None takes the device's.
    """

    has_samples_at_once = True

    def __init__(
        self,
        line: SharedLine,
        clock: Clock,
        *,
        address: int = FIRST_SENSOR,
        shunt_ohm: float | None = None,
        rate_hz: float | None = None,
    ) -> None:
        self._line = line
        self._clock = clock
        self._shunt_ohm = shunt_ohm
        self._rate_hz = rate_hz
        self._stream = SampleStream(address=address)
        self._taken = 0  # chunks of the line
        self._start = clock.now()
        self._opened = clock.now()
        self._sampled: Window | None = None
        self._whole: Evaluation | None = None  # over the run's window

    def begin(self) -> None:
        """Wait for a first sample, at most for a few seconds; a `LinkError` says that the line was lost."""
        deadline = self._clock.now() + _PATIENCE
        self._take()
        while not len(self._stream) and self._clock.now() < deadline:
            self._clock.sleep(_POLL)
            self._take()
        self._start = self._clock.now()

    def latest_power(self) -> float | None:
        """Return the power of the last sample that arrived, W, for live displays; None where none is complete.

        This sample is decoded separately, and the call may come from another thread. A `LinkError` as of `begin`.
        """
        frames = FrameDecoder().feed(self._line.latest())
        for each in reversed(frames):
            if isinstance(each, SampleFrame) and self._stream.is_ours(each.address):
                said = self._stream.sensing or self._stream.hello
                calibration = Calibration(self._shunt_ohm or (said.shunt_ohm if said else 0.0) or DEFAULT_SHUNT)
                return calibration.current(each.shunt_raw) * calibration.voltage(each.bus_raw)
        return None

    def end(self) -> None:
        """Take the bytes that arrived, then raise the `LinkError` of a lost line; a second call does nothing."""
        if self._sampled is not None:
            return
        self._sampled = Window(self._start, self._clock.now())
        try:
            self._take_the_rest(self._sampled.end)
        finally:
            self._stream.finish()

    def _take(self) -> None:
        is_all = False
        while not is_all:
            chunks = self._line.since(self._taken)
            self._taken += len(chunks)
            self._stream.take(chunks)
            is_all = len(chunks) < _AT_ONCE

    def _take_the_rest(self, end: float) -> None:
        deadline: float | None = None
        while deadline is None or self._clock.now() < deadline:
            self._clock.sleep(_AFTERMATH)
            self._take()
            times = self._stream.times()
            if times and times[-1] >= end:
                return
            # Only now: decoding those of a mission of hours has taken a minute, in which others came.
            deadline = deadline or self._clock.now() + _LONGEST_AFTERMATH

    def evaluate(self, window: Window | None, part: Window | None = None) -> Evaluation:
        """Return the evaluated samples of a window; None stands for the time from `begin` to `end`, or until now."""
        if part is None or self._whole is None:
            self._whole = self._evaluate(window)
        return self._whole if part is None else self._whole.over(part)

    def _evaluate(self, window: Window | None) -> Evaluation:
        sampled = self._sampled or Window(self._start, self._clock.now())
        evaluation = evaluate_registers(
            self._stream,
            self._stream.times(),
            window or sampled,
            shunt_ohm=self._shunt_ohm,
            rate_hz=self._rate_hz,
            is_simulated=self._line.is_simulated,
        )
        silent = silence(self._stream, sampled.end - self._opened)
        doubts = (silent, *evaluation.doubts) if silent else evaluation.doubts
        return replace(evaluation, doubts=doubts, sampled=sampled)
