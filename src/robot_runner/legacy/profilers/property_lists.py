"""Experiment Runner's profilers that write property lists: PowerMetrics (macOS) and PowerLetrics (Linux)."""

from __future__ import annotations

import plistlib
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.legacy.profilers.data_source import CLISource, ParameterDict

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

__all__ = [
    "PLFormatTypes",
    "PLOrderTypes",
    "PMFormatTypes",
    "PMOrderTypes",
    "PMSampleTypes",
    "PowerLetrics",
    "PowerMetrics",
]

_END = b"</plist>"


class PMFormatTypes(StrEnum):
    """How powermetrics writes."""

    PM_FMT_TEXT = "text"
    PM_FMT_PLIST = "plist"


class PMOrderTypes(StrEnum):
    """How powermetrics orders processes."""

    PM_ORDER_PID = "pid"
    PM_ORDER_WAKEUP = "wakeups"
    PM_ORDER_CPU = "cputime"
    PM_ORDER_HYBRID = "composite"


class PMSampleTypes(StrEnum):
    """What powermetrics samples."""

    PM_SAMPLE_TASKS = "tasks"
    PM_SAMPLE_BAT = "battery"
    PM_SAMPLE_NET = "network"
    PM_SAMPLE_DISK = "disk"
    PM_SAMPLE_INT = "interrupts"
    PM_SAMPLE_CPU_POWER = "cpu_power"
    PM_SAMPLE_TEMP = "thermal"
    PM_SAMPLE_SFI = "sfi"
    PM_SAMPLE_GPU_POWER = "gpu_power"
    PM_SAMPLE_AGPM = "gpu_agpm_stats"
    PM_SAMPLE_SMC = "smc"
    PM_SAMPLE_DCC = "gpu_dcc_stats"
    PM_SAMPLE_NVME = "nvme_ssd"
    PM_SAMPLE_THROTTLE = "io_throttle_ssd"


class PLFormatTypes(StrEnum):
    """How powerletrics writes."""

    PL_FMT_TEXT = "text"
    PL_FMT_PLIST = "plist"


class PLOrderTypes(StrEnum):
    """How powerletrics orders processes."""

    PL_ORDER_PID = "pid"
    PL_ORDER_WAKEUP = "wakeups"
    PL_ORDER_CPU = "cputime"
    PL_ORDER_HYBRID = "composite"


# powermetrics(1) of macOS.
_PM_SWITCHES = "--show-initial-usage --show-usage-summary --show-extra-power-info --show-pstates --show-plimits "
_PM_SWITCHES += "--show-cpu-qos --show-cpu-scalability --show-hwp-capability --show-process-coalition "
_PM_SWITCHES += "--show-responsible-pid --show-process-wait-times --show-process-qos-tiers --show-process-io "
_PM_SWITCHES += "--show-process-gpu --show-process-netstats --show-process-qos --show-process-energy "
_PM_SWITCHES += "--show-process-samp-norm --handle-invalid-values --hide-cpu-duty-cycle"


