"""The names of an experiment's files and folders: the only place that knows them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["ExperimentFolder"]

_RUNS = "runs"
_MANIFEST = "manifest.json"


@dataclass(frozen=True, slots=True)
class ExperimentFolder:
    """Where everything of one experiment is kept.

    Attributes:
        root: the experiment's folder.
        runs_name: the folder in it that holds a folder for each run; empty where they stand in the root itself, as the
            earlier tools had them.

    Example:
        >>> from pathlib import Path
        >>> ExperimentFolder(Path("results/basic")).log("r_1").as_posix()
        'results/basic/runs/r_1/log.txt'
    """

    root: Path
    runs_name: str = _RUNS
    #: One folder a run.
    runs: Path = field(init=False, repr=False, compare=False)
    #: What the run that is being executed has printed so far.
    current_log: Path = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # Made once: they are asked for in every run, and making a path takes longer than all else there.
        object.__setattr__(self, "runs", self.root / self.runs_name)
        object.__setattr__(self, "current_log", self.root / "current_log.txt")

    @classmethod
    def found_at(cls, root: Path) -> ExperimentFolder:
        """Return the folder of an experiment that is there already, whichever way it keeps its runs."""
        keeps_runs_in_root = (root / _MANIFEST).exists() and not (root / _RUNS).exists()
        return cls(root, "" if keeps_runs_in_root else _RUNS)

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
        return self.root / _MANIFEST

    @property
    def config(self) -> Path:
        """The config file and the local modules that it imports, as executed."""
        return self.root / "config"

    @property
    def earlier_configs(self) -> Path:
        """Configs that were executed before the config changed, numbered."""
        return self.root / "earlier_configs"

    @property
    def earlier_attempts(self) -> Path:
        """What attempts before the last one left behind."""
        return self.root / "earlier_attempts"

    @property
    def report(self) -> Path:
        """The report, with its tables and figures; made anew whenever it is asked for."""
        return self.root / "report"

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

    def refused(self, run_id: str) -> Path:
        """Return the file of values that the run table could not take."""
        return self.run(run_id) / "refused.jsonl"

    def earlier_attempt(self, run_id: str, attempt: int) -> Path:
        """Return where a run's folder is kept once another attempt was made."""
        return self.earlier_attempts / run_id / str(attempt)
