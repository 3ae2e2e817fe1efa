"""Experiment Runner's profilers that run programs: Ps, PowerJoular, EnergiBridge, PowerMetrics and PowerLetrics.

Each defines its program, the program's parameters, and the file of the samples; `CLISource` starts and stops it.
"""

from __future__ import annotations

import math
import plistlib
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.legacy.profilers.data_source import CLISource, ParameterDict
from robot_runner.legacy.profilers.programs import Table, read_table
from robot_runner.legacy.session import warn_of_run
from robot_runner.meters.command_meters import parse_energibridge

_FORMATS = {"TEXT": "text", "PLIST": "plist"}
_ORDERS = {"PID": "pid", "WAKEUP": "wakeups", "CPU": "cputime", "HYBRID": "composite"}
_SAMPLERS = {
    "TASKS": "tasks",
    "BAT": "battery",
    "NET": "network",
    "DISK": "disk",
    "INT": "interrupts",
    "CPU_POWER": "cpu_power",
    "TEMP": "thermal",
    "SFI": "sfi",
    "GPU_POWER": "gpu_power",
    "AGPM": "gpu_agpm_stats",
    "SMC": "smc",
    "DCC": "gpu_dcc_stats",
    "NVME": "nvme_ssd",
    "THROTTLE": "io_throttle_ssd",
}


def _choices(name: str, prefix: str, values: Mapping[str, str]) -> Any:
    return StrEnum(name, {f"{prefix}{key}": value for key, value in values.items()})


PMFormatTypes = _choices("PMFormatTypes", "PM_FMT_", _FORMATS)
PMOrderTypes = _choices("PMOrderTypes", "PM_ORDER_", _ORDERS)
PMSampleTypes = _choices("PMSampleTypes", "PM_SAMPLE_", _SAMPLERS)
PLFormatTypes = _choices("PLFormatTypes", "PL_FMT_", _FORMATS)
PLOrderTypes = _choices("PLOrderTypes", "PL_ORDER_", _ORDERS)

_KINDS = {"": None, "str": str, "int": int, "list": list}


def _parameters(text: str) -> ParameterDict:
    """Parse parameters from their spellings: `-o|--output:str -g|--gpu`."""
    named = (word.partition(":") for word in text.split())
    return ParameterDict({tuple(spellings.split("|")): _KINDS[kind] for spellings, _, kind in named})


# The manual page of procps-ng's ps(1); letters without a dash are the BSD spellings.
_OF_PS = """
    -A -e -a a -d -N --deselect r T x -F -f f --forest -H -j j -l l -M Z -P s u v X --context --headers --no-headers
    --noheader --signames H -L -m m -T -c c e L n S --cumulative -y -w w
    -C:str -G:str --Group:str -g:str --group:str -p:str p:str --pid:str --ppid:str -q:str q:str --quick-pid:str -s:str
    --sid:str -t:str t:str --tty:str -u:str U:str --user:str -U:str --User:str -D:str -O:str O:str -o:str o:str
    --format:str --cols:str --columns:str --width:str --rows:str --lines:str k:str --sort:str
"""
_OF_ENERGIBRIDGE = """
    -o|--output:str -s|--separator:str -c|--output-command|--command-output:str -i|--interval:int
    -m|--max-execution:int -g|--gpu --summary
"""
# The manual page powermetrics(1) of macOS.
_OF_POWERMETRICS = """
    --poweravg|-a:int --buffer-size|-b:int --format|-f:str --sample-rate|-i:int --sample-count|-n:int
    --output-file|-o:str --order|-r:str --samplers|-s:list --wakeup-cost|-t:int --unhide-info:list --show-all|-A
    --show-initial-usage --show-usage-summary --show-extra-power-info --show-pstates --show-plimits --show-cpu-qos
    --show-cpu-scalability --show-hwp-capability --show-process-coalition --show-responsible-pid
    --show-process-wait-times --show-process-qos-tiers --show-process-io --show-process-gpu --show-process-netstats
    --show-process-qos --show-process-energy --show-process-samp-norm --handle-invalid-values --hide-cpu-duty-cycle
"""
_OF_POWERLETRICS = """
    -i|--sample-rate:int -n|--sample-count:int -o|--output-file:str -r|--order:str -A|--show-all --format:str
    -f|--flush -c|--clear -s|--server --port:int --host:str --rapl-sample-rate:int --show-process-io
    --show-process-netstats --show-command-line --short --proc-memory --rapl --psys --overhead --thread
"""


