"""Programs that measure the energy of this computer: EnergiBridge, PowerJoular, and macOS' powermetrics."""

from __future__ import annotations

import math
import os
import plistlib
import signal
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.measured_machine import THIS_MACHINE, simulation_findings
from robot_runner.measuring.parameter_checks import check_list, check_numbers
from robot_runner.meters.command import CommandProfiler, Measured
from robot_runner.meters.command_output import Aggregate, CommandColumn, Row, TimeColumn, TimeKind, parse_csv
from robot_runner.meters.rapl import POWERCAP, find_domains, permission_findings

#: The measures that are doubted if the energy is of something else; CPU and memory are right then, too.
_OF_ENERGY = ("Energy", "MeanPower")

#: The columns of the processor's energy, in the order of EnergiBridge's own summary (src/main.rs): power in W of
#: Apple's processors, else a counter in J.
_POWERS = ("CPU_POWER (Watts)", "SYSTEM_POWER (Watts)")
_COUNTERS = ("CPU_ENERGY (J)", "PACKAGE_ENERGY (J)")
#: The only power on Macs with Apple's own processors (src/cpu/apple.rs): that of the whole computer.
_WHOLE = "SYSTEM_POWER (Watts)"
#: A counter that falls by more than this share of itself has restarted at 0; its range is a power of two in joules.
_WRAP = 0.5
#: It has wrapped, and was not reset, if no more was drawn until the next row than a computer can draw with its GPUs, W.
_MOST_WATTS = 30e3
_INSTALL = "Build it from https://github.com/tdurieux/EnergiBridge (cargo build -r), and put it on the PATH."


def parse_energibridge(records: Sequence[str]) -> list[Row | None]:
    """Return rows with the time, the energy so far (J), CPU and memory utilisation (%), and the energy's column.

    Example:
        >>> rows = parse_energibridge(["Delta,Time,CPU_ENERGY (J),CPU_USAGE_0", "0,1000,50.0,20", "200,1200,51.5,30"])
        >>> rows[-1]
        {'Time': 1200.0, 'energy_J': 1.5, 'cpu_percent': 30.0, 'memory_percent': None, 'told': 'CPU_ENERGY (J)'}
    """
    rows: list[Row | None] = []
    sooner: Row | None = None
    joules = 0.0
    for row in parse_csv(records):
        if row is not None:
            told = next((name for name in (*_POWERS, *_COUNTERS) if row.get(name)), None)
            if told:
                joules += _joules_between(sooner, row, told) if sooner is not None else 0.0
                sooner = row
            row = {**_summary(row, joules if told else None), "told": told}  # noqa: PLW2901 - the row as it is passed on
        rows.append(row)
    return rows


def _summary(row: Row, joules: float | None) -> Row:
    usages = [float(cell) for name, cell in row.items() if name.startswith("CPU_USAGE_") and cell]
    total, used = float(row.get("TOTAL_MEMORY") or 0), float(row.get("USED_MEMORY") or 0)
    return {
        "Time": float(row["Time"] or math.nan),
        "energy_J": joules,
        "cpu_percent": math.fsum(usages) / len(usages) if usages else None,
        "memory_percent": 100.0 * used / total if total else None,
    }


def _joules_between(sooner: Row, later: Row, name: str) -> float:
    seconds = (float(later["Time"] or 0) - float(sooner["Time"] or 0)) / 1000
    if name in _POWERS:
        return float(later[name] or 0) * seconds
    return _growth(float(sooner.get(name) or 0), float(later[name] or 0), seconds)


def _growth(sooner: float, later: float, seconds: float) -> float:
    """Return by how much a 32-bit counter of 2^-n J grew: its range is the power of two above its last value.

    A counter that fell before it can have reached its range was reset, as by a suspended machine: NaN, as its increase
    is unknown.
    """
    if later >= sooner * _WRAP:
        return later - sooner
    beyond = later - sooner + float(2 ** math.ceil(math.log2(sooner)))
    return beyond if beyond < _MOST_WATTS * seconds else math.nan


