"""Experiment Runner's profilers that are programs of the command line: Ps, PowerJoular, EnergiBridge."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.legacy.profilers.data_source import CLISource, ParameterDict
from robot_runner.legacy.profilers.programs import Table, read_table
from robot_runner.legacy.session import warn_of_run

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["EnergiBridge", "PowerJoular", "Ps"]

# The manual page of procps-ng's ps(1); letters without a dash are the BSD spellings.
_PS_FLAGS = "-A -e -a a -d -N --deselect r T x -F -f f --forest -H -j j -l l -M Z -P s u v X --context --headers "
_PS_FLAGS += "--no-headers --noheader --signames H -L -m m -T -c c e L n S --cumulative -y -w w"
_PS_VALUES = "-C -G --Group -g --group -p p --pid --ppid -q q --quick-pid -s --sid -t t --tty -u U --user -U --User "
_PS_VALUES += "-D -O O -o o --format --cols --columns --width --rows --lines k --sort"

_NUMBER = re.compile(r"[0-9]+(?:\.[0-9]+)?")


class Ps(CLISource):
    """Asks `ps` again and again, and writes its columns as CSV without a heading.

    `%cpu` of `ps` is the time on the processor over the life of the process, not its utilisation at a moment.
    """

    parameters: ClassVar[Any] = ParameterDict(dict.fromkeys(_PS_FLAGS.split()) | dict.fromkeys(_PS_VALUES.split(), str))
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
        as_csv = "awk '{$1=$1};1' OFS=,"
        loop = (
            f"while :; do {super()._format_cmd()} | {as_csv}{output}; sleep {self.sleep_interval} >/dev/null 2>&1; done"
        )
        return f"sh -c {shlex.quote(loop)}"

    @staticmethod
    def parse_log(logfile: Path | str, column_names: Sequence[str] | None = None) -> Table:
        """Return what a log holds, under the names of its columns."""
        return read_table(logfile, column_names or ("%cpu", "%mem"))


class PowerJoular(CLISource):
    """Has PowerJoular write the power of the processor, and of one process, once a second."""

    parameters: ClassVar[Any] = ParameterDict(
        dict.fromkeys(("-p", "-a", "-f", "-o", "-m", "-s"), str) | dict.fromkeys(("-t", "-l"))
    )
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
        del sample_frequency  # PowerJoular has a rate of its own
        self.logfile = out_file
        self.args = {"-l": None, "-f": self._logfile}
        if target_pid:
            self.update_parameters(add={"-p": target_pid})
        self.update_parameters(add=additional_args)

    @property
    def target_logfile(self) -> str | None:
        """Where the samples of one process go."""
        return f"{self.logfile}-{self.args['-p']}.csv" if "-p" in self.args else None

    @staticmethod
    def parse_log(logfile: Path | str) -> Table:
        """Return what a log holds."""
        return read_table(logfile)


class EnergiBridge(CLISource):
    """Has EnergiBridge measure while a program runs, or (`sleep`) until it is stopped."""

    parameters: ClassVar[Any] = ParameterDict(
        {
            ("-o", "--output"): str,
            ("-s", "--separator"): str,
            ("-c", "--output-command", "--command-output"): str,
            ("-i", "--interval"): int,
            ("-m", "--max-execution"): int,
            ("-g", "--gpu"): None,
            ("--summary",): None,
        }
    )
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
        """Whether a summary is asked for."""
        return "--summary" in self.args

    @property
    def summary_logfile(self) -> Path | None:
        """Where the summary goes: beside the log."""
        if not self.logfile or not {"-o", "--output"} & set(self.args):
            return None
        logfile = Path(self.logfile)
        return logfile.with_name(f"{logfile.name.split('.')[0]}-summary.txt")

    def stop(self, wait: bool = False) -> str:
        """End the measuring, or `wait` for the program; the summary is kept in a file."""
        printed = super().stop(wait)
        if self.summary and self.summary_logfile is not None:
            lines = printed.strip().splitlines()
            summary = lines[-1] if lines else ""
            if not summary.startswith("Energy consumption"):
                warn_of_run("EnergiBridge gave no summary: it was computed from its log", fix="Measure for longer.")
                summary = self.generate_summary()
            self.summary_logfile.write_text(summary, encoding="utf-8")
        return printed

    def generate_summary(self) -> str:
        """Return a summary computed from the log: the counter's last value less its first."""
        log = self.parse_log(self.logfile)
        seconds, joules = _growth(log, "Time") / 1000, _growth(log, "PACKAGE_ENERGY (J)")
        return f"Energy consumption in joules: {joules} for {seconds} sec of execution"

    def _format_cmd(self) -> str:
        return f"{super()._format_cmd()} -- {self.target_program}"

    @staticmethod
    def parse_log(logfile: Path | str, summary_logfile: Path | str | None = None) -> Any:
        """Return what a log holds; with a summary, both."""
        log = read_table(logfile)
        if not summary_logfile:
            return log
        text = Path(summary_logfile).read_text(encoding="utf-8")
        numbers = [float(each) for each in _NUMBER.findall(text)]
        keys = ("total_joules", "runtime_seconds")
        return log, dict(zip(keys, numbers, strict=True)) if len(numbers) == len(keys) else text


def _growth(log: Table, column: str) -> float:
    values = [value for value in log.get(column, {}).values() if isinstance(value, int | float)]
    return float(values[-1] - values[0]) if values else 0.0
