"""The readings of electrical meters, and doubts about them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from robot_runner.measuring.quality import SampleQuality, quality_of
from robot_runner.measuring.series import Series, longest_standstill, renewed_every
from robot_runner.meters.counters import fall_count

if TYPE_CHECKING:
    from robot_runner.core.events.window import Window
    from robot_runner.measuring.periodic import Sampling

#: Equal readings in a row are doubted if they are this many, and fill this share of the window. A converter of ten or
#: more bits shows its own noise in one of three quantities far sooner.
_STUCK_READINGS, _STUCK_SHARE = 30, 0.2
#: Power is updated rarely if an update takes this many readings, and this share of the window.
_SELDOM_READINGS, _SELDOM_SHARE = 3, 0.05
#: An update in more readings than that makes steps between samples wider than the time between two readings.
_SELDOM = 1.5

#: Changes of power between samples are reported if the energy may be off by more than this share.
OFF_SHARE = 0.05
#: A counter includes what readings of power miss. The two disagree only if they differ by more than this many times the
#: error by steps between readings: bursts shorter than the time between readings explain up to 2.5 times that error.
STEP_ERRORS = 3
#: Values are missing between two that are more than this many periods apart.
_LONG_GAP = 1.5
#: A stamp may be that much older than its reading, in periods, without a doubt.
_FEW_PERIODS = 2.0
#: Larger than any value of a meter in SI units, and small enough for sums and squares to stay finite.
_BEYOND = 1e18
#: Power contradicts voltage times current above this multiple: a small current that is rounded doubles the ratio, three
#: phases with the current of one triple it, and a wrong unit makes it a thousandfold. And below this share: the filter
#: of a charger in standby makes it some hundredths, and the noise of a clamp without a load a 200th.
_MOST_OF_APPARENT, _LEAST_OF_APPARENT = 10.0, 1 / 500
#: No power at all contradicts this many volt-amperes: such a clamp shows 0 W at 19 VA (a Shelly Pro EM-50 in ShellyPy's
#: issue 20), coarse meters show whole watts, and one that failed showed 0 W at 65 VA (Tasmota's issue 3515).
_APPARENT = 50.0
#: A reading of 0 may be up to a step of a coarse meter, V and A; and less than this many volt-amperes may be noise.
_VOLTS_AT_0, _AMPERES_AT_0, _NOISE = 0.1, 0.01, 0.001
#: Contradictions are reported if a step of the load does not explain their number and they are this share of the
#: readings: in a row, or in all. If quantities are queried one after the other, a step contradicts in single readings,
#: and makes power too high in a quarter of them at most.
_OF_A_STEP, _IN_A_ROW, _IN_ALL = 2, 0.05, 0.3


class ElectricalReading(NamedTuple):
    """The values of one channel of a meter at one moment; None for those that the meter does not have.

    Attributes:
        power: active power, W.
        voltage: V.
        current: A.
        joules: the meter's own energy counter, J.
        time: of the measurement, s on the clock of the sampling; None for the time of the reading.

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


def step_error(power: Series, window: Window) -> float:
    """Return how far the integral of power may be off, J: twice its standard deviation.

    Between two samples power may have changed in one step at any moment: if the moment is uniformly distributed over
    the interval, the variance is a twelfth of (change x interval) squared.
    """
    steps = zip(pairwise(power.times), pairwise(power.values), strict=True)
    inside = (
        (min(later, window.end) - max(sooner, window.start), right - left) for (sooner, later), (left, right) in steps
    )
    return 2 * math.sqrt(math.fsum((span * change) ** 2 for span, change in inside if span > 0) / 12)


def stepped(power: Series, sampling: Sampling[Any], joules: float | None) -> Iterator[str]:
    """Yield a doubt if power changed so much between samples that its integral may be off; `{of}`: the channel."""
    every = max(renewed_every(power) or 0.0, 1 / sampling.rate)
    off = step_error(power if every * sampling.rate < _SELDOM else _changes(power), sampling.window)
    if joules is not None and off > OFF_SHARE * abs(joules):
        apart = f"the power{{of}} changed between samples that are {every:.1f} s apart"
        yield f"{apart}: the energy may be off by {off:.2g} J of {joules:.3g} J"


def _changes(series: Series) -> Series:
    """Return the samples that differ from the one before."""
    places = [place for place in range(len(series)) if not place or series.values[place] != series.values[place - 1]]
    return Series([series.times[place] for place in places], [series.values[place] for place in places])


def _quantity(reading: ElectricalReading, quantity: str) -> float | None:
    """Return a quantity of a reading; None also for values that are not a quantity, such as NaN and overflows."""
    value: float | None = getattr(reading, quantity)
    return value if value is not None and abs(value) < _BEYOND else None


def series_of(sampling: Sampling[Readings], place: int, quantity: str) -> Series:
    """Return one quantity of a channel; a reading with a stamp of the meter counts once, at its stamp."""
    told: dict[float, float] = {}
    for time, readings in zip(sampling.times, sampling.readings, strict=True):
        reading = readings[place]
        value = _quantity(reading, quantity)
        if value is not None:
            told.setdefault(time if reading.time is None else reading.time, value)
    times = sorted(told)
    return Series(times, [told[time] for time in times])


def told_series(sampling: Sampling[Readings], place: int, quantity: str) -> Series:
    """Return one quantity of a channel if its values cover enough of the window, else an empty series."""
    is_sufficient = _told_quality(sampling, place, quantity).is_sufficient
    return series_of(sampling, place, quantity) if is_sufficient else Series([], [])


