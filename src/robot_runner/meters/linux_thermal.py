"""The profiler of the processor's temperature, frequency and throttling."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.measured_machine import THIS_MACHINE, simulation_findings
from robot_runner.measuring.parameter_checks import check_list
from robot_runner.measuring.quality import Column, sufficient
from robot_runner.measuring.series import Series, cut, mean
from robot_runner.meters.machine.machine_state import SystemFiles
from robot_runner.meters.machine.processor_state import (
    HELD_BACK,
    UNDER_VOLTAGE,
    Conditions,
    ProcessorFiles,
    core_number,
    temperature_of,
)
from robot_runner.meters.polled import Meter, PolledProfiler, known_series

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

#: A zone in whole degrees, taken for thousandths, shows less than this, in degC, which a working processor has only
#: for a moment: for less than this share of the samples.
_WHOLE_DEGREES, _A_MOMENT = 0.15, 0.05
_SILENT = "this machine reports neither temperature nor frequency"


class _Processor(Meter[Conditions]):
    """The processor of this machine, without the zones that are asleep or broken at the beginning."""

    def __init__(self, root: Path, zones: Sequence[str] | None) -> None:
        self._system = SystemFiles(root, of="/sys")
        self.files = files = ProcessorFiles(self._system, zones)
        told = zip(files.temperatures, self._system.read_files(files.temperatures), strict=True)
        files.temperatures = [path for path, text in told if temperature_of(text) is not None]
        self._paths = files.changing

    def read(self) -> Conditions:
        return self.files.conditions(dict(zip(self._paths, self._system.read_files(self._paths), strict=True)))


class LinuxThermal(PolledProfiler[Conditions]):
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
        where, machine = f"plugin {self.name}", _Processor(self.root, self.zones).files
        if _is_silent(machine):
            return [Finding.error(where, _SILENT, self._fix(machine))]
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
            Finding.warning(where, f"this machine does not report {measures}: no value") for measures in missing
        ]
        return [*warnings, *simulation_findings(self.name, circumstances.robot)]

    def open(self, context: RobotRunnerContext) -> _Processor:
        """Return the processor; a `PluginError` says that it shows neither temperature nor frequency."""
        del context
        processor = _Processor(self.root, self.zones)
        machine = processor.files
        if _is_silent(machine):
            raise PluginError(_SILENT, where=self.name, fix=self._fix(machine))
        self._cores = list(map(core_number, machine.frequencies))
        zones = [machine.zone_types[path] for path in machine.temperatures]
        self._facts = {"zones": zones, "cores": len(machine.frequencies), "throttle_counters": len(machine.counters)}
        return processor

    def columns(self, sampling: Sampling[Conditions]) -> Sequence[Column]:
        """Return the readings."""
        readings = sampling.readings
        return [
            Column("temperature_degC", [each.temperature for each in readings], "%.3f"),
            Column("frequency_Hz", [each.frequency for each in readings], "%.0f"),
            Column("throttle_count", [each.throttlings for each in readings], "%d"),
            Column(
                "is_held_back", [None if (held := each.is_held_back) is None else int(held) for each in readings], "%d"
            ),
            Column("is_under_voltage", [int(bool(each.is_under_voltage)) for each in readings], "%d"),
            *(
                Column(f"frequency_cpu{core}_Hz", [each.core_frequencies[place] for each in readings], "%.0f")
                for place, core in enumerate(self._cores)
            ),
        ]

    def values(self, sampling: Sampling[Conditions]) -> Mapping[str, float | None]:
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

    def doubts(self, sampling: Sampling[Conditions]) -> Iterable[str]:
        """Yield doubts if the processor was throttled or the voltage too low, or if sensors could not be read."""
        yield from _silences(sampling)
        sampling = sampling.within()
        temperatures = _series(sampling, "temperature").values
        odd = sum(0 < celsius < _WHOLE_DEGREES for celsius in temperatures)
        if odd > _A_MOMENT * len(temperatures):
            low = f"a thermal zone reported temperatures below {_WHOLE_DEGREES} °C"
            yield f"{low} in {odd} of {len(temperatures)} samples: it may report whole degrees, not thousandths"
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

    def _fix(self, machine: ProcessorFiles) -> str:
        kinds = sorted({kind for kind in machine.zone_types.values() if kind})
        if self.zones is not None and kinds:
            return f"Choose zones among: {', '.join(map(repr, kinds))}."
        return "Leave the plugin out: a virtual machine has no thermal zones."


def _is_silent(machine: ProcessorFiles) -> bool:
    return not (machine.temperatures or machine.frequencies)


def _series(sampling: Sampling[Conditions], quantity: str) -> Series:
    return known_series(sampling, attrgetter(quantity))


def _sufficient(sampling: Sampling[Conditions], quantity: str) -> Series:
    """Return one quantity if its values cover enough of the window, else an empty series."""
    return sufficient(_series(sampling, quantity), sampling.window, sampling.rate)


def _silences(sampling: Sampling[Conditions]) -> Iterable[str]:
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


def _held_back(readings: Sequence[Conditions]) -> list[bool]:
    """Return whether the processor was throttled at or just before each reading, of those that show it."""
    held_back, counted, happened = [], math.inf, HELD_BACK
    for each in readings:
        if each.is_held_back is not None or each.throttlings is not None:
            count = counted if each.throttlings is None else each.throttlings
            before, happened = happened, happened if each.happened is None else each.happened
            held_back.append(bool(each.is_held_back or count > counted or happened & ~before & HELD_BACK))
            counted = count
    return held_back
