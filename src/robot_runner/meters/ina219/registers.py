"""From the samples of a run to energy, mean power, and how far they can be trusted."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import mul
from pathlib import Path
from typing import Any

from robot_runner.core.events.window import Window
from robot_runner.measuring.quality import Column, SampleQuality, quality_of, write_quality, write_samples
from robot_runner.measuring.series import Series, energy, energy_from_mean_power, within
from robot_runner.meters.ina219.doubts import power_doubts, settings_doubts, stream_doubts
from robot_runner.meters.ina219.sample_stream import SampleStream, Trouble

# Registers are converted to volts, amperes and watts here, on the host, so that raw data stay raw.

#: One step of the shunt voltage register (0x01), V.
SHUNT_VOLT_PER_STEP = 10e-6
#: One step of the bus voltage register (0x02), V; the voltage is in its bits 15 to 3.
BUS_VOLT_PER_STEP = 4e-3
_BUS_SHIFT = 3
#: By the protocol, the configuration of a device that sends none: 16 V, ±320 mV, two conversions averaged.
_USUAL_CONFIGURATION = 0x1CCF


@dataclass(frozen=True, slots=True)
class Calibration:
    """The conversion of registers to physical units.

    Attributes:
        shunt_ohm: resistance of the shunt, ohm; 0.1 on the common breakout boards.

    Example:
        >>> calibration = Calibration(shunt_ohm=0.1)
        >>> round(calibration.current(6130), 6), round(calibration.voltage(0x60E2), 6)
        (0.613, 12.4)
    """

    shunt_ohm: float = 0.1

    def current(self, shunt_raw: int) -> float:
        """Return the current through the shunt in amperes."""
        return shunt_raw * (SHUNT_VOLT_PER_STEP / self.shunt_ohm)

    def currents(self, shunt_raw: Iterable[int]) -> array[float]:
        """Return `current` of many registers."""
        step = SHUNT_VOLT_PER_STEP / self.shunt_ohm
        return array("d", (each * step for each in shunt_raw))

    def voltage(self, bus_raw: int) -> float:
        """Return the bus voltage after the shunt in volts; the register's flags (bits 2 to 0) are ignored."""
        return (bus_raw >> _BUS_SHIFT) * BUS_VOLT_PER_STEP

    def voltages(self, bus_raw: Iterable[int]) -> array[float]:
        """Return `voltage` of many registers."""
        return array("d", ((each >> _BUS_SHIFT) * BUS_VOLT_PER_STEP for each in bus_raw))