def _told_quality(sampling: Sampling[Readings], place: int, quantity: str) -> SampleQuality:
    moments = zip(sampling.times, sampling.readings, strict=True)
    times = [time for time, readings in moments if _quantity(readings[place], quantity) is not None]
    return quality_of(times, sampling.window, sampling.rate)


def partly_told(sampling: Sampling[Readings], place: int) -> Iterator[str]:
    """Yield the quantities of a channel whose values leave much of the window out; `{of}` stands for the channel."""
    readings = [each[place] for each in sampling.within().readings]
    for quantity, word in (("power", "power"), ("voltage", "voltage"), ("current", "current"), ("joules", "energy")):
        told = sum(_quantity(reading, quantity) is not None for reading in readings)
        is_known = any(getattr(reading, quantity) is not None for reading in readings)
        if is_known and told < len(readings) and _is_partial(_told_quality(sampling, place, quantity)):
            yield f"the {word}{{of}} was reported in {told} of {len(readings)} readings only"


def unreached_by_stamps(sampling: Sampling[Readings], place: int) -> Iterator[str]:
    """Yield a doubt if a meter's own stamps leave out an end of the window: values count at their stamps."""
    stamps = sorted(stamp for readings in sampling.readings if (stamp := readings[place].time) is not None)
    window, few = sampling.window, _FEW_PERIODS / sampling.rate
    left_out = max(0.0, stamps[0] - window.start) + max(0.0, window.end - stamps[-1]) if stamps else 0.0
    if left_out > max(OFF_SHARE * window.duration, few):
        yield f"the meter's stamps{{of}} leave out {left_out:.5g} s of the window: are they on the run's clock?"


def _is_partial(quality: SampleQuality) -> bool:
    gap = quality.largest_gap if quality.largest_gap > _LONG_GAP * quality.period else 0.0
    return not quality.is_sufficient or gap > OFF_SHARE * quality.duration


def falls_of(sampling: Sampling[Readings], place: int) -> int:
    """Return how often a counter was reset: it was lower than before, and not because a load fed back."""
    within = sampling.within()
    if any(backward_steps(sampling, place)):
        return backward_steps(within, place).count(False)
    return fall_count(series_of(within, place, "joules").values)


def backward_steps(sampling: Sampling[Readings], place: int) -> list[bool]:
    """Return, each time that a counter fell, whether power was negative: a load fed back, or a battery was charged."""
    told = [
        (joules, watts)
        for readings in sampling.readings
        if (joules := readings[place].joules) is not None and (watts := readings[place].power) is not None
    ]
    return [min(before, now) < 0 for (sooner, before), (later, now) in pairwise(told) if later < sooner]


def renewal_of(series: Series, sampling: Sampling[Any]) -> float:
    """Return the time between updates of a meter's quantity, s; 0 where it is updated about as often as it is read."""
    every = renewed_every(series) or 0.0
    return every if every * sampling.rate >= _SELDOM_READINGS else 0.0


def seldom_renewed(power: Series, sampling: Sampling[Any]) -> Iterator[str]:
    """Yield a doubt if a meter updates its power in the window less often than it is read; `{of}` as above."""
    if (every := renewal_of(power, sampling)) > _SELDOM_SHARE * sampling.window.duration:
        yield f"the meter renews its power{{of}} every {every:.1f} s only: the energy lacks what changed in between"


def doubts_about_readings(sampling: Sampling[Readings], place: int = 0) -> Iterator[str]:
    """Yield doubts if a meter is stuck, or its quantities contradict each other; `{of}` stands for the channel."""
    within = sampling.within()
    for standstill in standstills(within.times, [_standing(readings, place) for readings in within.readings], sampling):
        yield f"the meter reported the same value{{of}} {standstill}: it may be stuck"
    yield from _contradicted(within, place)


def standstills(times: Sequence[float], values: Sequence[object], sampling: Sampling[Any]) -> Iterator[str]:
    """Yield for how many readings and how long a meter repeated one value, if that fills so much of the window."""
    longest = longest_standstill(times, values)
    span = longest[-1] - longest[0] if longest else 0.0
    if len(longest) >= _STUCK_READINGS and span >= _STUCK_SHARE * sampling.window.duration:
        yield f"{len(longest)} times, for {span:.1f} s"


def _standing(readings: Readings, place: int) -> object:
    """Return the values that repeat if a channel is stuck: those of all channels if this one draws nothing."""
    power, _, current = readings[place][:3]
    return [each[:4] for each in readings] if power == 0 or current == 0 else readings[place][:4]


def _contradicted(within: Sampling[Readings], place: int) -> Iterator[str]:
    told = [
        (watts, volts, amperes)
        for (watts, volts, amperes) in (
            tuple(_quantity(readings[place], each) for each in ("power", "voltage", "current"))
            for readings in within.readings
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
            contradicts = f"the power{{of}} contradicts voltage times current in {count} of {len(told)} readings"
            such_as = f"such as {watts:.3g} W at {volts:.3g} V and {amperes:.3g} A"
            yield f"{contradicts}, {such_as}: one of them may have another unit"


def _contradiction(watts: float, volts: float, amperes: float) -> int:
    """Return 1 if power is far more than voltage times current allow, -1 if it is far less, else 0."""
    apparent = abs(volts * amperes)
    most = _MOST_OF_APPARENT * max((abs(volts) or _VOLTS_AT_0) * (abs(amperes) or _AMPERES_AT_0), _NOISE)
    is_less = abs(watts) < _LEAST_OF_APPARENT * apparent if watts else apparent >= _APPARENT
    return int(abs(watts) > most) - int(is_less)
