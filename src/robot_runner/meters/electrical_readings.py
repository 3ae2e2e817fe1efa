"""What electrical meters say, reading by reading, and what is doubtful about it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from robot_runner.measuring.quality import quality_of
from robot_runner.measuring.series import Series, longest_standstill, renewed_every
from robot_runner.meters.counters import fall_count

if TYPE_CHECKING:
    from robot_runner.core.events.window import Window
    from robot_runner.measuring.periodic import Sampling

#: A stretch of equal readings is doubted where it is this long, and fills this share of the window. A converter of ten
#: bits and more shows its own noise in one of three quantities far sooner.
_STUCK_READINGS, _STUCK_SHARE = 30, 0.2
#: Power is renewed seldom where that takes so many readings, and this share of the window.
_SELDOM_READINGS, _SELDOM_SHARE = 3, 0.05

#: Power that changed between samples is told where the energy may be off by more than this share.
OFF_SHARE = 0.05
#: A counter sees what readings of power miss. The two disagree only where they are further apart than so many times the
#: error that steps between readings explain: bursts shorter than the time between readings explain up to 2.5 times it.
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


def series_of(sampling: Sampling[Readings], place: int, quantity: str) -> Series:
    """Return one quantity of a channel; a reading that the meter stamped counts once, at its stamp."""
    told: dict[float, float] = {}
    for time, readings in zip(sampling.times, sampling.readings, strict=True):
        reading = readings[place]
        value = _quantity(reading, quantity)
        if value is not None:
            told.setdefault(time if reading.time is None else reading.time, value)
    times = sorted(told)
    return Series(times, [told[time] for time in times])


def told_series(sampling: Sampling[Readings], place: int, quantity: str) -> Series:
    """Return one quantity of a channel where it was told for enough of the window, else nothing."""
    moments = zip(sampling.times, sampling.readings, strict=True)
    times = [time for time, readings in moments if _quantity(readings[place], quantity) is not None]
    is_sufficient = quality_of(times, sampling.window, sampling.rate).is_sufficient
    return series_of(sampling, place, quantity) if is_sufficient else Series([], [])


def partly_told(sampling: Sampling[Readings], place: int) -> Iterator[str]:
    """Yield which quantities of a channel were told too seldom for a value; `{of}` stands for the channel."""
    readings = [each[place] for each in sampling.within().readings]
    for quantity, word in (("power", "power"), ("voltage", "voltage"), ("current", "current"), ("joules", "energy")):
        told = sum(_quantity(reading, quantity) is not None for reading in readings)
        is_known = any(getattr(reading, quantity) is not None for reading in readings)
        if is_known and told < len(readings) and not len(told_series(sampling, place, quantity)):
            yield f"the {word}{{of}} was told in {told} of {len(readings)} readings only"


def falls_of(sampling: Sampling[Readings], place: int) -> int:
    """Return how often a counter was set back: it was lower than before, and not because a load fed back."""
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
