"""What the journal has of one run: its attempts, the events and measures of the last one, what looked odd."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.storage.journal import read_journal

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["RunHistory", "read_run_history"]

_KINDS = ("attempt_started", "attempt_finished", "event", "finding", "clock")


@dataclass(slots=True)
class RunHistory:
    """One run as the journal tells it.

    Attributes:
        attempt: the number of the last attempt; 0 where there was none.
        started_at, finished_at: of the last attempt (UTC).
        measures: what it published: a mapping with `value`, `owner`, `origin` for each.
        clocks: when its events were emitted, s on the run's clock.
        doubts: what owners found odd about it.
        hosts: other computers that were measured, and how their clocks stood.
        failures: why earlier attempts failed, by number.
    """

    attempt: int = 0
    started_at: str | None = None
    finished_at: str | None = None
    measures: dict[str, dict[str, Any]] = field(default_factory=dict)
    clocks: dict[str, float] = field(default_factory=dict)
    doubts: dict[str, list[str]] = field(default_factory=dict)
    hosts: list[str] = field(default_factory=list)
    failures: dict[int, str] = field(default_factory=dict)

    def take(self, record: dict[str, Any]) -> None:
        """Take one record that is about the run."""
        match record["kind"]:
            case "attempt_started":
                self._begin(record)
            case "attempt_finished":
                self.finished_at = record["at"]
                self.measures = record["measures"]
                if record.get("failure"):
                    self.failures[self.attempt] = str(record["failure"])
            case "event" if isinstance(record.get("clock"), int | float):
                self.clocks[str(record["event"])] = float(record["clock"])
            case "finding":
                self.doubts.setdefault(str(record.get("owner")), []).append(str(record["problem"]))
            case "clock":
                offset = (record.get("before") or record.get("after") or {}).get("wall_offset")
                told = f", its clock {offset:+.6f} s to ours" if isinstance(offset, int | float) else ""
                self.hosts.append(f"{record.get('host')} (measured by {record.get('owner')}{told})")

    def _begin(self, record: dict[str, Any]) -> None:
        self.attempt, self.started_at, self.finished_at = int(record["attempt"]), record["at"], None
        self.measures, self.clocks, self.doubts, self.hosts = {}, {}, {}, []


def read_run_history(journal: Path, run_id: str) -> RunHistory:
    """Read what the journal has of a run; a journal that does not exist has nothing.

    Raises:
        StorageError: it cannot be read.
    """
    history = RunHistory()
    for record in read_journal(journal, kinds=_KINDS):
        if record.get("run") == run_id:
            history.take(record)
    return history