class EnergiBridge(CommandProfiler):
    """Measures energy of the processor, CPU and memory utilisation of this machine with EnergiBridge.

    It wraps a program that does nothing but wait; the mission is not its child.

    Args:
        name: distinguishes several instances; None for the class's name.
        interval_ms: time between two rows, ms; its CPU utilisation is right from 200 on.
        program: the program, if it is not on the PATH.
        devices: the folder of the model-specific registers.
        cores: the folder where the kernel shows to which processor each core belongs.

    Raises:
        PluginError: the interval is not positive.

    Example:
        >>> EnergiBridge(interval_ms=500).period_s
        0.5
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", "Energy of the processor over the measured window, by EnergiBridge."),
        Measure("MeanPower", "W", "Energy divided by the duration of the measured window."),
        Measure("CPU", "%", "CPU utilisation of all cores together, mean over the measured window, by EnergiBridge."),
        Measure("Memory", "%", "Physical memory in use, mean over the measured window, by EnergiBridge."),
    )
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "EnergiBridge, and the right to read the processor's registers (/dev/cpu/*/msr)."
    bytes_per_run: int = 300_000  # 5 rows a second of 500 bytes for a mission of 95 s on 8 cores, and the samples

    def __init__(
        self,
        *,
        name: str | None = None,
        interval_ms: int = 200,
        program: str = "energibridge",
        devices: Path = Path("/dev/cpu"),
        cores: Path = Path("/sys/devices/system/cpu"),
    ) -> None:
        check_numbers(name or "EnergiBridge", interval_ms=interval_ms)
        sources = ("energy_J", "energy_J", "cpu_percent", "memory_percent")
        aggregates = (Aggregate.INCREASE, Aggregate.RATE, Aggregate.MEAN, Aggregate.MEAN)
        columns = zip(sources, type(self).measures, aggregates, strict=True)
        super().__init__(
            name=name,
            # `cat` waits for the end of its input, which comes when this process stops it or ends.
            command=[program, "--output", "{output}", "--interval", str(interval_ms), "--", "cat"],
            output="energibridge.csv",
            columns=[CommandColumn(source, measure, aggregate) for source, measure, aggregate in columns],
            parse=parse_energibridge,
            time=TimeColumn("Time", TimeKind.UTC, unit=0.001),
            period_s=interval_ms / 1000,
            stop_signal=signal.SIGINT,
            exit_codes=(0, 1),  # 1 after an interrupt
            install=_INSTALL,
        )
        self.devices = devices
        self.cores = cores

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: the program is missing, or the registers may not be read."""
        findings = [*super().check(circumstances), *simulation_findings(self.name, circumstances.robot)]
        registers = self.devices / "0" / "msr"
        if sys.platform == "linux" and not os.access(registers, os.R_OK):
            fix = "Give the right: sudo modprobe msr; sudo chgrp -R msr /dev/cpu/*/msr; sudo chmod g+r /dev/cpu/*/msr."
            findings.append(Finding.error(f"plugin {self.name}", f"{registers} cannot be read", fix))
        return findings

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the values, with a doubt where the energy is not the processor's, or not that of all processors."""
        told = {row["told"] for row in self._measured.rows} if self._measured is not None else set()
        if _WHOLE in told:
            problem = f"the power is that of the whole computer ({_WHOLE}): this Mac reports none of its processor"
            context.doubt(problem, fix="Compare it with such values only, or use Powermetrics.", measures=_OF_ENERGY)
        # EnergiBridge reads the registers of core 0, and on AMD's processors those of further cores, of which the last
        # processor remains in the output (src/cpu/*.rs).
        processors = {
            file.read_text(encoding="ascii") for file in self.cores.glob("cpu[0-9]*/topology/physical_package_id")
        }
        if len(processors) > 1 and told.intersection(_COUNTERS):
            problem = f"EnergiBridge reads one processor, and this machine has {len(processors)}"
            context.doubt(problem, fix="Use Rapl, which adds them up.", measures=_OF_ENERGY)
        super().populate_run_data(context)


_POWER, _GPU_POWER = "Total Power", "GPU Power"
_USE_RAPL = "Use Rapl, which measures all packages and nothing else."
_POWERJOULAR_INSTALL = "Build it from https://github.com/joular/powerjoular, and put it on the PATH."
#: Boards whose device tree has a model: their power is the result of a regression model (PowerJoular's README).
_BOARD = Path("/proc/device-tree/model")


def parse_powerjoular(records: Sequence[str]) -> list[Row | None]:
    """Return the rows; a power of exactly 0 is missing: PowerJoular writes it if it found nothing to measure.

    Example:
        >>> parse_powerjoular(["Date,CPU Utilization,Total Power", "2026-01-01 10:00:00,0.5,0.00000000000000"])[1]
        {'Date': '2026-01-01 10:00:00', 'CPU Utilization': '0.5', 'Total Power': None}
    """
    return [row and {**row, _POWER: _possible(row.get(_POWER) or 0)} for row in parse_csv(records)]