class PowerMetrics(CLISource):
    """Has powermetrics write a property list for each sample."""

    parameters: ClassVar[Any] = ParameterDict(
        {
            ("--poweravg", "-a"): int,
            ("--buffer-size", "-b"): int,
            ("--format", "-f"): PMFormatTypes,
            ("--sample-rate", "-i"): int,
            ("--sample-count", "-n"): int,
            ("--output-file", "-o"): str,
            ("--order", "-r"): PMOrderTypes,
            ("--samplers", "-s"): list,
            ("--wakeup-cost", "-t"): int,
            ("--unhide-info",): list,
            ("--show-all", "-A"): None,
        }
        | dict.fromkeys(_PM_SWITCHES.split())
    )
    source_name: ClassVar[Any] = "powermetrics"
    supported_platforms: ClassVar[Any] = ["Darwin"]

    def __init__(
        self,
        sample_frequency: int = 5000,
        out_file: Path | str = "pm_out.plist",
        additional_args: Mapping[str, Any] | None = None,
        additional_samplers: Sequence[PMSampleTypes] = (),
        hide_cpu_duty_cycle: bool = True,
        order: PMOrderTypes = PMOrderTypes.PM_ORDER_CPU,
    ) -> None:
        super().__init__()
        self.requires_admin = True
        self.logfile = out_file
        samplers = (PMSampleTypes.PM_SAMPLE_CPU_POWER, PMSampleTypes.PM_SAMPLE_GPU_POWER, PMSampleTypes.PM_SAMPLE_AGPM)
        self.args = {
            "--output-file": self._logfile,
            "--sample-rate": sample_frequency,
            "--format": PMFormatTypes.PM_FMT_PLIST,
            "--samplers": [*samplers, *additional_samplers],
            "--order": order,
        }
        if hide_cpu_duty_cycle:
            self.args["--hide-cpu-duty-cycle"] = None
        self.update_parameters(add=additional_args)

    @staticmethod
    def parse_log(logfile: Path | str) -> list[dict[str, Any]]:
        """Return the samples of a log."""
        return _property_lists(Path(logfile).read_bytes().splitlines(keepends=True))

    @staticmethod
    def parse_plist_power(pm_plists: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Return what samples say of power: graphics, processor, time."""
        return [_power_of(sample) for sample in pm_plists]


class PowerLetrics(CLISource):
    """Has powerletrics write a property list for each sample."""

    parameters: ClassVar[Any] = ParameterDict(
        {
            ("-i", "--sample-rate"): int,
            ("-n", "--sample-count"): int,
            ("-o", "--output-file"): str,
            ("-r", "--order"): PLOrderTypes,
            ("-A", "--show-all"): None,
            ("--format",): PLFormatTypes,
            ("-f", "--flush"): None,
            ("-c", "--clear"): None,
            ("-s", "--server"): None,
            ("--port",): int,
            ("--host",): str,
            ("--rapl-sample-rate",): int,
        }
        | dict.fromkeys(
            (
                "--show-process-io",
                "--show-process-netstats",
                "--show-command-line",
                "--short",
                "--proc-memory",
                "--rapl",
                "--psys",
                "--overhead",
                "--thread",
            )
        )
    )
    source_name: ClassVar[Any] = "powerletrics"
    supported_platforms: ClassVar[Any] = ["Linux"]

    def __init__(
        self,
        sample_frequency: int = 1000,
        out_file: Path | str = "pl_out.plist",
        additional_args: Mapping[str, Any] | None = None,
        order: PLOrderTypes = PLOrderTypes.PL_ORDER_CPU,
    ) -> None:
        super().__init__()
        self.requires_admin = True
        self.logfile = out_file
        self.args = {
            "--output-file": self._logfile,
            "--format": PLFormatTypes.PL_FMT_PLIST,
            "--order": order,
            "--sample-rate": sample_frequency,
            "--short": None,
            "--overhead": None,
        }
        self.update_parameters(add=additional_args)

    @staticmethod
    def parse_log(logfile: Path | str) -> list[dict[str, Any]]:
        """Return the samples of a log; its first lines are no property list."""
        return _property_lists(Path(logfile).read_bytes().splitlines(keepends=True)[2:])


def _property_lists(lines: Iterable[bytes]) -> list[dict[str, Any]]:
    """Return the property lists that stand one after another, with a zero byte between them."""
    samples, current = [], b""
    for line in lines:
        current += line.lstrip(b"\0")
        if _END in line:
            samples.append(plistlib.loads(current))
            current = b""
    return samples


def _power_of(sample: Mapping[str, Any]) -> dict[str, Any]:
    power: dict[str, Any] = {name: sample[name] for name in ("agpm_stats", "timestamp") if name in sample}
    if "GPU" in sample:
        left_out = {"misc_counters", "p_states"}
        power["GPU"] = [{name: each[name] for name in each if name not in left_out} for each in sample["GPU"]]
    if "processor" in sample:
        power["processor"] = {name: value for name, value in sample["processor"].items() if name != "packages"}
    return power
