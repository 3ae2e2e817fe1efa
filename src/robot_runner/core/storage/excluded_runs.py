"""Which runs are left out, and why: as the journal tells it, which is the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.columns import EXCLUDED
from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["EXCLUSION_KINDS", "ExcludedRun", "ExcludedRuns"]

#: The records that `ExcludedRuns.take` looks at.
EXCLUSION_KINDS = frozenset({"excluded", "included", "deviation"})


@dataclass(frozen=True, slots=True)
class ExcludedRun:
    """A run that is left out.

    Attributes:
        at: when it was excluded (UTC).
    """

    run_id: str
    reason: str
    at: str


@dataclass(slots=True)
class ExcludedRuns:
    """What the journal tells of runs that are left out.

    Attributes:
        present: those that are left out at present, by id.
        were_any: whether any run was ever left out: then the run table has a column for it.

    Example:
        >>> runs = ExcludedRuns()
        >>> runs.take({"kind": "excluded", "at": "2026-01-31T12:00:00.250Z", "run": "r_7", "reason": "door was open"})
        >>> runs.present["r_7"].reason, runs.were_any
        ('door was open', True)
    """

    present: dict[str, ExcludedRun] = field(default_factory=dict)
    were_any: bool = False

    @classmethod
    def read(cls, journal: Path) -> ExcludedRuns:
        """Read a journal; one that does not exist tells of none.

        Raises:
            StorageError: it cannot be read.
        """
        runs = cls()
        for record in read_journal(journal, kinds=EXCLUSION_KINDS):
            runs.take(record)
        return runs

    def take(self, record: Mapping[str, Any]) -> None:
        """Take a record of the journal into account, the oldest first; other kinds change nothing."""
        match record["kind"]:
            case "excluded":
                self._set(record["run"], str(record["reason"]), record["at"])
            case "included":
                self.present.pop(record["run"], None)
            case "deviation" if record["column"] == EXCLUDED:  # by hand, and the file was chosen to count
                self._set(record["run"], str(record["is"]), record["at"])

    def reason(self, run_id: str) -> str | None:
        """Return why a run is left out; None where it is not."""
        found = self.present.get(run_id)
        return found.reason if found else None

    def _set(self, run_id: str, reason: str, at: str) -> None:
        self.were_any = True
        if reason:
            self.present[run_id] = ExcludedRun(run_id, reason, at)
        else:
            self.present.pop(run_id, None)
