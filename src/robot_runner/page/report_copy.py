"""The report of an experiment, as it lies in its folder."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from robot_runner.core.errors import ExecutionError
from robot_runner.core.storage.guarded_files import MissingFileError, read_bytes
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from pathlib import Path


def report_in(folder: Path) -> bytes:
    """Return the report in an experiment's folder.

    Raises:
        StorageError: it cannot be read.
        ExecutionError: none was made yet.
    """
    try:
        return read_bytes(ExperimentFolder(folder).report / "report.html", folder)
    except MissingFileError as error:
        fix = f"Make it: robot-runner report {shlex.quote(folder.name)}"
        raise ExecutionError("there is no report yet", where=folder.name, fix=fix) from error