def _possible(watts: str | float) -> str | float | None:
    """Return a power; a text instead if a counter wrapped, which versions before 1.1.1 do not handle, or was reset."""
    if not float(watts):
        return None
    return watts if 0 < float(watts) < _MOST_WATTS else f"{watts} W, which no computer draws"


class PowerJoular(CommandProfiler):
    """Measures power of the processor (and of an NVIDIA GPU) of this machine with PowerJoular, once a second.

    The processor is package 0, with the memory where that is its third domain. On a machine with a counter of the whole
    platform (psys), as many laptops have, the power is the platform's, and doubted. On a Raspberry Pi or an Asus Tinker
    Board, PowerJoular estimates from CPU utilisation by a regression model; there the values are labelled as estimated.

    Args:
        name: distinguishes several instances; None for the class's name.
        program: the program, if it is not on the PATH.
        arguments: further arguments, such as `["-l"]` for its linear models.
        powercap: the folder of the processor's energy counters.
        board: the file that names the model of a board.

    Example:
        >>> PowerJoular().measures[0].unit
        'J'
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", "Energy of the processor and GPU over the measured window, by PowerJoular."),
        Measure("MeanPower", "W", "Power of the processor and GPU, mean over the measured window, by PowerJoular."),
        Measure("CPU", "%", "CPU utilisation of all cores together, mean over the measured window, by PowerJoular."),
    )
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "PowerJoular, and the right to read /sys/class/powercap (PC) or a supported board."
    bytes_per_run: int = 20_000  # a row a second of 100 bytes for a mission of 95 s, and the samples

    def __init__(
        self,
        *,
        name: str | None = None,
        program: str = "powerjoular",
        arguments: Sequence[str] = (),
        powercap: Path = POWERCAP,
        board: Path = _BOARD,
    ) -> None:
        check_list(name or "PowerJoular", arguments=arguments)
        energy, power, cpu = type(self).measures
        super().__init__(
            name=name,
            command=[program, "-f", "{output}", *arguments],
            output="powerjoular.csv",
            columns=[
                CommandColumn(_POWER, energy, Aggregate.INTEGRAL),
                CommandColumn(_POWER, power, Aggregate.MEAN),
                CommandColumn("CPU Utilization", cpu, Aggregate.MEAN, factor=100.0),
            ],
            parse=parse_powerjoular,
            period_s=1.0,
            stop_signal=signal.SIGINT,
            origin=Origin.ESTIMATED if board.exists() else Origin.MEASURED,
            install=_POWERJOULAR_INSTALL,
        )
        self.powercap = powercap

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: the program is missing, or has no counters that it may read, so that it would write 0 W."""
        findings = [*super().check(circumstances), *simulation_findings(self.name, circumstances.robot)]
        if self.origin is Origin.MEASURED and "-m" not in self.command:
            findings += permission_findings(self.name, self.powercap, ("package",))
        where = f"plugin {self.name}"
        return [*findings, *(Finding.warning(where, problem, _USE_RAPL) for problem in self._misread())]

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the values, with a doubt where the energy is of another part, or lacks processors or the GPU."""
        for problem in self._misread() if self._measured is not None else ():
            context.doubt(problem, fix=_USE_RAPL, measures=_OF_ENERGY)
        rows = self._measured.rows if self._measured is not None else ()
        powers = CommandColumn(_GPU_POWER, self.measures[1]).values(rows)
        if any(powers) and (silent := powers.count(0.0)):
            # PowerJoular adds 0 W if nvidia-smi fails, or has no number for one of several GPUs (src/nvidia_smi.adb).
            problem = f"the GPU reported no power in {silent} of {len(powers)} rows, which lack it"
            context.doubt(problem, fix="Check what `nvidia-smi` says.", measures=_OF_ENERGY)
        super().populate_run_data(context)

    def _misread(self) -> list[str]:
        """Return problems where PowerJoular reads another counter than expected (src/intel_rapl_sysfs.adb)."""
        try:
            kinds = [domain.kind for domain in find_domains(self.powercap)]
            second = self.powercap / "intel-rapl:1" / "name"
            is_platform = second.exists() and second.read_text(encoding="ascii").strip() == "psys"
        except (OSError, PluginError):
            return []
        if self.origin is not Origin.MEASURED or "-m" in self.command:
            return []
        if is_platform:
            return ["PowerJoular reads the counter of the whole platform (psys) on this machine, not the processor's"]
        packages = kinds.count("package")
        told = f"PowerJoular reads package-0 alone, and this machine has {packages} packages"
        return [told] if packages > 1 else []

    def doubts(self, measured: Measured) -> Iterable[str]:
        """Yield doubts, also that PowerJoular found nothing to measure."""
        yield from super().doubts(measured)
        silent = sum(row.get(_POWER, "") is None for row in measured.rows)
        if silent:
            rows = f"{silent} of {len(measured.rows)} rows"
            yield f"PowerJoular reported 0 W in {rows}: it found no energy counter to read"


_NANO = 1e-9
#: The keys of a Mac's power: for Apple's processors in mW, for Intel's in W.
_APPLE = ("combined_power", 1e-3)
_INTEL = ("package_watts", 1.0)


def parse_powermetrics(records: Sequence[str]) -> list[Row | None]:
    """Return one row for each property list: the seconds that it covers, and power in W.

    Example:
        >>> processor = "<key>processor</key><dict><key>combined_power</key><real>3248.0</real></dict>"
        >>> start = '<plist version="1.0"><dict><key>elapsed_ns</key><integer>1000000000</integer>'
        >>> parse_powermetrics([start + processor + "</dict></plist>"])
        [{'seconds': 1.0, 'power_W': 3.248, 'cpu_W': None, 'gpu_W': None}]
    """
    return [_row(record) for record in records]


def _row(record: str) -> Row | None:
    text = record.strip()
    if not text.endswith("</plist>"):  # empty, or cut off when powermetrics was ended
        return None
    document: dict[str, Any] = plistlib.loads(text.encode())
    processor: dict[str, Any] = document.get("processor", {})
    name, unit = _APPLE if _APPLE[0] in processor else _INTEL
    cpu, gpu = processor.get("cpu_power"), processor.get("gpu_power")
    return {
        "seconds": float(document["elapsed_ns"]) * _NANO,
        "power_W": float(processor[name]) * unit if name in processor else None,
        "cpu_W": None if cpu is None else float(cpu) * _APPLE[1],
        "gpu_W": None if gpu is None else float(gpu) * _APPLE[1],
    }


class Powermetrics(CommandProfiler):
    """Measures power of the processor of this Mac with Apple's powermetrics.

    According to Apple these figures are estimates, which can be compared only between runs on one machine (man
    powermetrics); the values are labelled as estimated.

    Args:
        name: distinguishes several instances; None for the class's name.
        interval_ms: time between two rows, ms.
        command: the command without its options; powermetrics needs root.

    Raises:
        PluginError: the interval is not positive.

    Example:
        >>> Powermetrics(interval_ms=500).period_s
        0.5
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", "Energy of the processor over the measured window, estimated by powermetrics."),
        Measure("MeanPower", "W", "Power of the processor, mean over the measured window, estimated by powermetrics."),
    )
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "macOS, and the right to execute `sudo -n powermetrics`."
    bytes_per_run: int = 1_000_000  # a property list a second of 10 kB for a mission of 95 s

    def __init__(
        self,
        *,
        name: str | None = None,
        interval_ms: int = 1000,
        command: Sequence[str] = ("sudo", "-n", "powermetrics"),
    ) -> None:
        check_numbers(name or "Powermetrics", interval_ms=interval_ms)
        check_list(name or "Powermetrics", command=command)
        energy, power = type(self).measures
        options = f"--samplers cpu_power --format plist --sample-rate {interval_ms} --buffer-size 0".split()
        super().__init__(
            name=name,
            command=[*command, *options, "--output-file", "{output}"],
            output="powermetrics.plist",
            columns=[
                CommandColumn("power_W", energy, Aggregate.INTEGRAL),
                CommandColumn("power_W", power, Aggregate.MEAN),
            ],
            parse=parse_powermetrics,
            separator="\0",
            time=TimeColumn("seconds", TimeKind.SPAN),
            period_s=interval_ms / 1000,
            stop_signal=signal.SIGINT,
            origin=Origin.ESTIMATED,
            install="Use it on macOS, where it comes with the system.",
        )
        self._programs = [word for word in command if not word.startswith("-")]

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: this is not a Mac, or the program is missing."""
        return [*self._missing_programs(*self._programs), *simulation_findings(self.name, circumstances.robot)]
