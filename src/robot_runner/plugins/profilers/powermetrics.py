"""powermetrics, which comes with macOS."""

from __future__ import annotations

import plistlib
import signal
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.errors import PluginError
from robot_runner.events.measure import Measure, Origin
from robot_runner.plugins.profilers.command import CommandProfiler
from robot_runner.plugins.profilers.command_output import Aggregate, CommandColumn, Row, TimeColumn, TimeKind
from robot_runner.plugins.profilers.machine import simulation_findings

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robot_runner.errors import Finding
    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["Powermetrics", "parse_powermetrics"]

_NANO = 1e-9
#: Where a Mac tells its power: Apple's processors in mW, Intel's in W.
_APPLE = ("combined_power", 1e-3)
_INTEL = ("package_watts", 1.0)


def parse_powermetrics(records: Sequence[str]) -> list[Row | None]:
    """Return one row for each property list: the seconds that it is about, and power in W.

    Example:
        >>> processor = "<key>processor</key><dict><key>combined_power</key><real>3248.0</real></dict>"
        >>> start = '<plist version="1.0"><dict><key>elapsed_ns</key><integer>1000000000</integer>'
        >>> parse_powermetrics([start + processor + "</dict></plist>"])
        [{'seconds': 1.0, 'power_W': 3.248, 'cpu_W': None, 'gpu_W': None}]
    """
    return [_row(record) for record in records]


def _row(record: str) -> Row | None:
    text = record.strip()
    if not text.endswith("</plist>"):  # nothing, or torn when it was ended
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

    Apple says of its figures that they are estimates, to be compared only between runs on one machine (man
    powermetrics); the values are labelled as estimated.

    Args:
        name: tells several instances apart; the class's name if left out.
        interval_ms: time between two rows, ms.
        command: how it is called, up to its options; powermetrics needs root.

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
    needs: ClassVar[str] = "macOS, and the right to execute `sudo -n powermetrics`."
    bytes_per_run: int = 1_000_000  # a property list a second of 10 kB for a mission of 95 s

    def __init__(
        self,
        *,
        name: str | None = None,
        interval_ms: int = 1000,
        command: Sequence[str] = ("sudo", "-n", "powermetrics"),
    ) -> None:
        if not interval_ms > 0:
            raise PluginError(f"interval_ms is {interval_ms!r}", where=name or "Powermetrics", fix="Give one above 0.")
        energy, power = type(self).measures
        options = [
            "--samplers",
            "cpu_power",
            "--format",
            "plist",
            "--sample-rate",
            str(interval_ms),
            "--buffer-size",
            "0",
        ]
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
        """Return what stands in the way: this is no Mac, or the program is not there."""
        return [*self._missing_programs(*self._programs), *simulation_findings(self.name, circumstances)]
