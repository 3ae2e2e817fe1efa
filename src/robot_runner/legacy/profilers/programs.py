"""What profilers of old configs start beside a run, in the run's process group, and how they read logs."""

from __future__ import annotations

import csv
import math
import shlex
import signal
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.legacy.session import warn_of_run
from robot_runner.measuring.meter_process import ChildProgram, Ending

#: A program that fails at once does so within this time, s.
_STARTING_S = 0.1
_CLOSING_S = 5.0

#: The values of each column, by row from 0.
Table = dict[str, dict[int, Any]]


class Program(ChildProgram):
    """A program that belongs to the run's process group; its stdout is kept until it has ended.

    Args:
        command: the program and its arguments, as a list or as a shell would split it.
        name: what messages call it.

    Raises:
        PluginError: it cannot be started.
        LinkError: it failed at once.
    """

    def __init__(self, command: str | Sequence[str], *, name: str) -> None:
        self._name = name
        # Files, not pipes: what the program itself starts may outlive it and would hold a pipe open.
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
        """Have it end, or `wait` until it does; returns what it printed.

        Raises:
            LinkError: it had to be killed.
        """
        if wait:
            self.wait(lambda: False, seconds=math.inf)
        ending = self.stop(signal.SIGTERM, grace=_CLOSING_S)
        with self._printed:
            if ending.was_killed:
                raise self._failed(f"{self._name} did not end within {_CLOSING_S:g} s")
            if ending.complaint:
                warn_of_run(f"{self._name} said: {ending.complaint}", fix="Look whether it measured.")
            self._printed.seek(0)
            return self._printed.read().decode(errors="backslashreplace")

    def kill(self) -> Ending:
        """End it at once; returns how it ended."""
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
        The values of each column by row, from 0: numbers where a cell is one, None where it is empty.

    Raises:
        OSError: it cannot be read.
    """
    with Path(path).open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if row]
    if names is None:
        names, rows = (rows[0], rows[1:]) if rows else ([], [])
    return {
        name.strip(): {place: _value(row[column]) if column < len(row) else None for place, row in enumerate(rows)}
        for column, name in enumerate(names)
    }


def _value(text: str) -> Any:
    text = text.strip()
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text or None
