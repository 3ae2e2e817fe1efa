"""What electrical meters have in common: power, voltage, current and energy of one or several channels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.quality import Column
from robot_runner.measuring.series import Series, cut, energy, growth, mean, mean_of_intervals
from robot_runner.meters.counters import unwrapped
from robot_runner.meters.electrical_readings import (
    STEP_ERRORS,
    ElectricalReading,
    Readings,
    backward_steps,
    doubts_about_readings,
    falls_of,
    partly_told,
    renewal_of,
    seldom_renewed,
    series_of,
    step_error,
    stepped,
    told_series,
    unreached_by_stamps,
)
from robot_runner.meters.polled import PolledProfiler

if TYPE_CHECKING:
    from robot_runner.measuring.periodic import Sampling

#: The error at one edge of the window, by a counter's step and its rare updates, may be this share of its increase:
#: with both edges, the energy is off by 1 % at most.
_FINE = 0.005
#: The same in a phase of a mission whose energy is from the counter: 5 % at most with both ends.
_FINE_IN_PHASE = 0.025

_MEASURES = (
    Measure(
        "Energy",
        "J",
        "Energy{of} over the measured window: by the meter's counter if fine enough, else power x time.",
        over=Over.SUM,
    ),
    Measure("MeanPower", "W", "Mean power{of} over the measured window: Energy / its duration.", over=Over.MEAN),
    Measure("MeanVoltage", "V", "Voltage{of}, mean over the measured window.", over=Over.MEAN),
    Measure("MeanCurrent", "A", "Current{of}, mean over the measured window.", over=Over.MEAN),
)


def electrical_measures(channels: Sequence[str]) -> tuple[Measure, ...]:
    """Return the measures of a meter's channels, without suffix if there is only one.

    Example:
        >>> [measure.name for measure in electrical_measures(["VDD_IN", "VDD_CPU"])][::4]
        ['Energy_VDD_IN', 'Energy_VDD_CPU']
        >>> electrical_measures(["VDD_IN"])[0].name
        'Energy'
    """
    suffixed = [(f"_{channel}", f" of {channel}") for channel in channels] if len(channels) > 1 else [("", "")]
    return tuple(
        replace(measure, name=measure.name + suffix, description=measure.description.format(of=of))
        for suffix, of in suffixed
        for measure in _MEASURES
    )


class ElectricalProfiler(PolledProfiler[Readings]):
    """Reads an electrical meter; a subclass opens it and names its channels.

    It measures energy, mean power, mean voltage and mean current of each channel, as far as the readings contain them.
    Energy is taken from the meter's own counter if that is fine enough, else it is the integral of power. If a meter
    has voltage and current but no power, the subclass multiplies them.

    Args:
        name: distinguishes several instances; None for the class's name.
        rate_hz: readings a second, Hz.
        channels: the names of the channels in the order of the readings; a single one yields measures without suffix.

    Attributes:
        counter_step: the smallest step of the meter's energy counters, J.
        counter_period: the longest time between two updates of the meter's energy counters, s.
        averaged: the time over which power, voltage and current are means, s, where each reading covers all the time
            since the one before; 0 where they are values of a moment.
        disagreement: the largest difference between a counter and the integral of power without a doubt, as a share.

    Example:
        >>> from robot_runner.plugins import ElectricalReading
        >>> class Steady:
        ...     def read(self):
        ...         return (ElectricalReading(power=7.5, voltage=12.0),)
        ...     def close(self):
        ...         pass
        >>> class Supply(ElectricalProfiler):
        ...     def open(self, context):
        ...         return Steady()
        >>> [measure.name for measure in Supply().measures]
        ['Energy', 'MeanPower', 'MeanVoltage', 'MeanCurrent']
    """

    measures: Sequence[Measure] = electrical_measures(("",))

    counter_step: float = 0.0
    counter_period: float = 0.0
    averaged: float = 0.0
    disagreement: float = 0.05

    def __init__(self, *, name: str | None = None, rate_hz: float = 10.0, channels: Sequence[str] = ("",)) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        self.channels = tuple(channels)
        self.measures = electrical_measures(self.channels)

    def checked(self, reading: Readings) -> Readings:
        """Return a reading; a `ValueError` says that it is not an `ElectricalReading` for each channel."""
        told = super().checked(reading)
        if len(told) != len(self.channels) or not all(isinstance(each, ElectricalReading) for each in told):
            raise ValueError(f"the meter returned {told}, not an ElectricalReading for each channel")
        return told

    def columns(self, sampling: Sampling[Readings]) -> Sequence[Column]:
        """Return the quantities of each channel that have values, and the meter's own stamps where it has some."""
        picks = {
            "power_W": "power",
            "voltage_V": "voltage",
            "current_A": "current",
            "energy_J": "joules",
            "stamp_s": "time",
        }
        prefixes = [f"{channel}_" for channel in self.channels] if len(self.channels) > 1 else [""]
        columns = [
            Column(f"{prefix}{heading}", [getattr(reading[place], quantity) for reading in sampling.readings])
            for place, prefix in enumerate(prefixes)
            for heading, quantity in picks.items()
        ]
        return [column for column in columns if any(value is not None for value in column.values)]

    def values(self, sampling: Sampling[Readings]) -> Mapping[str, float | None]:
        """Return energy, mean power, voltage and current of each channel."""
        window = sampling.window
        values: list[float | None] = []
        for place in range(len(self.channels)):
            joules = self._energy(sampling, place)[0]
            watts = joules / window.duration if joules is not None and window.duration else None
            means = [self._mean(sampling, place, each) for each in ("voltage", "current")]
            values += (joules, watts, *means)
        # A subclass may have set other measures: more than these, or fewer.
        return dict(zip((measure.name for measure in electrical_measures(self.channels)), values, strict=True))

    def doubts(self, sampling: Sampling[Readings]) -> Iterator[str]:
        """Yield doubts, such as a meter that is stuck or connected backwards, or a counter that power contradicts."""
        for place, channel in enumerate(self.channels):
            of = f" of {channel}" if len(self.channels) > 1 else ""
            yield from (doubt.format(of=of) for doubt in self._channel_doubts(sampling, place))

    def renewals(self, sampling: Sampling[Readings]) -> Sequence[float]:
        """Return when the meter said something new of power, s."""
        power = [math.fsum(channel.power or 0.0 for channel in readings) for readings in sampling.readings]
        if not renewal_of(Series(sampling.times, power), sampling):
            return sampling.times
        steps = zip(sampling.times[1:], pairwise(power), strict=False)
        return [time for time, (before, now) in steps if now != before]

    def details(self) -> Mapping[str, Any]:
        """Return the source of each channel's energy."""
        if self._measured is None:
            return {}
        sources = [self._energy(self._measured, place)[1] for place in range(len(self.channels))]
        return {"energy_from": dict(zip(self.channels, sources, strict=True))}

    def _energy(self, sampling: Sampling[Readings], place: int) -> tuple[float | None, str]:
        """Return the energy of one channel, J, and its source."""
        counted, integral = self._counted(sampling, place), self._integral(sampling, place)
        most = self._most_blur(sampling, place)
        is_fine = counted is not None and counted > 0 and self._blur(sampling, place, counted) <= most * counted
        if counted is not None and (integral is None or (is_fine and not falls_of(sampling, place))):
            return counted, "counter"
        return integral, "power" if integral is not None else ""

    def _most_blur(self, sampling: Sampling[Readings], place: int) -> float:
        """Return how far a counter may be off at an end, as a share; phases have the mission's source, to add up."""
        mission = self._measured
        if mission is None or sampling.window == mission.window:
            return _FINE
        return _FINE_IN_PHASE if self._energy(mission, place)[1] == "counter" else 0.0

    def _counted(self, sampling: Sampling[Readings], place: int) -> float | None:
        counter = told_series(sampling, place, "joules")
        has_sign = any(backward_steps(sampling, place))
        counts = counter.values if has_sign else unwrapped(counter.values)
        return growth(Series(counter.times, counts), sampling.window)

    def _mean(self, sampling: Sampling[Readings], place: int, quantity: str) -> float | None:
        told, window = told_series(sampling, place, quantity), sampling.window
        return mean_of_intervals(told, window) if self.averaged else mean(cut(told, window))

    def _integral(self, sampling: Sampling[Readings], place: int) -> float | None:
        if self.averaged:
            watts = self._mean(sampling, place, "power")
            return None if watts is None else watts * sampling.window.duration
        # If the readings suffice, a gap at an edge is bridged like one inside: by the reading beside it.
        return energy(told_series(sampling, place, "power"), sampling.window, reach=sampling.window.duration)

    def _blur(self, sampling: Sampling[Readings], place: int, joules: float) -> float:
        """Return how far a counter may be behind at one edge of a window in which `joules` were used, J."""
        duration = sampling.window.duration
        period = max(self.counter_period, renewal_of(series_of(sampling.within(), place, "joules"), sampling))
        return self.counter_step + (abs(joules) / duration * period if duration else 0.0)

    def _channel_doubts(self, sampling: Sampling[Readings], place: int) -> Iterator[str]:
        counted, integral = self._counted(sampling, place), self._integral(sampling, place)
        if falls := falls_of(sampling, place):
            yield f"the energy counter{{of}} was set back{'' if falls == 1 else f' {falls} times'}"
        elif counted is not None and integral is not None:
            power = series_of(sampling.within(), place, "power")
            late = self.averaged * (max(power.values, default=0.0) - min(power.values, default=0.0))
            missed = 0.0 if self.averaged else STEP_ERRORS * step_error(power, sampling.window)
            blur = 2 * self._blur(sampling, place, integral) + late + missed
            if abs(counted - integral) > max(self.disagreement * (abs(counted) + abs(integral)) / 2, blur):
                yield f"the energy counter{{of}} rose by {counted:.4g} J, and its power amounts to {integral:.4g} J"
        if (
            counted is not None
            and integral is None
            and (blur := self._blur(sampling, place, counted)) > _FINE * counted
        ):
            yield f"the energy counter{{of}} rose by {counted:.4g} J, and may be behind by {blur:.3g} J at either end"
        if integral is not None and integral < 0:
            yield f"the energy{{of}} is {integral:.4g} J: the meter is the wrong way round, or the load feeds back"
        if self._energy(sampling, place)[1] == "power":
            yield from seldom_renewed(series_of(sampling.within(), place, "power"), sampling)
            yield from stepped(told_series(sampling, place, "power"), sampling, integral)
        yield from doubts_about_readings(sampling, place)
        yield from partly_told(sampling, place)
        yield from unreached_by_stamps(sampling, place)
