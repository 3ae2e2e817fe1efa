"""The programs that profilers of old configs start in the run's process group, and the reading of their logs.

One of these profilers is Experiment Runner's measurement of each run by EnergiBridge (`self_measure`).
"""

from __future__ import annotations

import csv
import math
import os
import re
import shlex
import shutil
import signal
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.legacy.session import warn_of_run
from robot_runner.measuring.meter_process import ChildProgram, Ending

#: The time within which a program fails at once, s.
_STARTING_S = 0.1
_CLOSING_S = 5.0

#: The values of each column, by row from 0.
Table = dict[str, dict[int, Any]]


class Program(ChildProgram):
    """A program in the run's process group; its standard output is kept until it has ended.

    Args:
        command: the program and its arguments, as a list or as a command line of a shell.
        name: its name in messages.

    Raises:
        PluginError: the program cannot be started.
        LinkError: the program failed at once.
    """

    def __init__(self, command: str | Sequence[str], *, name: str) -> None:
        self._name = name
        # Files, not pipes: children of the program may outlive it and would keep a pipe open.
        self._printed = TemporaryFile()  # noqa: SIM115 - closed when the program has ended
        words = shlex.split(command) if isinstance(command, str) else list(command)
        errors = TemporaryFile()  # noqa: SIM115 - closed when the program has ended
        try:
            super().__init__(words, output=self._printed, errors=errors, has_own_group=False)
        except PluginError:
            self._printed.close()
            raise
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.wait(lambda: not self.is_running, seconds=_STARTING_S)
        if self.process.poll():
            ending = self.kill()
            said = f": {ending.complaint}" if ending.complaint else ""
            raise self._failed(f"{name} ended at once with exit code {ending.exit_code}{said}")

    def end(self, *, wait: bool = False) -> str:
        """Stop the program, or `wait` until it ends by itself; returns its output.

        Raises:
            LinkError: the program had to be killed.
        """
        if wait:
            self.wait(lambda: False, seconds=math.inf)
        ending = self.stop(signal.SIGTERM, grace=_CLOSING_S)
        with self._printed:
            if ending.was_killed:
                raise self._failed(f"{self._name} did not end within {_CLOSING_S:g} s")
            if ending.complaint:
                warn_of_run(f"{self._name} said: {ending.complaint}", fix="Check whether it measured.")
            self._printed.seek(0)
            return self._printed.read().decode(errors="backslashreplace")

    def kill(self) -> Ending:
        """Kill the program; returns how it ended."""
        self._printed.close()
        return self.stop(signal.SIGKILL, grace=_CLOSING_S)

    def _failed(self, problem: str) -> LinkError:
        return LinkError(problem, where=self._name, fix=f"Try {self._name} in a terminal.")


def read_table(path: Path | str, names: Sequence[str] | None = None) -> Table:
    """Read a CSV file.

    Args:
        path: the file.
        names: the columns' names; None takes them from the first line.

    Returns:
        The values of each column by row, from 0: a number if the cell is one, NaN if it is empty or lacks, as in the
        last row of a program that was ended while it wrote.

    Raises:
        OSError: the file cannot be read.
    """
    with Path(path).open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if row]
    if names is None:
        names, rows = (rows[0], rows[1:]) if rows else ([], [])
    return {
        name.strip(): {place: _value(row[column]) if column < len(row) else math.nan for place, row in enumerate(rows)}
        for column, name in enumerate(names)
    }


def _value(text: str) -> Any:
    text = text.strip()
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text or math.nan


#: The column of the run table that it fills.
COLUMN = "self-measure"

_DEFAULT_BINARY = "/usr/local/bin/energibridge"
#: EnergiBridge's summary: `Energy consumption in joules: 12.3 for 4.5 sec of execution.`
_JOULES = re.compile(r"joules:\s*([0-9]+(?:\.[0-9]+)?)")


class SelfMeasure(Profiler):
    """Measures the energy of this machine over a whole run, by EnergiBridge's summary.

    The earlier tool defines this column over the whole run, from `start_run` to `stop_run`, so that a window that
    differs from the mission's is not reported as doubtful.

    Args:
        binary: the program; None for Experiment Runner's default path.
        logfile: the name of its log in the run's folder; None for no log.

    Example:
        >>> SelfMeasure().measures[0].name
        'self-measure'
    """

    measures: Sequence[Measure] = (
        Measure(
            COLUMN,
            "J",
            "Energy of this machine's processor over the whole run, not the mission alone, by EnergiBridge's summary.",
        ),
    )
    #: It has one total for a whole run.
    probe_s: float | None = None
    needs: ClassVar[str] = "EnergiBridge, at self_measure_bin."

    def __init__(
        self, *, name: str | None = None, binary: str | os.PathLike[str] | None = None, logfile: object = None
    ) -> None:
        super().__init__(name=name)
        self.binary = os.fspath(binary or _DEFAULT_BINARY)
        self.logfile = logfile
        self._program: Program | None = None
        self._joules: float | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield an error if the program is missing, or cannot measure on this machine."""
        del circumstances
        off = "write self_measure = False."
        if sys.platform != "linux":
            yield Finding.error("self_measure", "self_measure measures on Linux alone", "Write self_measure = False.")
        elif shutil.which(self.binary) is None:
            problem = f"there is no program {self.binary!r}"
            yield Finding.error("self_measure_bin", problem, f"Install EnergiBridge and name its path, or {off}")

    def start_run(self, context: RobotRunnerContext) -> None:
        """Start EnergiBridge."""
        log = "/dev/null" if self.logfile is None else str(context.run_folder / str(self.logfile))
        self._joules = None
        self._program = Program([self.binary, "--summary", "-o", log, "--", "sleep", "1000000"], name="EnergiBridge")

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Stop EnergiBridge, and read its summary."""
        program, self._program = self._program, None
        if program is None:
            return
        found = _JOULES.search(program.end())
        if found is None:
            context.doubt("EnergiBridge gave no summary", fix=f"Try {self.binary} --summary -- sleep 1 in a terminal.")
        else:
            self._joules = round(float(found[1]), 3)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the energy."""
        context.publish(COLUMN, self._joules)
