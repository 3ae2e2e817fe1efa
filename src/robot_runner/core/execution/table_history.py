"""What the journal tells of a run table: which runs were tried and ended, and when the file was written last."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.core.storage.excluded_runs import EXCLUSION_KINDS, ExcludedRuns
from robot_runner.core.storage.journal import journal_lines, parsed_record

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["FINISHED", "TableHistory", "run_of"]

# As `Journal.append` writes them: run and status are read from the line, as parsing takes twenty times as long.
_RUN = re.compile(rb'\{"kind":"[^"]*","at":"[^"\\]*","run":"([^"\\]*)"')
_SESSION = b'{"kind":"experiment_started"'
_STARTED = b'{"kind":"attempt_started"'
#: How the line begins that tells of an attempt's end.
FINISHED = b'{"kind":"attempt_finished"'
_TABLE_WRITTEN = b'{"kind":"table_written"'
_EXCLUSION = tuple(f'{{"kind":"{kind}"'.encode() for kind in EXCLUSION_KINDS)
_KINDS = EXCLUSION_KINDS | {"experiment_started", "attempt_started", "attempt_finished", "table_written"}
_IS_DONE = b'"status":"done"'  # quotes inside a text are escaped: these stand nowhere else


@dataclass(slots=True)
class TableHistory:
    """What the journal tells, in its order, of runs and of the file of the run table.

    Attributes:
        attempted: the run of each attempt.
        open: the beginnings of the last session's attempts that did not come to a recorded end, by their runs.
        newer: the ends of attempts since the table was written last.
        failed: the ends of attempts that did not end well.
        written: the digest of the table as it was written last; empty where that is not known.
        has_ends: whether any attempt has ended.
        excluded: the runs that are left out.
    """

    attempted: list[str] = field(default_factory=list)
    open: dict[str, bytes] = field(default_factory=dict)
    newer: list[bytes] = field(default_factory=list)
    failed: list[bytes] = field(default_factory=list)
    written: str = ""
    has_ends: bool = False
    excluded: ExcludedRuns = field(default_factory=ExcludedRuns)

    @classmethod
    def of(cls, journal: Path) -> TableHistory:
        """Read a journal; one that does not exist tells nothing.

        Raises:
            StorageError: it cannot be read, or a line is no record.
        """
        history = cls()
        for line in journal_lines(journal, kinds=_KINDS):
            history.take(journal, line)
        return history

    def take(self, journal: Path, line: bytes) -> None:
        """Take a line of the journal into account, the oldest first."""
        if line.startswith(_STARTED):
            run_id = run_of(journal, line)
            self.attempted.append(run_id)
            self.open[run_id] = line
        elif line.startswith(_SESSION):
            self.open.clear()  # what they had printed was kept when that session began
        elif line.startswith(_TABLE_WRITTEN):
            # Parsed, as what comes before is left out from here on: a damaged line must not do that.
            self.written = str(parsed_record(journal, line).get("sha256", ""))
            self.newer.clear()
        elif line.startswith(_EXCLUSION):
            self.excluded.take(parsed_record(journal, line))
        else:
            self.open.pop(run_of(journal, line), None)
            self.has_ends = True
            self.newer.append(line)
            if _IS_DONE not in line:
                self.failed.append(line)


def run_of(journal: Path, line: bytes) -> str:
    """Return the run that a line of the journal is about."""
    found = _RUN.match(line)
    return found[1].decode() if found else str(parsed_record(journal, line)["run"])
