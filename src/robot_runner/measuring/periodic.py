"""Readings at a fixed rate: of a meter, by absolute deadlines on the clock, or of a computer's files."""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import Clock
from robot_runner.core.events.early_end import undivided
from robot_runner.core.events.resources import Closable
from robot_runner.core.events.window import Window
from robot_runner.measuring.host import FileHost, FileSample, FileSampler, SamplingReport, TellingSampler, report_of
from robot_runner.measuring.quality import SampleQuality, quality_of
from robot_runner.measuring.series import Series, within

R = TypeVar("R")

#: How long a reading may delay the end of the measurement, s.
_PATIENCE = 5.0
#: How long the first reading may delay the measurement's beginning, or one at an edge of the mission that edge, s.
_FIRST_PATIENCE = 1.0


@runtime_checkable
class TickingClock(Protocol):
    """A clock whose time passes only during a sleep on it, such as that of a simulated robot."""

    def call_every(self, period: float, callback: Callable[[], None]) -> Closable:
        """Call `callback` every `period` seconds of the clock, until the result is closed."""


@dataclass(frozen=True, slots=True)
class Sampling(Generic[R]):
    """What a sampler read between its start and its stop.

    Attributes:
        times: when each reading was taken, s on the run's clock; the middle of the time that reading took.
        readings: one for each time.
        window: the one that the readings are evaluated over; at first from the start to the stop of the sampler, which
            takes a last reading at the stop, whenever the one before it was.
        rate: the nominal rate, Hz.
        failed_at: when readings raised an exception instead, s on the run's clock.
        first_failure: the text of the first of these exceptions.
        cpu_seconds: CPU time that reading took on the machine that is read, s; None if not known.
        sampled_seconds: how long the sampler worked, s.

    Example:
        >>> from robot_runner.plugins import Window
        >>> Sampling([0.0, 1.0], ["7.5", "7.6"], Window(0.0, 1.0), 1.0).series().values
        [7.5, 7.6]
    """

    times: Sequence[float]
    readings: Sequence[R]
    window: Window
    rate: float
    failed_at: Sequence[float] = ()
    first_failure: str = ""
    cpu_seconds: float | None = 0.0
    sampled_seconds: float = 0.0

    @property
    def failures(self) -> int:
        """How many readings of the window raised an exception instead."""
        return sum(self.window.start <= time <= self.window.end for time in self.failed_at)

    def over(self, window: Window) -> Sampling[R]:
        """Return the same readings, to be evaluated over another window; those outside serve for its edges."""
        return replace(self, window=window)

    def within(self) -> Sampling[R]:
        """Return the readings that were taken in the window, for measures that count readings."""
        seen = within(self.times, self.window)
        return replace(self, times=self.times[seen], readings=self.readings[seen])

    def series(self, value: Callable[[R], float] | None = None) -> Series:
        """Return one quantity of the readings; `value` picks it, the reading itself if left out."""
        pick: Callable[[Any], float] = float if value is None else value
        return Series(self.times, [pick(reading) for reading in self.readings])

    def quality(self, **counts: Any) -> SampleQuality:
        """Return how good the samples are; `counts` as `quality_of` takes them."""
        return quality_of(
            self.times,
            self.window,
            self.rate,
            failed=self.failures,
            first_failure=self.first_failure,
            cpu_seconds=self._own_seconds(),
            **counts,
        )

    def _own_seconds(self) -> float | None:
        """Return the window's share of the CPU time that sampling took in all."""
        if self.cpu_seconds is None:
            return None
        return self.cpu_seconds * self.window.duration / self.sampled_seconds if self.sampled_seconds else 0.0


