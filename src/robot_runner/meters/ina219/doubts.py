"""Doubts about the samples of a power meter, with figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from statistics import fmean

from robot_runner.core.events.window import Window
from robot_runner.measuring.series import Series, within
from robot_runner.meters.ina219.sample_stream import SampleStream, Trouble

#: The configuration of a sensor after a loss of power: 32 V, ±320 mV, single 12-bit conversions.
POWER_ON_CONFIGURATION = 0x399F

#: This many equal readings in a row are not chance. A converter of 12 bits shows noise of about a step, and a robot's
#: current is never constant: even if only one reading in ten differed from the one before, 150 equal ones would come
#: once in seven million (0.9 ** 150 = 1.4e-7). At 200 Hz they take 0.75 s, so that a probe of a second is enough.
_ALIKE = 150
#: Quartzes and ceramic resonators drift less than this, parts of one (an Arduino Nano's: 0.5 % by its data sheet).
_LARGEST_DRIFT = 0.01
#: A lower supply voltage means that there is none, V: the INA219 itself needs 3 V, and no robot works with less.
_LOWEST_VOLTAGE = 0.5
_LOOK = "look at the four wires between them"


def stuck_doubts(readings: Iterable[object], seconds: float, count: int) -> Iterator[str]:
    """Yield a doubt if readings stood still, of `count` readings that took `seconds`.

    Example:
        >>> list(stuck_doubts([7] * 150 + [8] * 50, 1.0, 200))
        ['the sensor read the same for 0.8 s (150 readings on end): one that measures shows noise']
    """
    longest = max((len(list(same)) for _, same in groupby(readings)), default=0)
    if longest >= _ALIKE:
        lasted = seconds * longest / count
        yield f"the sensor read the same for {lasted:.1f} s ({longest} readings on end): one that measures shows noise"


def power_doubts(power: Series, window: Window, limits: tuple[float, float] | None) -> Iterator[str]:
    """Yield doubts about implausible power (W) in a window; `limits` are the user's, W."""
    values = power.values[within(power.times, window)]
    if not len(values):
        return
    mean = fmean(values)
    if mean < 0:
        yield f"the mean power is {mean:.2f} W: VIN+ and VIN- of the sensor are swapped, or the robot feeds its battery"
    if limits is None:
        return
    low, high = limits
    outside = [value for value in values if not low <= value <= high]
    if outside:
        worst = max(outside, key=lambda value: max(low - value, value - high))
        implausible = f"{len(outside)} of {len(values)} samples lie outside the plausible {low:g} to {high:g} W"
        yield f"{implausible}, the furthest at {worst:.2f} W"


def voltage_doubts(volts: Sequence[float]) -> Iterator[str]:
    """Yield a doubt if samples have no bus voltage."""
    dead = sum(1 for each in volts if each < _LOWEST_VOLTAGE)
    if dead:
        yield f"{dead} of {len(volts)} samples show no voltage: is VIN- connected to the robot, and the battery in?"


def stream_doubts(
    stream: SampleStream, window: Window, times: Sequence[float], volts: Sequence[float]
) -> Iterator[str]:
    """Yield doubts by faults of the line, the device and the sensor in a window of `times`."""
    yield from _line_doubts(stream, stream.troubles(window, times))
    if abs(stream.drift) > _LARGEST_DRIFT:
        way = "slow" if stream.drift > 0 else "fast"
        off = f"the meter's clock goes {100 * abs(stream.drift):.1f} % {way} by the arrivals of its samples"
        yield f"{off}, which no resonator does; the samples were placed by their arrivals"
    if 0 in stream.configurations:
        yield f"the power meter answered, its sensor did not: {_LOOK}"
    if POWER_ON_CONFIGURATION in stream.configurations:
        yield "the sensor was without power for a moment and measured in another range for up to a second"
    seen = within(times, window)
    yield from voltage_doubts(volts[seen])
    yield from stuck_doubts(stream.shunt_raw[seen], window.duration, len(stream.shunt_raw[seen]))


def _line_doubts(stream: SampleStream, troubles: Mapping[Trouble, int]) -> Iterator[str]:
    if restarts := troubles[Trouble.RESTART]:
        yield f"the power meter was restarted {'once' if restarts == 1 else f'{restarts} times'}"
    if troubles[Trouble.FOREIGN]:
        yield "the power meter speaks another version of the protocol"
    if standing := troubles[Trouble.STANDING_STAMP]:
        yield f"the meter's clock stood still while {standing} samples arrived"
    if numbered := troubles[Trouble.STANDING_NUMBER]:
        yield f"{numbered} samples carried the number of the one before: what was lost among them cannot be told"
    if (dropped := troubles[Trouble.DROPPED]) and not troubles[Trouble.CORRUPT]:
        yield f"{dropped} bytes on the line belonged to no frame"
    if stream.bytes_since_frame > _LONGEST_FRAME and len(stream):
        yield f"the last {_amount(stream.bytes_since_frame)} on the line held no frame"


#: Bytes; the rest of a frame that was cut off is shorter.
_LONGEST_FRAME = 72
_KILOBYTE = 1000


def silence(stream: SampleStream, seconds: float) -> str | None:
    """Return what a meter sent that gave no sample for this many seconds; None if it gave some, or reported why."""
    if len(stream) or 0 in stream.configurations:  # 0: the device reported that its sensor did not answer
        return None
    if not stream.bytes:
        return f"no byte came in {seconds:.0f} s: is it the right port, and does the meter have power?"
    amount = f"{_amount(stream.bytes)} came in {seconds:.0f} s"
    if not stream.counts.frames:
        return f"{amount}, none of it frames: wrong baud rate, or another device?"
    if stream.counts.foreign_versions:
        return f"{amount}, in frames of another version of the protocol"
    return f"{amount}, frames among it, but no sample of this sensor"


def _amount(count: int) -> str:
    return f"{count / 1000:.3g} kB" if count >= _KILOBYTE else f"{count} bytes"


def settings_doubts(stream: SampleStream, shunt: float, rate: float) -> Iterator[str]:
    """Yield doubts where the device's shunt (ohm) and rate (Hz) differ from the user's."""
    if len(stream.shunts) > 1:
        told = ", ".join(f"{each:g}" for each in sorted(stream.shunts))
        yield f"the power meter reported several shunts ({told} ohm), as where it is exchanged: {shunt:g} ohm counts"
    hello = stream.sensing or stream.hello
    if hello is not None and abs(hello.shunt_ohm - shunt) > 0.001 * shunt:
        yield f"the power meter reports that its shunt has {hello.shunt_ohm:g} ohm, not {shunt:g} ohm"
    if stream.hello is not None and stream.hello.rate_hz != rate:
        yield f"the power meter reports that it samples at {stream.hello.rate_hz} Hz, not at {rate:g} Hz"
