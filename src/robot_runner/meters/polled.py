"""The common parts of profilers that read a meter of this machine periodically."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Origin
from robot_runner.core.events.window import Window
from robot_runner.core.plugin import Profiler
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.live_samples import LiveSamples
from robot_runner.measuring.measured_machine import clock_details, machine_clock
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.periodic import PeriodicSampler, Sampling
from robot_runner.measuring.quality import Column, report_quality, write_samples
from robot_runner.measuring.series import Series

R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Meter(Protocol[R_co]):
    """Something that can be read until it is closed; a meter that needs no closing may derive from this class."""

    def read(self) -> R_co:
        """Return one reading."""

    def close(self) -> None:
        """Release all resources; here, there are none."""
        return


class Sampler(Protocol[R]):
    """Takes readings from its start to its stop, as a `PeriodicSampler` does."""

    def start(self) -> None:
        """Begin to take readings."""

    def take_now(self) -> None:
        """Take one more reading at an edge of the mission, if possible."""

    def stop(self) -> Sampling[R]:
        """Stop, and return the readings; a second call returns the same."""


class PolledProfiler(Profiler, Generic[R]):
    """Reads a meter of this machine at a fixed rate from the start of the measurement to its end.

    A subclass opens the meter and computes measures from its readings. A reading that fails costs a sample; a meter
    that cannot be opened fails the run, before the robot moves. `docs/polled-meter.md` shows how to write a subclass.

    Args:
        name: distinguishes several instances; None for the class's name.
        rate_hz: readings a second, Hz.

    Raises:
        PluginError: the rate is not positive.

    Example:
        >>> class Fan:
        ...     def read(self):
        ...         return 1200.0
        ...     def close(self):
        ...         pass
        >>> class FanSpeed(PolledProfiler[float]):
        ...     def open(self, context):
        ...         return Fan()
        >>> FanSpeed(rate_hz=5.0).rate_hz
        5.0
    """

    origin: Origin = Origin.MEASURED

    def __init__(self, *, name: str | None = None, rate_hz: float = 10.0) -> None:
        super().__init__(name=name)
        check_numbers(self.name, rate_hz=rate_hz)
        self.rate_hz = rate_hz
        self._meter: Meter[R] | None = None
        self._sampler: Sampler[R] | None = None
        self._sampling: Sampling[R] | None = None
        self._measured: Sampling[R] | None = None  # the same readings, over the mission
        self._is_written = False
        self._live: LiveSamples | None = None

    def open(self, context: RobotRunnerContext) -> Meter[R]:
        """Return the meter.

        Raises:
            PluginError: it cannot be read at all.
        """
        raise NotImplementedError

    def columns(self, sampling: Sampling[R]) -> Sequence[Column]:
        """Return the columns of `samples.csv`, except the time."""
        raise NotImplementedError

    def values(self, sampling: Sampling[R]) -> Mapping[str, float | None]:
        """Return the value of each measure over `sampling.window`; omitted measures are missing.

        There are also readings before and after the window: `cut` interpolates between them at its edges.
        """
        raise NotImplementedError

    def doubts(self, sampling: Sampling[R]) -> Iterable[str]:
        """Yield doubts about the readings, besides the quality of the samples."""
        del sampling
        return ()

    def renewals(self, sampling: Sampling[R]) -> Sequence[float]:
        """Return when values were new, s: at each reading, unless a meter is read more often than it renews them."""
        return sampling.times

    def checked(self, reading: R) -> R:
        """Return a reading as it was taken.

        Raises:
            ValueError: it is none; it counts as failed.
        """
        if reading is None:
            raise ValueError("the meter returned nothing")
        return reading

    def details(self) -> Mapping[str, Any]:
        """Return plain facts about the meter, for `quality.json`."""
        return {}

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the readings of the run before."""
        del context
        self._sampler = self._sampling = self._measured = None
        self._is_written = False

    def sampler(self, context: RobotRunnerContext) -> Sampler[R]:
        """Return a sampler, which calls the opened meter's `read` at the rate, in a thread of the run."""
        meter = self._meter = self.open(context)
        sampler = PeriodicSampler(lambda: self.checked(meter.read()), rate=self.rate_hz, clock=machine_clock(context))
        live = self._live = LiveSamples(context.raw_data_folder / "samples.csv")
        sampler.on_reading = lambda time, reading: live.show(lambda: self._columns_of(time, reading))
        return sampler

    def _columns_of(self, time: float, reading: R) -> Sequence[Column]:
        one = Sampling([time], [reading], Window(time, time), self.rate_hz)
        return [Column("time_s", [time]), *self.columns(one)]

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Open the meter and begin to read it."""
        self._sampler = self.sampler(context)
        self._sampler.start()
        context.times.at_edges(self._sampler.take_now)

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Take the last reading and close the meter."""
        if self._sampler is not None and self._sampling is None:
            self._sampling = self._sampler.stop()
        meter, self._meter = self._meter, None
        if meter is not None:
            try:
                meter.close()
            except Exception as error:  # noqa: BLE001 - whatever a meter raises, its samples are there
                context.warn(f"the meter could not be closed: {type(error).__name__}: {error}")

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Write the raw samples: later than `stop_measurement`, so that other profilers need not wait for the disk."""
        if self._sampling is None or self._is_written:
            return
        time = Column("time_s", self._sampling.times)
        write_samples(context.raw_data_folder / "samples.csv", [time, *self.columns(self._sampling)])
        self._is_written = True
        if self._live is not None:
            self._live.close()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no value where too little was read."""
        clock = machine_clock(context)
        window, sampling = context.times.window(clock), self._sampling
        if sampling is None or window is None:
            context.doubt(NEVER_STARTED)
        else:
            measured = self._measured = sampling.over(window)
            details = {**clock_details(context), "rate_hz": self.rate_hz, **self.details()}
            report_quality(context, measured.quality(), window, sampled=sampling.window, details=details)
            for problem in self.doubts(measured):
                context.doubt(problem)
        times = () if sampling is None else self.renewals(sampling)
        publish_measures(context, self.measures, self._evaluated, origin=self.origin, clock=clock, times=times)

    def _evaluated(self, window: Window) -> Mapping[str, float | None]:
        sampling = self._sampling.over(window) if self._sampling is not None else None
        return self.values(sampling) if sampling is not None and sampling.quality().is_sufficient else {}


def trial_findings(plugin: PolledProfiler[Any], opened: Callable[[], Meter[Any]]) -> list[Finding]:
    """Open a plugin's meter for a moment, and return errors if that fails."""
    try:
        opened().close()
    except (LinkError, PluginError) as error:
        return [Finding.error(f"plugin {plugin.name}", error.problem, error.fix)]
    return []


def known_series(sampling: Sampling[R], pick: Callable[[R], float | None]) -> Series:
    """Return one quantity of the readings, without those where it is None."""
    pairs = zip(sampling.times, sampling.readings, strict=True)
    told = [(time, value) for time, reading in pairs if (value := pick(reading)) is not None]
    return Series([time for time, _ in told], [value for _, value in told])