class Ps(CLISource):
    """Runs `ps` repeatedly, and writes its columns as CSV without a heading.

    `%cpu` of `ps` is the CPU time over the lifetime of the process, not its momentary utilisation.
    """

    parameters: ClassVar[Any] = _parameters(_OF_PS)
    source_name: ClassVar[Any] = "ps"
    supported_platforms: ClassVar[Any] = ["Linux"]

    def __init__(
        self,
        sleep_interval: float = 1,
        out_file: Path | str = "ps.csv",
        additional_args: Mapping[str, Any] | None = None,
        target_pid: Sequence[int] | int | None = None,
        out_format: Sequence[str] = ("%cpu", "%mem"),
    ) -> None:
        super().__init__()
        self.logfile = out_file
        self.sleep_interval = sleep_interval
        self.args = {"--noheader": None, "-o": list(out_format)}
        if target_pid:
            self.update_parameters(add={"-p": [target_pid] if isinstance(target_pid, int) else list(target_pid)})
        self.update_parameters(add=additional_args)

    def _format_cmd(self) -> str:
        output = "" if self.logfile is None else f" >> {shlex.quote(str(self.logfile))}"
        as_csv = f"{super()._format_cmd()} | awk '{{$1=$1}};1' OFS=,{output}"
        return f"sh -c {shlex.quote(f'while :; do {as_csv}; sleep {self.sleep_interval} >/dev/null 2>&1; done')}"

    @staticmethod
    def parse_log(logfile: Path | str, column_names: Sequence[str] | None = None) -> Table:
        """Return the table in a log, with these names of its columns."""
        return read_table(logfile, column_names or ("%cpu", "%mem"))


class PowerJoular(CLISource):
    """Runs PowerJoular, which writes the power of the processor and of one process once a second."""

    parameters: ClassVar[Any] = _parameters("-p:str -a:str -f:str -o:str -m:str -s:str -t -l")
    source_name: ClassVar[Any] = "powerjoular"
    supported_platforms: ClassVar[Any] = ["Linux"]

    def __init__(
        self,
        sample_frequency: int = 5000,
        out_file: Path | str = "powerjoular.csv",
        additional_args: Mapping[str, Any] | None = None,
        target_pid: int | None = None,
    ) -> None:
        super().__init__()
        del sample_frequency  # PowerJoular's rate is fixed
        self.logfile = out_file
        self.args = {"-l": None, "-f": self._logfile}
        if target_pid:
            self.update_parameters(add={"-p": target_pid})
        self.update_parameters(add=additional_args)

    @property
    def target_logfile(self) -> str | None:
        """The file of the samples of one process."""
        return f"{self.logfile}-{self.args['-p']}.csv" if "-p" in self.args else None

    @staticmethod
    def parse_log(logfile: Path | str) -> Table:
        """Return the table in a log."""
        return read_table(logfile)


