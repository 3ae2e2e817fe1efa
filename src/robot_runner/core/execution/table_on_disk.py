"""When the run table on disk is written: so that people see it fresh, and recording a run costs what it costs."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.run_table_rows import write_run_table

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.core.storage.journal import Journal
    from robot_runner.core.storage.run_table_rows import RunTableRows

__all__ = ["TableOnDisk"]

#: The run table is brought up to date at most so often that this share of the time goes into writing it, so that
#: the cost of recording a run does not grow with the number of runs. The journal has every run at once.
_SHARE = 1 / 50
#: While a run or a wait lasts, it is written at most so often, in seconds.
_INTERVAL = 1.0
#: A table that takes the processor longer than this, in seconds, is not written while a run is executed: that would
#: disturb what is measured on this machine. A hundred thousand rows take so long.
_MOST_WORK_IN_RUN = 0.25


class TableOnDisk:
    """The file of the run table, and how far it is behind the rows in memory.

    Args:
        path: the file.
        rows: what it is to hold.
        journal: takes down each writing.
        cost: how long writing takes at most, waiting for the disk and working, as far as that is known, in seconds.
    """

    def __init__(self, path: Path, rows: RunTableRows, journal: Journal, cost: float = 0.0) -> None:
        self._path = path
        self._rows = rows
        self._journal = journal
        self._cost = self._work = cost
        self._written = time.monotonic()
        self._is_stale = False

    def take(self, rows: RunTableRows) -> None:
        """Take these rows in the place of those that there were, and write them where the time has come."""
        self._rows = rows
        self.refresh()

    def refresh(self) -> None:
        """Write it unless that was done a moment ago: the rows have changed."""
        self._is_stale = True
        if time.monotonic() - self._written > self._cost / _SHARE:
            self.write()

    def tend(self) -> float | None:
        """Write it where it is stale and the time has come, while a run or a wait lasts.

        Returns:
            in how many seconds the time comes; None where there is nothing to write.
        """
        if not self._is_stale or self._work > _MOST_WORK_IN_RUN:
            return None
        # Nothing else waits for the disk meanwhile, so that only the work counts.
        due = self._written + max(_INTERVAL, self._work / _SHARE) - time.monotonic()
        if due > 0:
            return due
        with suppress(StorageError):  # said when the run has ended: it is not to fail for this
            self.write()
        return None

    def bring_up_to_date(self) -> None:
        """Write it if it is stale."""
        if self._is_stale:
            self.write()

    def write(self) -> None:
        """Write it.

        Raises:
            StorageError: it cannot be written.
        """
        started, worked = time.monotonic(), time.process_time()
        digest = write_run_table(self._path, self._rows)
        # After the rename: a run that is in the table and not yet known to be is taken from the journal once more.
        self._journal.append("table_written", sha256=digest)
        self._written = time.monotonic()
        self._cost, self._work = self._written - started, time.process_time() - worked
        self._is_stale = False