class PeriodicSampler(Generic[R]):
    """Calls `read` at fixed moments of the run's clock, from `start` until `stop`.

    On the machine's own clock it does so in a thread of the run's process: the moments are start + n / rate, and missed
    ones are skipped, so that the samples neither drift nor come in bursts. On a clock that moves only during a sleep on
    it (a simulated robot's, a test's) `read` is called during that sleep, in the thread that sleeps.

    A reading that raises an exception, or has a number that is NaN or infinite, is counted and left out; sampling goes
    on. So a meter that fails costs samples, which shows in the quality, but not the mission.

    Args:
        read: returns one reading; it must not sleep on the run's clock.
        rate: readings a second, Hz.
        clock: the run's (`context.clock`).

    Raises:
        PluginError: the rate is not positive.

    Example:
        >>> from robot_runner.testing import FakeClock
        >>> clock = FakeClock()
        >>> sampler = PeriodicSampler(lambda: 7.5, rate=10.0, clock=clock)
        >>> sampler.start()
        >>> clock.sleep(1.0)
        >>> len(sampler.stop().readings)
        11
    """

    def __init__(self, read: Callable[[], R], *, rate: float, clock: Clock) -> None:
        if not (math.isfinite(rate) and rate > 0):
            raise PluginError(f"the sample rate is {rate!r} Hz", where="sampling", fix="Give a rate above 0.")
        self._read = read
        #: Called with the time of each reading and the reading, in the thread that reads: for live displays.
        self.on_reading: Callable[[float, R], None] = lambda _time, _reading: None
        self._rate = rate
        self._clock = clock
        self._ticker: Closable | None = None
        self._thread: threading.Thread | None = None
        self._is_asked_to_stop = False
        self._wanted = threading.Event()
        self._has_taken = threading.Event()
        self._times = array("d")
        self._readings: list[R] = []
        self._failed_at = array("d")
        self._first_failure = ""
        self._cpu_seconds = 0.0
        self._begun: float | None = None
        self._sampling: Sampling[R] | None = None

    def start(self) -> None:
        """Take the first reading, and go on at the rate.

        Raises:
            PluginError: it was started before.
        """
        if self._begun is not None:
            raise PluginError("a sampler was started twice", where="sampling", fix="Make a new one for each run.")
        self._begun = self._clock.now()
        if isinstance(self._clock, TickingClock):
            self._take()
            self._ticker = self._clock.call_every(1.0 / self._rate, self._take)
        else:
            self._thread = threading.Thread(target=self._keep_taking, name="sampler", daemon=True)
            self._thread.start()
            # Wait for the first reading: a thread may start so late that a short mission, of which a counter would
            # have seen most, is over.
            self._has_taken.wait(_FIRST_PATIENCE)

    def take_now(self) -> None:
        """Take one more reading at once, out of turn; for one that hangs wait only a moment."""
        if self._thread is None:
            if not self._times or self._times[-1] < self._clock.now():
                self._take()
            return
        self._has_taken.clear()
        self._wanted.set()
        self._has_taken.wait(_FIRST_PATIENCE)

    def stop(self) -> Sampling[R]:
        """Take a last reading and return all of them; a second call returns the same.

        Raises:
            PluginError: it was never started.
        """
        if self._sampling is None:
            if self._begun is None:
                raise PluginError("a sampler was stopped that was never started", where="sampling", fix="Start it.")
            window = Window(self._begun, self._clock.now())
            self._end(window.end)
            count = len(self._readings)
            self._sampling = Sampling(
                self._times[:count],
                self._readings[:count],
                window,
                self._rate,
                failed_at=self._failed_at,
                first_failure=self._first_failure,
                cpu_seconds=self._cpu_seconds,
                sampled_seconds=window.duration,
            )
        return self._sampling

    def _end(self, at: float) -> None:
        if self._ticker is not None:
            self._ticker.close()
        self._is_asked_to_stop = True
        self._wanted.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE)
            if self._thread.is_alive():
                self._note_failure(f"a reading did not come back within {_PATIENCE:g} s", at)
                return
        if not self._times or self._times[-1] < self._clock.now():
            self._take()

    def _keep_taking(self) -> None:
        period = 1.0 / self._rate
        begun, number = time.monotonic(), 0
        while True:
            is_out_of_turn = self._wanted.wait(max(0.0, begun + number * period - time.monotonic()))
            if self._is_asked_to_stop:
                return
            self._wanted.clear()
            self._take()
            self._has_taken.set()
            if not is_out_of_turn:
                number = max(number + 1, math.floor((time.monotonic() - begun) / period))

    def _take(self) -> None:
        cpu_begun, begun = time.thread_time(), self._clock.now()
        try:
            reading = _checked(self._read())
        except Exception as error:  # noqa: BLE001 - whatever a meter raises, the mission continues, and the quality reports it
            self._note_failure(f"{type(error).__name__}: {error}", begun)
        else:
            with undivided:  # both or neither, where the mission ends now
                self._times.append((begun + self._clock.now()) / 2)
                self._readings.append(reading)
            self.on_reading(self._times[-1], reading)
        self._cpu_seconds += time.thread_time() - cpu_begun

    def _note_failure(self, what: str, at: float) -> None:
        self._failed_at.append(at)
        self._first_failure = self._first_failure or what


