"""What electrical meters have in common: power, voltage, current and energy of one or several channels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.quality import Column, quality_of
from robot_runner.measuring.series import (
    Series,
    cut,
    energy,
    growth,
    longest_standstill,
    mean,
    mean_of_intervals,
    renewed_every,
)
from robot_runner.meters.counters import fall_count, unwrapped
from robot_runner.meters.polled import PolledProfiler

if TYPE_CHECKING:
    from robot_runner.core.events.window import Window
    from robot_runner.measuring.periodic import Sampling

#: What a counter's step and its seldom renewal may hide at one edge of the window, as a share of its increase: with
#: both edges, the energy is off by 1 % at most.
_FINE = 0.005
#: A stretch of equal readings is doubted where it is this long, and fills this share of the window. A converter of ten
#: bits and more shows its own noise in one of three quantities far sooner.
_STUCK_READINGS, _STUCK_SHARE = 30, 0.2
#: Power is renewed seldom where that takes so many readings, and this share of the window.
_SELDOM_READINGS, _SELDOM_SHARE = 3, 0.05

#: Where power that changed between samples may bend the energy by more than this share, that is told.
OFF_SHARE = 0.05
#: A counter sees what readings miss: its power contradicts it beyond so many times what steps between readings leave
#: open, of which bursts that are shorter than the time between readings take up to two and a half.
STEP_ERRORS = 3
#: What is larger than any meter tells in SI units, and small enough for sums and squares to stay finite.
_BEYOND = 1e18
#: Power contradicts voltage times current above this multiple: rounding a small current doubles it, three phases of
#: which one tells its current triple it, and another unit makes a thousandfold. And below this share: the filter of a
#: charger that stands by makes it some hundredths, and the noise of a clamp without a load a 200th.
_MOST_OF_APPARENT, _LEAST_OF_APPARENT = 10.0, 1 / 500
#: No power at all contradicts so many volt-amperes: such a clamp tells 0 W at 19 VA (a Shelly Pro EM-50 in ShellyPy's
#: issue 20), and coarse meters tell whole watts.
_APPARENT = 100.0
#: What is told as 0 may be a step of a coarse meter, V and A; and less than so many volt-amperes may be noise.
_VOLTS_AT_0, _AMPERES_AT_0, _NOISE = 0.1, 0.01, 0.001
#: Told where it holds for more than a step of the load explains and this share of the readings: in a row, or in all.
#: Where quantities are asked one after the other, steps come alone, and make power too high in a quarter at most.
_OF_A_STEP, _IN_A_ROW, _IN_ALL = 2, 0.05, 0.3


class ElectricalReading(NamedTuple):
    """What one channel of a meter says at one moment; None for what it does not tell.

    Attributes:
        power: active power, W.
        voltage: V.
        current: A.
        joules: the meter's own energy counter, J.
        time: when it was measured, s on the clock of the sampling; None for the moment at which it was read.

    Example:
        >>> ElectricalReading(power=7.5, voltage=12.0).current is None
        True
    """

    power: float | None = None
    voltage: float | None = None
    current: float | None = None
    joules: float | None = None
    time: float | None = None


#: One reading of each channel.
Readings = tuple[ElectricalReading, ...]

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
    """Return the measures of a meter's channels; of a single one they have no suffix.

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
    """Reads an electrical meter; a subclass opens it, and says which channels it has.

    It measures energy, mean power, mean voltage and mean current of each channel, as far as the readings tell them.
    Energy is that of the meter's own counter where it is fine enough, else the integral of power; where power is not
    told, but voltage and current are, the subclass multiplies them.

    Args:
        name: tells several instances apart; the class's name if left out.
        rate_hz: readings a second, Hz.
        channels: the names of the channels in the order of the readings; a single one yields measures without suffix.

    Attributes:
        counter_step: the smallest step of the meter's energy counters, J.
        counter_period: how much time may go by until the meter brings its energy counters up to date, s.
        averaged: over how much time power, voltage and current are means, s, where each reading tells of all the time
            since the one before; 0 where they are those of a moment.
        disagreement: how far a counter and the integral of power may be apart before they are doubted, as a share.

    Example:
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

    def columns(self, sampling: Sampling[Readings]) -> Sequence[Column]:
        """Return what each channel said, and the meter's own stamps where it has some; without what it never told."""
        picks = (
            ("power_W", "power"),
            ("voltage_V", "voltage"),
            ("current_A", "current"),
            ("energy_J", "joules"),
            ("stamp_s", "time"),
        )
        prefixes = [f"{channel}_" for channel in self.channels] if len(self.channels) > 1 else [""]
        columns = [
            Column(f"{prefix}{heading}", [getattr(reading[place], quantity) for reading in sampling.readings])
            for place, prefix in enumerate(prefixes)
            for heading, quantity in picks
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
        return dict(zip((measure.name for measure in self.measures), values, strict=True))

    def doubts(self, sampling: Sampling[Readings]) -> Iterator[str]:
        """Yield what is doubtful: a meter that is stuck or the wrong way round, or a counter that power contradicts."""
        for place, channel in enumerate(self.channels):
            of = f" of {channel}" if len(self.channels) > 1 else ""
            yield from (doubt.format(of=of) for doubt in self._channel_doubts(sampling, place))

    def details(self) -> Mapping[str, Any]:
        """Return what the energy of each channel was taken from."""
        if self._measured is None:
            return {}
        sources = [self._energy(self._measured, place)[1] for place in range(len(self.channels))]
        return {"energy_from": dict(zip(self.channels, sources, strict=True))}

    def _energy(self, sampling: Sampling[Readings], place: int) -> tuple[float | None, str]:
        """Return the energy of one channel, J, and what it was taken from."""
        counted, integral = self._counted(sampling, place), self._integral(sampling, place)
        is_fine = counted is not None and counted > 0 and self._blur(sampling, counted) <= _FINE * counted
        if counted is not None and (integral is None or (is_fine and not _falls(sampling, place))):
            return counted, "counter"
        return integral, "power" if integral is not None else ""

    def _counted(self, sampling: Sampling[Readings], place: int) -> float | None:
        counter = _told(sampling, place, "joules")
        has_sign = any(_backward_steps(sampling, place))
        counts = counter.values if has_sign else unwrapped(counter.values)
        return growth(Series(counter.times, counts), sampling.window)

    def _mean(self, sampling: Sampling[Readings], place: int, quantity: str) -> float | None:
        told, window = _told(sampling, place, quantity), sampling.window
        return mean_of_intervals(told, window) if self.averaged else mean(cut(told, window))

    def _integral(self, sampling: Sampling[Readings], place: int) -> float | None:
        if self.averaged:
            watts = self._mean(sampling, place, "power")
            return None if watts is None else watts * sampling.window.duration
        # Where the readings suffice, a gap at an edge is bridged as one inside: by the reading beside it.
        return energy(_told(sampling, place, "power"), sampling.window, reach=sampling.window.duration)

    def _blur(self, sampling: Sampling[Readings], joules: float) -> float:
        """Return how far a counter may be behind at one edge of a window in which so many joules were used, J."""
        duration = sampling.window.duration
        return self.counter_step + (abs(joules) / duration * self.counter_period if duration else 0.0)

    def _channel_doubts(self, sampling: Sampling[Readings], place: int) -> Iterator[str]:
        counted, integral = self._counted(sampling, place), self._integral(sampling, place)
        if falls := _falls(sampling, place):
            yield f"the energy counter{{of}} was set back{'' if falls == 1 else f' {falls} times'}"
        elif counted is not None and integral is not None:
            power = _series(sampling.within(), place, "power")
            late = self.averaged * (max(power.values, default=0.0) - min(power.values, default=0.0))
            missed = 0.0 if self.averaged else STEP_ERRORS * step_error(power, sampling.window)
            blur = 2 * self._blur(sampling, integral) + late + missed
            if abs(counted - integral) > max(self.disagreement * (abs(counted) + abs(integral)) / 2, blur):
                yield f"the energy counter{{of}} rose by {counted:.4g} J, and its power amounts to {integral:.4g} J"
        if counted is not None and integral is None and (blur := self._blur(sampling, counted)) > _FINE * counted:
            yield f"the energy counter{{of}} rose by {counted:.4g} J, and may be behind by {blur:.3g} J at either end"
        if integral is not None and integral < 0:
            yield f"the energy{{of}} is {integral:.4g} J: the meter is the wrong way round, or the load feeds back"
        if self._energy(sampling, place)[1] == "power":
            yield from seldom_renewed(_series(sampling.within(), place, "power"), sampling)
            yield from stepped(_told(sampling, place, "power"), sampling, integral)
        yield from doubts_about_readings(sampling, place)
        yield from _partly_told(sampling, place)


def step_error(power: Series, window: Window) -> float:
    """Return how far the integral of power may be off, J: twice its standard deviation.

    Between two samples power may have changed at once, at any moment: a step that is uniformly distributed over an
    interval has a variance of a twelfth of (change x interval) squared.
    """
    steps = zip(pairwise(power.times), pairwise(power.values), strict=True)
    inside = (
        (min(later, window.end) - max(sooner, window.start), right - left) for (sooner, later), (left, right) in steps
    )
    return 2 * math.sqrt(math.fsum((span * change) ** 2 for span, change in inside if span > 0) / 12)


def stepped(power: Series, sampling: Sampling[Any], joules: float | None) -> Iterator[str]:
    """Yield that power changed so much between samples that its integral may be off; `{of}` stands for the channel."""
    off = step_error(power, sampling.window)
    if joules is not None and off > OFF_SHARE * abs(joules):
        apart = f"{1 / sampling.rate:.1f} s apart"
        yield (
            f"the power{{of}} changed between samples that are {apart}: "
            f"the energy may be off by {off:.2g} J of {joules:.3g} J"
        )


def _quantity(reading: ElectricalReading, quantity: str) -> float | None:
    """Return what a reading tells of a quantity; None also for what is none, such as NaN and what overflowed."""
    value: float | None = getattr(reading, quantity)
    return value if value is not None and abs(value) < _BEYOND else None


def _series(sampling: Sampling[Readings], place: int, quantity: str) -> Series:
    """Return one quantity of a channel; a reading that the meter stamped counts once, at its stamp."""
    told: dict[float, float] = {}
    for time, readings in zip(sampling.times, sampling.readings, strict=True):
        reading = readings[place]
        value = _quantity(reading, quantity)
        if value is not None:
            told.setdefault(time if reading.time is None else reading.time, value)
    times = sorted(told)
    return Series(times, [told[time] for time in times])


def _told(sampling: Sampling[Readings], place: int, quantity: str) -> Series:
    """Return one quantity of a channel where it was told for enough of the window, else nothing."""
    moments = zip(sampling.times, sampling.readings, strict=True)
    times = [time for time, readings in moments if _quantity(readings[place], quantity) is not None]
    is_sufficient = quality_of(times, sampling.window, sampling.rate).is_sufficient
    return _series(sampling, place, quantity) if is_sufficient else Series([], [])


def _partly_told(sampling: Sampling[Readings], place: int) -> Iterator[str]:
    readings = [each[place] for each in sampling.within().readings]
    for quantity, word in (("power", "power"), ("voltage", "voltage"), ("current", "current"), ("joules", "energy")):
        told = sum(_quantity(reading, quantity) is not None for reading in readings)
        is_known = any(getattr(reading, quantity) is not None for reading in readings)
        if is_known and told < len(readings) and not len(_told(sampling, place, quantity)):
            yield f"the {word}{{of}} was told in {told} of {len(readings)} readings only"


def _falls(sampling: Sampling[Readings], place: int) -> int:
    """Return how often a counter was set back: it was lower than before, and not because a load fed back."""
    within = sampling.within()
    if any(_backward_steps(sampling, place)):
        return _backward_steps(within, place).count(False)
    return fall_count(_series(within, place, "joules").values)


def _backward_steps(sampling: Sampling[Readings], place: int) -> list[bool]:
    """Return, each time that a counter fell, whether power was negative: a load fed back, or a battery was charged."""
    told = [
        (joules, watts)
        for readings in sampling.readings
        if (joules := readings[place].joules) is not None and (watts := readings[place].power) is not None
    ]
    return [min(before, now) < 0 for (sooner, before), (later, now) in pairwise(told) if later < sooner]


def seldom_renewed(power: Series, sampling: Sampling[Any]) -> Iterator[str]:
    """Yield that a meter renews its power, as read in the window, less often than it is read; `{of}` as above."""
    every = renewed_every(power) or 0.0
    if every * sampling.rate >= _SELDOM_READINGS and every > _SELDOM_SHARE * sampling.window.duration:
        yield f"the meter renews its power{{of}} every {every:.1f} s only: the energy lacks what changed in between"


def doubts_about_readings(sampling: Sampling[Readings], place: int = 0) -> Iterator[str]:
    """Yield that a meter is stuck, or that its quantities contradict each other; `{of}` stands for the channel."""
    yield from _stuck(sampling, place)
    yield from _contradicted(sampling, place)


def _stuck(sampling: Sampling[Readings], place: int) -> Iterator[str]:
    within = sampling.within()
    for standstill in standstills(within.times, [_standing(readings, place) for readings in within.readings], sampling):
        yield f"the meter said the same{{of}} {standstill}: it may be stuck"


def standstills(times: Sequence[float], values: Sequence[object], sampling: Sampling[Any]) -> Iterator[str]:
    """Yield how often and for how long a meter said the same in the window, where its noise should have been seen."""
    longest = longest_standstill(times, values)
    span = longest[-1] - longest[0] if longest else 0.0
    if len(longest) >= _STUCK_READINGS and span >= _STUCK_SHARE * sampling.window.duration:
        yield f"{len(longest)} times, for {span:.1f} s"


def _standing(readings: Readings, place: int) -> object:
    """Return what says the same where a channel is stuck: that of all channels where nothing is drawn from this one."""
    power, _, current = readings[place][:3]
    return [each[:4] for each in readings] if power == 0 or current == 0 else readings[place][:4]


def _contradicted(sampling: Sampling[Readings], place: int) -> Iterator[str]:
    told = [
        (watts, volts, amperes)
        for (watts, volts, amperes) in (
            tuple(_quantity(readings[place], each) for each in ("power", "voltage", "current"))
            for readings in sampling.within().readings
        )
        if watts is not None and volts is not None and amperes is not None
    ]
    signs = [_contradiction(*each) for each in told]
    stretches = [(sign, len(list(stretch))) for sign, stretch in groupby(signs)]
    for sign in (1, -1):
        count, longest = signs.count(sign), max((size for each, size in stretches if each == sign), default=0)
        is_long = longest > max(_OF_A_STEP, _IN_A_ROW * len(told))
        if is_long or count > max(_OF_A_STEP, _IN_ALL * len(told)) or 0 < count == len(told):
            watts, volts, amperes = told[signs.index(sign)]
            yield (
                f"the power{{of}} contradicts voltage times current in {count} of {len(told)} readings, such as "
                f"{watts:.3g} W at {volts:.3g} V and {amperes:.3g} A: one of them may have another unit"
            )


def _contradiction(watts: float, volts: float, amperes: float) -> int:
    """Return 1 where power is far more than voltage times current allow, -1 where it is far less, else 0."""
    apparent = abs(volts * amperes)
    most = _MOST_OF_APPARENT * max((abs(volts) or _VOLTS_AT_0) * (abs(amperes) or _AMPERES_AT_0), _NOISE)
    is_less = abs(watts) < _LEAST_OF_APPARENT * apparent if watts else apparent >= _APPARENT
    return int(abs(watts) > most) - int(is_less)
