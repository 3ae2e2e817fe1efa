"""The profiler of the processor's temperature, frequency and throttling."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.measured_machine import THIS_MACHINE, simulation_findings
from robot_runner.measuring.quality import Column, sufficient
from robot_runner.measuring.series import Series, cut, mean
from robot_runner.meters.machine.machine_state import (
    EVER,
    FIRMWARE,
    HELD_BACK,
    OVER_CURRENTS,
    PROCESSOR_COOLERS,
    UNDER_VOLTAGE,
    is_measured,
    is_plausible,
    text_in,
)
from robot_runner.meters.parameter_checks import check_list
from robot_runner.meters.polled import Meter, PolledProfiler, known_series

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

_MILLI = 1e-3
_KILO = 1e3
#: The drivers of AMD's processors, whose temperature is in hwmon and no zone (Linux, Documentation/hwmon/k10temp.rst).
_NO_ZONES = ("k10temp", "zenpower")
#: A zone in whole degrees, taken for thousandths, shows less than this, in degC, which a working processor has only
#: for a moment: for less than this share of the samples.
_WHOLE_DEGREES, _A_MOMENT = 0.15, 0.05


@dataclass(frozen=True, slots=True)
class ThermalReading:
    """The state of the processor at one moment; None for what the machine does not show.

    Attributes:
        temperature: of the hottest zone, degC.
        frequency: mean over the cores, Hz.
        core_frequencies: of each core, Hz, in the order of their numbers; None for a core without one.
        silent_zones: how many zones could not be read.
        throttle_count: how often it was throttled since the machine started; None where a core has no counter.
        is_held_back: whether the kernel or the firmware throttles it now.
        is_under_voltage: whether the supply voltage is too low now.
        happened: the firmware's flags of earlier events, at the bits of the current ones; None where there are none.
    """

    temperature: float | None
    frequency: float | None
    throttle_count: int | None
    is_held_back: bool | None
    is_under_voltage: bool = False
    core_frequencies: tuple[float | None, ...] = ()
    silent_zones: int = 0
    happened: int | None = None


class _Machine(Meter[ThermalReading]):
    """The files of a machine with temperature, frequency and throttling, as far as it has them."""

    def __init__(self, root: Path, zones: Sequence[str] | None) -> None:
        thermal, cpus = root / "class" / "thermal", root / "devices" / "system" / "cpu"
        self.zone_types = {path / "temp": text_in(path / "type") for path in sorted(thermal.glob("thermal_zone*"))}
        chips = {path: text_in(path / "name") for path in sorted((root / "class" / "hwmon").glob("hwmon*"))}
        self.zone_types |= {path / "temp1_input": chip for path, chip in chips.items() if chip in _NO_ZONES}
        chosen = [
            path for path, kind in self.zone_types.items() if (is_measured(kind) if zones is None else kind in zones)
        ]
        self.temperatures = [path for path in chosen if _temperature(path) is not None]
        self.frequencies = sorted(cpus.glob("cpu[0-9]*/cpufreq/scaling_cur_freq"), key=_core_number)
        self.counters = sorted(cpus.glob("cpu[0-9]*/thermal_throttle/*_throttle_count"))
        self.counters += sorted(root.glob(OVER_CURRENTS.removeprefix("/sys/")))
        coolers = sorted(thermal.glob("cooling_device*"))
        self.coolers = [each / "cur_state" for each in coolers if text_in(each / "type").startswith(PROCESSOR_COOLERS)]
        self.firmware = sorted(root.glob(FIRMWARE.removeprefix("/sys/")))

    @property
    def tells_of_throttling(self) -> bool:
        return bool(self.counters or self.coolers or self.firmware)

    def read(self) -> ThermalReading:
        told = [_temperature(path) for path in self.temperatures]
        temperatures = [celsius for celsius in told if celsius is not None]
        clocks = [_number(path) for path in self.frequencies]
        frequencies = [clock for clock in clocks if clock]
        counts = _numbers(self.counters)
        states = _numbers(self.coolers)
        flags = [int(text, 16) for path in self.firmware if (text := text_in(path))]
        tells = bool(states or flags)
        return ThermalReading(
            temperature=max(temperatures, default=None),
            frequency=math.fsum(frequencies) / len(frequencies) * _KILO if frequencies else None,
            # If a core is switched off, the sum would fall without its counters, and rise when it comes back.
            throttle_count=int(sum(counts)) if counts and len(counts) == len(self.counters) else None,
            is_held_back=any(state > 0 for state in states) or any(flag & HELD_BACK for flag in flags)
            if tells
            else None,
            is_under_voltage=any(flag & UNDER_VOLTAGE for flag in flags),
            core_frequencies=tuple(clock * _KILO if clock else None for clock in clocks),
            silent_zones=len(self.temperatures) - len(temperatures),
            happened=max((flag >> EVER for flag in flags), default=None),
        )


def _core_number(path: Path) -> int:
    return int(path.parents[1].name.removeprefix("cpu"))


def _number(path: Path) -> float | None:
    """Return the number in a file; None if it cannot be read, as when a sensor is asleep or gone."""
    with suppress(ValueError):
        return float(text_in(path))
    return None


def _temperature(path: Path) -> float | None:
    """Return the temperature of a zone, degC; None if it is asleep, gone or broken."""
    number = _number(path)
    return number * _MILLI if number is not None and is_plausible(number * _MILLI) else None


def _numbers(paths: Sequence[Path]) -> list[float]:
    return [number for path in paths if (number := _number(path)) is not None]


class LinuxThermal(PolledProfiler[ThermalReading]):
    """Measures temperature and frequency of the processor of this machine, and warns of throttling.

    If the processor was throttled for heat or undervoltage, the run cannot be compared with others.

    Args:
        name: distinguishes several instances; None for the class's name.
        zones: the types of the thermal zones to read, such as `x86_pkg_temp` or `cpu-thermal` (of AMD's processors the
            driver, `k10temp`); None for all that measure something.
        rate_hz: readings a second, Hz.
        root: the folder of sysfs.

    Raises:
        PluginError: the rate is not positive.

    Example:
        >>> LinuxThermal(zones=["cpu-thermal"]).measures[0].unit
        '°C'
    """

    measures: Sequence[Measure] = (
        Measure(
            "MaxTemperature",
            "°C",
            "Temperature of the hottest zone, maximum over the measured window.",
            over=Over.MAXIMUM,
        ),
        Measure(
            "MeanTemperature", "°C", "Temperature of the hottest zone, mean over the measured window.", over=Over.MEAN
        ),
        Measure(
            "MeanFrequency",
            "Hz",
            "Frequency of the processor, mean over its cores and the measured window.",
            over=Over.MEAN,
        ),
        Measure(
            "Throttled",
            "%",
            "Share of the samples in which the processor was held back, or had just been.",
            over=Over.MEAN,
        ),
    )
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "Linux with thermal zones or cpufreq in /sys."
    bytes_per_run: int = 10_000  # 2 readings a second of 40 bytes for a mission of 95 s

    def __init__(
        self,
        *,
        name: str | None = None,
        zones: Sequence[str] | None = None,
        rate_hz: float = 2.0,
        root: str | Path = "/sys",
    ) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        check_list(self.name, zones=() if zones is None else zones)
        self.zones = None if zones is None else tuple(zones)
        self.root = Path(root)
        self._facts: Mapping[str, Any] = {}
        self._cores: Sequence[int] = ()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors, and warnings of measures that will be missing on this machine."""
        where, machine = f"plugin {self.name}", _Machine(self.root, self.zones)
        problem = self._nothing(machine)
        if problem:
            return [Finding.error(where, problem, self._fix(machine))]
        missing = [
            measures
            for there, measures in (
                (machine.temperatures, "MaxTemperature and MeanTemperature"),
                (machine.frequencies, "MeanFrequency"),
                (machine.tells_of_throttling, "Throttled"),
            )
            if not there
        ]
        warnings = [
            Finding.warning(where, f"this machine does not tell of {measures}: no value") for measures in missing
        ]
        return [*warnings, *simulation_findings(self.name, circumstances.robot)]

    def open(self, context: RobotRunnerContext) -> _Machine:
        """Return the machine's files.

        Raises:
            PluginError: they show neither temperature nor frequency.
        """
        del context
        machine = _Machine(self.root, self.zones)
        problem = self._nothing(machine)
        if problem:
            raise PluginError(problem, where=self.name, fix=self._fix(machine))
        self._cores = list(map(_core_number, machine.frequencies))
        zones = [machine.zone_types[path] for path in machine.temperatures]
        self._facts = {"zones": zones, "cores": len(machine.frequencies), "throttle_counters": len(machine.counters)}
        return machine

    def columns(self, sampling: Sampling[ThermalReading]) -> Sequence[Column]:
        """Return the readings."""
        readings = sampling.readings
        return [
            Column("temperature_degC", [each.temperature for each in readings], "%.3f"),
            Column("frequency_Hz", [each.frequency for each in readings], "%.0f"),
            Column("throttle_count", [each.throttle_count for each in readings], "%d"),
            Column(
                "is_held_back", [None if (held := each.is_held_back) is None else int(held) for each in readings], "%d"
            ),
            Column("is_under_voltage", [int(each.is_under_voltage) for each in readings], "%d"),
            *(
                Column(f"frequency_cpu{core}_Hz", [each.core_frequencies[place] for each in readings], "%.0f")
                for place, core in enumerate(self._cores)
            ),
        ]

    def values(self, sampling: Sampling[ThermalReading]) -> Mapping[str, float | None]:
        """Return the means and the maximum, and the share of the time in which the processor was throttled."""
        reach = 5 / self.rate_hz
        temperature = cut(_sufficient(sampling, "temperature"), sampling.window, reach=reach)
        held_back = _held_back(sampling.within().readings)
        return {
            "MaxTemperature": max(temperature.values, default=None),
            "MeanTemperature": mean(temperature),
            "MeanFrequency": mean(cut(_sufficient(sampling, "frequency"), sampling.window, reach=reach)),
            "Throttled": 100.0 * sum(held_back) / len(held_back) if held_back else None,
        }

    def doubts(self, sampling: Sampling[ThermalReading]) -> Iterable[str]:
        """Yield doubts if the processor was throttled or the voltage too low, or if sensors could not be read."""
        yield from _silences(sampling)
        sampling = sampling.within()
        temperatures = _series(sampling, "temperature").values
        odd = sum(0 < celsius < _WHOLE_DEGREES for celsius in temperatures)
        if odd > _A_MOMENT * len(temperatures):
            yield (
                f"a thermal zone reported temperatures below {_WHOLE_DEGREES} °C in {odd} of {len(temperatures)} "
                "samples: it may tell whole degrees, not thousandths"
            )
        held_back = _held_back(sampling.readings)
        if any(held_back):
            hottest = max(temperatures, default=None)
            at = "" if hottest is None else f", at up to {hottest:.0f} °C"
            yield f"the processor was held back in {sum(held_back)} of {len(held_back)} samples{at}"
        happened = [reading.happened for reading in sampling.readings if reading.happened is not None]
        is_new = any(later & ~sooner & UNDER_VOLTAGE for sooner, later in pairwise(happened))
        if is_new or any(reading.is_under_voltage for reading in sampling.readings):
            yield "the supply voltage of the computer was too low for a time"

    def details(self) -> Mapping[str, Any]:
        """Return the zones and files that were read."""
        return self._facts

    @staticmethod
    def _nothing(machine: _Machine) -> str:
        is_silent = not (machine.temperatures or machine.frequencies)
        return "this machine tells neither of temperature nor of frequency" if is_silent else ""

    def _fix(self, machine: _Machine) -> str:
        kinds = sorted({kind for kind in machine.zone_types.values() if kind})
        if self.zones is not None and kinds:
            return f"Choose zones among: {', '.join(map(repr, kinds))}."
        return "Leave the plugin out: a virtual machine has no thermal zones."