class EnergiBridge(CLISource):
    """Runs EnergiBridge, which measures while a program runs, or (with `sleep`) until it is stopped."""

    parameters: ClassVar[Any] = _parameters(_OF_ENERGIBRIDGE)
    source_name: ClassVar[Any] = "energibridge"
    supported_platforms: ClassVar[Any] = ["Linux", "Darwin", "Windows"]

    def __init__(
        self,
        sample_frequency: int = 200,
        out_file: Path | str = "energibridge.csv",
        summary: bool = True,
        target_program: str = "sleep 1000000",
        additional_args: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.requires_admin = True
        self.target_program = target_program
        self.logfile = Path(out_file)
        self.args = {"-o": self._logfile, "-i": sample_frequency}
        if summary:
            self.update_parameters(add={"--summary": None})
        self.update_parameters(add=additional_args)

    @property
    def summary(self) -> bool:
        """Whether a summary is requested."""
        return "--summary" in self.args

    @property
    def summary_logfile(self) -> Path | None:
        """The file of the summary, beside the log."""
        if not self.logfile or not {"-o", "--output"} & set(self.args):
            return None
        logfile = Path(self.logfile)
        return logfile.with_name(f"{logfile.name.split('.')[0]}-summary.txt")

    def stop(self, wait: bool = False) -> str:
        """Stop measuring, or `wait` for the program; the summary is written to a file."""
        printed = super().stop(wait)
        if self.summary and self.summary_logfile is not None:
            summary = (printed.strip().splitlines() or [""])[-1]
            if not summary.startswith("Energy consumption"):
                warn_of_run("EnergiBridge gave no summary: it was computed from its log", fix="Measure for longer.")
                summary = self.generate_summary()
            self.summary_logfile.write_text(summary, encoding="utf-8")
        return printed

    def generate_summary(self) -> str:
        """Return a summary computed from the log, which is read as by our own plugin; NaN for missing values."""
        rows = list(filter(None, parse_energibridge(Path(self.logfile).read_text(encoding="utf-8").splitlines())))
        told = [float(joules) for row in rows if (joules := row["energy_J"]) is not None]
        times = [float(row["Time"] or math.nan) for row in rows]
        joules = told[-1] if len(told) > 1 else math.nan
        if math.isnan(joules):
            warn_of_run("the log of EnergiBridge has no energy", fix="See that it may read the processor's registers.")
        seconds = (times[-1] - times[0]) / 1000 if times else math.nan
        return f"Energy consumption in joules: {joules} for {seconds} sec of execution"

    def _format_cmd(self) -> str:
        return f"{super()._format_cmd()} -- {self.target_program}"

    @staticmethod
    def parse_log(logfile: Path | str, summary_logfile: Path | str | None = None) -> Any:
        """Return the table in a log; with a summary, both."""
        log = read_table(logfile)
        if not summary_logfile:
            return log
        text = Path(summary_logfile).read_text(encoding="utf-8")
        numbers = [float(each) for each in re.findall(r"\bnan\b|-?[0-9]+(?:\.[0-9]+)?", text)]
        keys = ("total_joules", "runtime_seconds")
        return log, dict(zip(keys, numbers, strict=True)) if len(numbers) == len(keys) else text


class PowerMetrics(CLISource):
    """Runs powermetrics of macOS, which writes a property list for each sample."""

    parameters: ClassVar[Any] = _parameters(_OF_POWERMETRICS)
    source_name: ClassVar[Any] = "powermetrics"
    supported_platforms: ClassVar[Any] = ["Darwin"]

    def __init__(
        self,
        sample_frequency: int = 5000,
        out_file: Path | str = "pm_out.plist",
        additional_args: Mapping[str, Any] | None = None,
        additional_samplers: Sequence[Any] = (),
        hide_cpu_duty_cycle: bool = True,
        order: Any = PMOrderTypes.PM_ORDER_CPU,
    ) -> None:
        super().__init__()
        self.requires_admin = True
        self.logfile = out_file
        self.args = {
            "--output-file": self._logfile,
            "--sample-rate": sample_frequency,
            "--format": PMFormatTypes.PM_FMT_PLIST,
            "--samplers": ["cpu_power", "gpu_power", "gpu_agpm_stats", *additional_samplers],
            "--order": order,
        }
        if hide_cpu_duty_cycle:
            self.args["--hide-cpu-duty-cycle"] = None
        self.update_parameters(add=additional_args)

    @staticmethod
    def parse_log(logfile: Path | str) -> list[dict[str, Any]]:
        """Return the samples of a log."""
        return _property_lists(Path(logfile).read_bytes())

    @staticmethod
    def parse_plist_power(pm_plists: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Return the power in samples: graphics, processor, time."""
        return [_power_of(sample) for sample in pm_plists]


class PowerLetrics(CLISource):
    """Runs powerletrics, which writes a property list for each sample."""

    parameters: ClassVar[Any] = _parameters(_OF_POWERLETRICS)
    source_name: ClassVar[Any] = "powerletrics"
    supported_platforms: ClassVar[Any] = ["Linux"]

    def __init__(
        self,
        sample_frequency: int = 1000,
        out_file: Path | str = "pl_out.plist",
        additional_args: Mapping[str, Any] | None = None,
        order: Any = PLOrderTypes.PL_ORDER_CPU,
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
        """Return the samples of a log; its first two lines are not part of a property list."""
        return _property_lists(b"".join(Path(logfile).read_bytes().splitlines(keepends=True)[2:]))


def _property_lists(data: bytes) -> list[dict[str, Any]]:
    """Return property lists that are separated by zero bytes; an incomplete one at the end is left out."""
    *whole, _ = data.replace(b"\0", b"").split(_END)
    return [plistlib.loads(each.lstrip() + _END) for each in whole]


_END = b"</plist>"


def _power_of(sample: Mapping[str, Any]) -> dict[str, Any]:
    power: dict[str, Any] = {name: sample[name] for name in ("agpm_stats", "timestamp") if name in sample}
    if "GPU" in sample:
        left_out = {"misc_counters", "p_states"}
        power["GPU"] = [{name: each[name] for name in each if name not in left_out} for each in sample["GPU"]]
    if "processor" in sample:
        power["processor"] = {name: value for name, value in sample["processor"].items() if name != "packages"}
    return power
