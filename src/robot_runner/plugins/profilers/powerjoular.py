"""PowerJoular, a command-line meter for PCs, servers and Raspberry Pis."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from robot_runner.events.measure import Measure, Origin
from robot_runner.plugins.profilers.command import CommandProfiler, Measured
from robot_runner.plugins.profilers.command_output import Aggregate, CommandColumn, Row, parse_csv
from robot_runner.plugins.profilers.machine import simulation_findings
from robot_runner.plugins.profilers.rapl import POWERCAP, permission_findings

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robot_runner.errors import Finding
    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["PowerJoular", "parse_powerjoular"]

_POWER = "Total Power"
_INSTALL = "Build it from https://github.com/joular/powerjoular, and put it on the PATH."
#: Boards whose device tree has a model: their power is the result of a regression model (PowerJoular's README).
_BOARD = Path("/proc/device-tree/model")


def parse_powerjoular(records: Sequence[str]) -> list[Row | None]:
    """Return the rows. A power of exactly 0 is what PowerJoular writes where it found nothing to measure: no value.

    Example:
        >>> parse_powerjoular(["Date,CPU Utilization,Total Power", "2026-01-01 10:00:00,0.5,0.00000000000000"])[1]
        {'Date': '2026-01-01 10:00:00', 'CPU Utilization': '0.5', 'Total Power': None}
    """
    rows = parse_csv(records)
    return [row if row is None or float(row.get(_POWER) or 0) else {**row, _POWER: None} for row in rows]


class PowerJoular(CommandProfiler):
    """Measures power of the processor (and of an NVIDIA GPU) of this machine with PowerJoular, once a second.

    On a Raspberry Pi or an Asus Tinker Board, PowerJoular estimates from CPU utilisation by a regression model; there
    the values are labelled as estimated.

    Args:
        name: tells several instances apart; the class's name if left out.
        program: the program, if it is not on the PATH.
        arguments: further arguments, such as `["-l"]` for its linear models.
        powercap: where the energy counters of the processor are.
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
            install=_INSTALL,
        )
        self.powercap = powercap

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no program, or no counters that it could read, so that it would say 0 W."""
        findings = [*super().check(circumstances), *simulation_findings(self.name, circumstances)]
        if self.origin is Origin.MEASURED and "-m" not in self.command:
            findings += permission_findings(self.name, self.powercap, ("package",))
        return findings

    def doubts(self, measured: Measured) -> Iterable[str]:
        """Yield what is doubtful, and that it found nothing to measure."""
        yield from super().doubts(measured)
        silent = sum(row.get(_POWER, "") is None for row in measured.rows)
        if silent:
            yield f"PowerJoular said 0 W in {silent} of {len(measured.rows)} rows: it found no energy counter to read"
