"""A program that runs beside a run, in the run's process group, so that it ends with it; its errors are kept."""

from __future__ import annotations

import csv
import shlex
import subprocess
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.legacy.session import warn_of_run

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Program", "Table", "read_table"]


# Logs of meters as the earlier tools read them: a mapping from column to a mapping from row to value.

Table = dict[str, dict[int, Any]]


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
        try:
            return kind(text)
        except ValueError:
            continue
    return text or None


#: A program that fails at once does so within this time, s.
_STARTING_S = 0.1
_KILLING_S = 5.0
_SHOWN = 300


class Program:
    """A program that was started; what it prints is kept until it has ended."""

    def __init__(self, command: str | Sequence[str], *, name: str) -> None:
        """Start it.

        Raises:
            LinkError: it cannot be started.
        """
        self._name = name
        arguments = shlex.split(command) if isinstance(command, str) else list(command)
        # Files, not pipes: what the program itself starts may outlive it and would hold a pipe open.
        self._printed: IO[bytes] = TemporaryFile()  # noqa: SIM115 - closed when the program has ended
        self._errors: IO[bytes] = TemporaryFile()  # noqa: SIM115 - closed when the program has ended
        try:
            self.process = subprocess.Popen(  # noqa: S603 - a config's own command
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=self._printed,
                stderr=self._errors,
            )
        except OSError as error:
            self._close()
            raise LinkError(
                f"{name} cannot be started: {error.strerror}",
                where=arguments[0],
                fix=f"Install {arguments[0]}, or mend its path.",
            ) from error

    def check_started(self) -> None:
        """See that it has not ended at once with an error.

        Raises:
            LinkError: it has.
        """
        with suppress(subprocess.TimeoutExpired):
            if self.process.wait(_STARTING_S):
                _, errors = self._close()
                raise self._failed(f"it ended at once with exit code {self.process.returncode}", errors.strip())

    def end(self, deadline: float | None) -> str:
        """Tell it to end, or wait until it does; returns what it printed.

        Args:
            deadline: how long it may take to end, s; None waits for it to end by itself.

        Raises:
            LinkError: it does not end.
        """
        if deadline is not None:
            self.process.terminate()
        try:
            self.process.wait(deadline)
        except subprocess.TimeoutExpired as error:
            self.kill()
            raise self._failed(f"it did not end within {deadline:g} s", "") from error
        printed, errors = self._close()
        if errors.strip():
            warn_of_run(f"{self._name} said: {errors.strip()[:_SHOWN]}", fix="Look whether it measured.")
        return printed

    def kill(self) -> None:
        """End it at once."""
        self.process.kill()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_KILLING_S)
        self._close()

    def _close(self) -> tuple[str, str]:
        """Return what was printed, and the errors; nothing where the files were closed before."""
        said = []
        for file in (self._printed, self._errors):
            if file.closed:
                said.append("")
            else:
                file.seek(0)
                said.append(file.read().decode(errors="backslashreplace"))
                file.close()
        return said[0], said[1]

    def _failed(self, problem: str, errors: str) -> LinkError:
        said = f": {errors[:_SHOWN]}" if errors else ""
        return LinkError(problem + said, where=self._name, fix=f"Try {self._name} in a terminal.")