def _series(sampling: Sampling[ThermalReading], quantity: str) -> Series:
    return known_series(sampling, attrgetter(quantity))


def _sufficient(sampling: Sampling[ThermalReading], quantity: str) -> Series:
    """Return one quantity if its values cover enough of the window, else an empty series."""
    return sufficient(_series(sampling, quantity), sampling.window, sampling.rate)


def _silences(sampling: Sampling[ThermalReading]) -> Iterable[str]:
    within = sampling.within()
    silent = sum(reading.silent_zones > 0 for reading in within.readings)
    if silent:
        yield (
            f"a thermal zone could not be read in {silent} of {len(within.readings)} samples: where it is the hottest, "
            "the temperatures are too low"
        )
    for quantity in ("temperature", "frequency"):
        told = len(_series(within, quantity))
        if told and not len(_sufficient(sampling, quantity)):
            yield f"the {quantity} was reported in {told} of {len(within.readings)} samples only: no value"


def _held_back(readings: Sequence[ThermalReading]) -> list[bool]:
    """Return whether the processor was throttled at or just before each reading, of those that show it."""
    held_back, counted, happened = [], math.inf, HELD_BACK
    for each in readings:
        if each.is_held_back is not None or each.throttle_count is not None:
            count = counted if each.throttle_count is None else each.throttle_count
            before, happened = happened, happened if each.happened is None else each.happened
            held_back.append(bool(each.is_held_back or count > counted or happened & ~before & HELD_BACK))
            counted = count
    return held_back