@dataclass(frozen=True, slots=True)
class Ranges:
    """The ranges of the registers: at the end of the range, the true value may be larger.

    Attributes:
        shunt: largest magnitude of the shunt voltage register.
        bus: largest voltage in the bus voltage register, in its steps.

    Example:
        >>> Ranges.of(0x1CCF)
        Ranges(shunt=32000, bus=4000)
    """

    shunt: int
    bus: int

    @classmethod
    def of(cls, *configurations: int) -> Ranges:
        """Return the narrowest ranges that configuration registers set; 0 is unknown and gets the protocol's ranges.

        The gain (bits 12 and 11) sets ±40, 80, 160 or 320 mV, bit 13 sets 16 or 32 V.
        """
        known = [each for each in configurations if each] or [_USUAL_CONFIGURATION]
        return cls(
            shunt=min(4000 << (each >> 11 & 3) for each in known),
            bus=min(8000 if each & 0x2000 else 4000 for each in known),
        )

    def count_saturated(self, shunt_raw: Sequence[int], bus_raw: Sequence[int]) -> int:
        """Return the number of samples with a reading at the end of its range."""
        highest, lowest = max(shunt_raw, default=0), min(shunt_raw, default=0)
        if -self.shunt < lowest and highest < self.shunt and max(bus_raw, default=0) >> _BUS_SHIFT < self.bus:
            return 0  # the usual case, fast
        pairs = zip(shunt_raw, bus_raw, strict=True)
        return sum(abs(shunt) >= self.shunt or bus >> _BUS_SHIFT >= self.bus for shunt, bus in pairs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The power samples of a run, from any connection, and their evaluation over a window.

    Attributes:
        window: of the values.
        power: W, drawn by the robot, at times in s; also outside the window.
        quality: of the samples in the window.
        columns: raw readings and physical values, written besides `time_s` and `power_W`.
        details: of the meter, as plain values.
        doubts: about this kind of meter, one sentence each.
        is_simulated: whether a simulated sensor took the samples.
        sampled: the time span of sampling.
        limits: of plausible power, W.
    """

    window: Window
    power: Series
    quality: SampleQuality
    columns: tuple[Column, ...] = ()
    details: Mapping[str, Any]
    doubts: tuple[str, ...] = ()
    is_simulated: bool = False
    sampled: Window | None = None
    limits: tuple[float, float] | None = None

    def over(self, part: Window) -> Evaluation:
        """Return the same samples, to be evaluated over another window; doubts stay those of the whole one."""
        return replace(self, window=part, quality=quality_of(self.power.times, part, 1 / self.quality.period))

    def values(self) -> Mapping[str, float | None]:
        """Return energy (J), energy as P x t (J) and mean power (W); all None if samples cover too little."""
        # If the samples suffice, a gap at an edge is bridged like one inside: by the sample beside it.
        reach = self.window.duration
        joules = energy(self.power, self.window, reach=reach) if self.quality.is_sufficient else None
        if joules is None or self.window.duration <= 0:
            return {"Energy": None, "EnergyPt": None, "MeanPower": None}
        return {
            "Energy": joules,
            "EnergyPt": energy_from_mean_power(self.power, self.window),
            "MeanPower": joules / self.window.duration,
        }

    def warnings(self) -> Iterator[str]:
        """Yield doubts, with figures."""
        yield from self.quality.warnings()
        if not self.quality.is_sufficient and self.quality.got:
            yield "the samples do not cover the measured window, so no energy was computed from them"
        if self.quality.saturated and (joules := self.values()["Energy"]) is not None:
            share = 100 * self.quality.saturated / max(self.quality.got, 1)
            yield f"the energy is at least {joules:.1f} J: {share:.1f} % of the samples were clipped"
        yield from self.doubts
        yield from power_doubts(self.power, self.window, self.limits)

    def write(self, folder: Path) -> None:
        """Write `samples.csv` and `quality.json`."""
        times, power = Column("time_s", self.power.times), Column("power_W", self.power.values)
        write_samples(folder / "samples.csv", (times, *self.columns, power))
        details = {"is_simulated": self.is_simulated, **self.details}
        write_quality(folder / "quality.json", self.quality, self.window, details, sampled=self.sampled)


#: Unless the user or the device gives others: the paper's 200 Hz, and the shunt of the common breakout boards.
DEFAULT_RATE = 200.0
DEFAULT_SHUNT = 0.1


def evaluate_registers(
    stream: SampleStream,
    times: Sequence[float],
    window: Window,
    *,
    shunt_ohm: float | None = None,
    rate_hz: float | None = None,
    is_simulated: bool = False,
) -> Evaluation:
    """Return the samples of a stream in physical units; for parameters that are None, the device's own values are used.

    Args:
        stream: the samples.
        times: of the samples, s.
        window: of the values, on the clock of `times`.
        shunt_ohm: resistance of the shunt, ohm.
        rate_hz: nominal rate, Hz.
        is_simulated: whether a simulated sensor took them.
    """
    hello = stream.hello
    said = stream.sensing or hello
    shunt = shunt_ohm or (said.shunt_ohm if said else 0.0) or DEFAULT_SHUNT
    rate = rate_hz or (float(hello.rate_hz) if hello else 0.0) or DEFAULT_RATE
    calibration = Calibration(shunt)
    current, voltage = calibration.currents(stream.shunt_raw), calibration.voltages(stream.bus_raw)
    troubles, seen = stream.troubles(window, times), within(times, window)
    ranges = Ranges.of(*stream.configurations)
    return Evaluation(
        window=window,
        power=Series(times, array("d", map(mul, current, voltage))),
        quality=quality_of(
            times,
            window,
            rate,
            duplicates=troubles[Trouble.DUPLICATE],
            lost=troubles[Trouble.LOST],
            corrupt=troubles[Trouble.CORRUPT],
            saturated=ranges.count_saturated(stream.shunt_raw[seen], stream.bus_raw[seen]),
        ),
        columns=(
            Column("shunt_raw", stream.shunt_raw, "%d"),
            Column("bus_raw", stream.bus_raw, "%d"),
            Column("current_A", current),
            Column("voltage_V", voltage, "%.3f"),
        ),
        details={
            "shunt_ohm": shunt,
            "rate_hz": rate,
            "restarts": stream.troubles()[Trouble.RESTART],
            "clock_drift": stream.drift,
            "bytes": stream.bytes,
            "line": stream.counts._asdict(),
            "hello": None if stream.hello is None else asdict(stream.hello),
            "sensing": None if stream.sensing is None else asdict(stream.sensing),
        },
        doubts=(*stream_doubts(stream, window, times, voltage), *settings_doubts(stream, shunt, rate)),
        is_simulated=is_simulated,
    )
