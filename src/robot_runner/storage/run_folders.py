"""The folders and logs of runs: each attempt begins with none, and none loses what an earlier attempt left.

Making a folder or a file costs a file system more than all else that is recorded of a run. So a run has a folder only
if something is kept in it, and what it prints goes to one log that is renamed into its folder when the run has ended.
"""

from __future__ import annotations

import io
import json
import os
from typing import TYPE_CHECKING, Any

from robot_runner.storage.safe_write import storage_error

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.storage.layout import ExperimentFolder

__all__ = ["LazyLog", "keep_log", "keep_refused", "open_log", "put_earlier_attempt_away"]


def open_log(folder: ExperimentFolder) -> int:
    """Return a descriptor that appends to the log of the run that is being executed.

    Raises:
        OSError: it cannot be opened.
    """
    return os.open(folder.current_log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)


class LazyLog(io.TextIOBase):
    """The log of the run that is being executed, as a text stream: opened once something is printed."""

    def __init__(self, folder: ExperimentFolder) -> None:
        self._folder = folder
        self._file: io.TextIOWrapper | None = None

    def writable(self) -> bool:
        """Say that it can be written to."""
        return True

    def write(self, text: str) -> int:
        """Append to the log."""
        return self._opened().write(text)

    def flush(self) -> None:
        """Hand what was written to the system."""
        if self._file is not None:
            self._file.flush()

    def fileno(self) -> int:
        """Return its descriptor, for programs that are to print into it."""
        return self._opened().fileno()

    @property
    def buffer(self) -> Any:
        """The stream beneath it, for who prints bytes."""
        return self._opened().buffer

    def close(self) -> None:
        """Close it; closing twice does nothing."""
        file, self._file = self._file, None
        if file is not None:
            file.close()
        super().close()

    def _opened(self) -> io.TextIOWrapper:
        if self.closed:
            raise ValueError("I/O operation on closed file.")
        if self._file is None:
            self._file = os.fdopen(open_log(self._folder), "a", encoding="utf-8", errors="backslashreplace")
        return self._file


def keep_log(folder: ExperimentFolder, run_id: str) -> None:
    """Move what a run printed into its folder; a run that printed nothing has no log.

    Raises:
        StorageError: it cannot be moved.
    """
    try:
        if _size(folder.current_log) > 0:
            folder.run(run_id).mkdir(exist_ok=True)
            folder.current_log.replace(folder.log(run_id))
    except OSError as error:
        raise storage_error(folder.log(run_id), "written", error) from error


def keep_refused(folder: ExperimentFolder, run_id: str, refused: Mapping[str, Any]) -> None:
    """Keep a value that the run table could not take, one JSON record a line in the run's `refused.jsonl`.

    Raises:
        StorageError: it cannot be written.
    """
    path = folder.refused(run_id)
    try:
        path.parent.mkdir(exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(refused, ensure_ascii=False, default=str) + "\n")
    except OSError as error:
        raise storage_error(path, "written", error) from error


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def put_earlier_attempt_away(folder: ExperimentFolder, run_id: str, attempt: int) -> None:
    """Keep the folder that an earlier attempt at a run left behind, so that the next one begins without any.

    Raises:
        StorageError: it cannot be moved.
    """
    left = folder.run(run_id)
    try:
        if left.exists():
            kept = _free(folder.earlier_attempt(run_id, attempt))
            kept.parent.mkdir(parents=True, exist_ok=True)
            left.rename(kept)
    except OSError as error:
        raise storage_error(left, "moved", error) from error


def _free(wanted: Path) -> Path:
    # The table may have been edited so that attempts are counted anew: what is kept is never overwritten.
    number = 1
    path = wanted
    while path.exists():
        number += 1
        path = wanted.with_name(f"{wanted.name}-{number}")
    return path