def _checked(reading: R) -> R:
    """Return a reading; refuse numbers that are not finite: libraries of sensors return NaN where a reading failed."""
    numbers = reading if isinstance(reading, tuple | list) else (reading,)
    if any(isinstance(each, Real) and not math.isfinite(each) for each in numbers):
        raise ValueError(f"the meter said {reading}")
    return reading


class HostSampler(Generic[R]):
    """Has a computer read the first lines of files from `start` until `stop`, which fetches them.

    Args:
        host: the computer.
        paths: the files.
        understood: converts the lines of the files, None for one that could not be read, to a reading; after a
            ValueError that reading is left out, as in a `PeriodicSampler`.
        rate: readings a second, Hz.
        clock: the one that the computer's samples are stamped by.
    """

    def __init__(
        self,
        host: FileHost,
        paths: Sequence[str],
        understood: Callable[[Sequence[str | None]], R],
        *,
        rate: float,
        clock: Clock,
    ) -> None:
        self._host = host
        self._paths = paths
        self._understood = understood
        self._rate = rate
        self._clock = clock
        self._begun = clock.now()
        self._files: FileSampler | None = None
        self._latest: Callable[[], FileSample] | None = None
        self._sampling: Sampling[R] | None = None

    def start(self) -> None:
        """Begin to sample.

        Raises:
            LinkError: the computer cannot be reached.
        """
        self._files = self._host.sample_files(self._rate, self._paths)
        if isinstance(self._files, TellingSampler):
            self._files.tell(self._take_latest)
        self._begun = self._clock.now()

    def take_now(self) -> None:
        """Do nothing: the computer reads on its own, and the mission's edges are between two of its readings."""

    def latest(self) -> R | None:
        """Return the last reading; None where there is none yet: most computers send them at the end."""
        with suppress(ValueError):
            return None if self._latest is None else self._understood(self._latest().lines)
        return None

    def stop(self) -> Sampling[R]:
        """Fetch the readings; a second call returns the same."""
        if self._sampling is None:
            window = Window(self._begun, self._clock.now())
            samples = self._files.stop() if self._files is not None else ()
            self._sampling = self._sampled(samples, window)
        return self._sampling

    def report(self) -> SamplingReport:
        """Return the computer's report of its sampling; call it after `stop`."""
        return report_of(self._files, self._rate)

    def _take_latest(self, sample: Callable[[], FileSample]) -> None:
        self._latest = sample

    def _sampled(self, samples: Sequence[FileSample], window: Window) -> Sampling[R]:
        times, readings, failed_at, first_failure = [], [], [], ""
        for sample in samples:
            try:
                readings.append(self._understood(sample.lines))
            except ValueError as error:
                failed_at.append(sample.time)
                first_failure = first_failure or str(error)
            else:
                times.append(sample.time)
        report = self.report()
        return Sampling(
            times,
            readings,
            window,
            report.rate,
            failed_at=failed_at,
            first_failure=first_failure,
            cpu_seconds=report.cpu_seconds,
            sampled_seconds=window.duration,
        )
