"""The names of an experiment's files and folders: the only place that knows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["ExperimentFolder"]


@dataclass(frozen=True, slots=True)
class ExperimentFolder:
    """Where everything of one experiment is kept.

    Example:
        >>> ExperimentFolder(Path("results/basic")).log("r_1").as_posix()
        'results/basic/runs/r_1/log.txt'
    """

    root: Path

    @property
    def run_table(self) -> Path:
        """The populated run table, for people, R and pandas."""
        return self.root / "run_table.csv"

    @property
    def schema(self) -> Path:
        """Type, unit, meaning and owner of each column of the run table."""
        return self.root / "run_table.schema.json"

    @property
    def journal(self) -> Path:
        """The append-only history of the experiment."""
        return self.root / "journal.jsonl"

    @property
    def manifest(self) -> Path:
        """The circumstances: host, versions, seed, what was set by hand."""
        return self.root / "manifest.json"

    @property
    def config(self) -> Path:
        """The config file and the local modules that it imports, as executed."""
        return self.root / "config"

    @property
    def runs(self) -> Path:
        """One folder a run."""
        return self.root / "runs"

    @property
    def earlier_attempts(self) -> Path:
        """What attempts before the last one left behind."""
        return self.root / "earlier_attempts"

    @property
    def current_log(self) -> Path:
        """What the run that is being executed has printed so far."""
        return self.root / "current_log.txt"

    @property
    def lock(self) -> Path:
        """Held by whoever executes the experiment."""
        return self.root / ".lock"

    @property
    def control(self) -> Path:
        """What a second terminal tells the orchestrator."""
        return self.root / ".control"

    def run(self, run_id: str) -> Path:
        """Return the folder of a run: its log, and a folder for each plugin's raw data."""
        return self.runs / run_id

    def log(self, run_id: str) -> Path:
        """Return the file that takes everything that a run's callbacks printed, once it has ended."""
        return self.run(run_id) / "log.txt"

    def earlier_attempt(self, run_id: str, attempt: int) -> Path:
        """Return where a run's folder is kept once another attempt was made."""
        return self.earlier_attempts / run_id / str(attempt)
