"""EnergiBridge, a command-line meter for the processors of Intel, AMD and Apple."""

from __future__ import annotations

import math
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from robot_runner.errors import Finding, PluginError
from robot_runner.events.measure import Measure
from robot_runner.plugins.profilers.command import CommandProfiler
from robot_runner.plugins.profilers.command_output import (
    Aggregate,
    CommandColumn,
    Row,
    TimeColumn,
    TimeKind,
    parse_csv,
)
from robot_runner.plugins.profilers.machine import simulation_findings

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["EnergiBridge", "parse_energibridge"]

#: Where the energy of the processor is, in the order of EnergiBridge's own summary (src/main.rs): power in W of Apple's
#: processors, else a counter in J.
_POWERS = ("CPU_POWER (Watts)", "SYSTEM_POWER (Watts)")
_COUNTERS = ("CPU_ENERGY (J)", "PACKAGE_ENERGY (J)")
#: A counter that falls by more than this share of itself has begun at 0 again; its range is a power of two in joules.
_WRAP = 0.5
_INSTALL = "Build it from https://github.com/tdurieux/EnergiBridge (cargo build -r), and put it on the PATH."


def parse_energibridge(records: Sequence[str]) -> list[Row | None]:
    """Return rows with the time, the energy so far (J), and CPU and memory utilisation (%).

    Example:
        >>> rows = parse_energibridge(["Delta,Time,CPU_ENERGY (J),CPU_USAGE_0", "0,1000,50.0,20", "200,1200,51.5,30"])
        >>> rows[-1]
        {'Time': 1200.0, 'energy_J': 1.5, 'cpu_percent': 30.0, 'memory_percent': None}
    """
    rows: list[Row | None] = []
    sooner: Row | None = None
    joules = 0.0
    for row in parse_csv(records):
        if row is not None:
            joules += _joules_between(sooner, row) if sooner is not None else 0.0
            sooner = row
            row = _summary(row, joules)  # noqa: PLW2901 - the row as it is passed on
        rows.append(row)
    return rows


def _summary(row: Row, joules: float) -> Row:
    usages = [float(cell) for name, cell in row.items() if name.startswith("CPU_USAGE_") and cell]
    total, used = float(row.get("TOTAL_MEMORY") or 0), float(row.get("USED_MEMORY") or 0)
    has_energy = any(name in row for name in (*_POWERS, *_COUNTERS))
    return {
        "Time": float(row["Time"] or math.nan),
        "energy_J": joules if has_energy else None,
        "cpu_percent": math.fsum(usages) / len(usages) if usages else None,
        "memory_percent": 100.0 * used / total if total else None,
    }


def _joules_between(sooner: Row, later: Row) -> float:
    for name in _POWERS:
        if later.get(name):
            seconds = (float(later["Time"] or 0) - float(sooner["Time"] or 0)) / 1000
            return float(later[name] or 0) * seconds
    for name in _COUNTERS:
        if later.get(name):
            return _growth(float(sooner.get(name) or 0), float(later[name] or 0))
    return 0.0


def _growth(sooner: float, later: float) -> float:
    """Return by how much a 32-bit counter of 2^-n J grew: its range is the power of two above what it last showed."""
    if later >= sooner * _WRAP:
        return later - sooner
    return later - sooner + float(2 ** math.ceil(math.log2(sooner)))


class EnergiBridge(CommandProfiler):
    """Measures energy of the processor, CPU and memory utilisation of this machine with EnergiBridge.

    It wraps a program that does nothing but wait; the mission is not its child.

    Args:
        name: tells several instances apart; the class's name if left out.
        interval_ms: time between two rows, ms; at least 200 for its CPU utilisation to be true.
        program: the program, if it is not on the PATH.
        devices: where the model-specific registers are.

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
    needs: ClassVar[str] = "EnergiBridge, and the right to read the processor's registers (/dev/cpu/*/msr)."
    bytes_per_run: int = 300_000  # 5 rows a second of 500 bytes for a mission of 95 s on 8 cores, and the samples

    def __init__(
        self,
        *,
        name: str | None = None,
        interval_ms: int = 200,
        program: str = "energibridge",
        devices: Path = Path("/dev/cpu"),
    ) -> None:
        if not interval_ms > 0:
            raise PluginError(f"interval_ms is {interval_ms!r}", where=name or "EnergiBridge", fix="Give one above 0.")
        sources = ("energy_J", "energy_J", "cpu_percent", "memory_percent")
        aggregates = (Aggregate.INCREASE, Aggregate.RATE, Aggregate.MEAN, Aggregate.MEAN)
        columns = zip(sources, type(self).measures, aggregates, strict=True)
        super().__init__(
            name=name,
            # `cat` waits for the end of its input, which comes when we stop or die.
            command=[program, "--output", "{output}", "--interval", str(interval_ms), "--", "cat"],
            output="energibridge.csv",
            columns=[CommandColumn(source, measure, aggregate) for source, measure, aggregate in columns],
            parse=parse_energibridge,
            time=TimeColumn("Time", TimeKind.UTC, unit=0.001),
            period_s=interval_ms / 1000,
            stop_signal=signal.SIGINT,
            exit_codes=(0, 1),  # it ends with 1 when it was interrupted
            install=_INSTALL,
        )
        self.devices = devices

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no program, or no right to read the registers."""
        findings = [*super().check(circumstances), *simulation_findings(self.name, circumstances)]
        registers = self.devices / "0" / "msr"
        if sys.platform == "linux" and not os.access(registers, os.R_OK):
            fix = "Give the right: sudo modprobe msr; sudo chgrp -R msr /dev/cpu/*/msr; sudo chmod g+r /dev/cpu/*/msr."
            findings.append(Finding.error(f"plugin {self.name}", f"{registers} cannot be read", fix))
        return findings
