"""The names of an experiment's files and folders, known here alone; logs of runs, and files of earlier attempts.

Making a folder or a file costs more than all else that is recorded of a run. So a run has a folder only if something is
kept in it, and it prints to one log that is renamed into its folder when the run has ended.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import make_folder, open_descriptor, open_to_append, remove
from robot_runner.core.storage.masked_log import MaskedText, mask_log
from robot_runner.core.storage.system_refusals import storage_errors

_RUNS = "runs"
_MANIFEST = "manifest.json"
_LOG = "log.txt"
#: The folder for logs of unknown runs among earlier attempts: no run can have this name.
_UNKNOWN = "unknown run"


class _Member:
    """A file or folder right below an experiment's folder, as an attribute of `ExperimentFolder`."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, folder: ExperimentFolder, _kind: type) -> Path:
        return folder.root / self._name


@dataclass(frozen=True, slots=True)
class ExperimentFolder:
    """Where everything of one experiment is kept.

    Attributes:
        root: the experiment's folder.
        runs_name: the folder in it that holds a folder for each run; empty where they stand in the root itself, as the
            earlier tools had them.
        slot: the slot of this machine at which a run is executed, from 1: each has files of its own.

    Example:
        >>> from pathlib import Path
        >>> ExperimentFolder(Path("results/basic")).log("r_1").as_posix()
        'results/basic/runs/r_1/log.txt'
    """

    root: Path
    runs_name: str = _RUNS
    slot: int = 1
    #: One folder a run.
    runs: Path = field(init=False, repr=False, compare=False)
    #: What the run that is being executed has printed so far.
    current_log: Path = field(init=False, repr=False, compare=False)

    #: The populated run table, for people, R and pandas.
    run_table = _Member("run_table.csv")
    #: Type, unit, meaning and owner of each column of the run table.
    schema = _Member("run_table.schema.json")
    #: The append-only history of the experiment.
    journal = _Member("journal.jsonl")
    #: The circumstances: host, versions, seed, what was set by hand.
    manifest = _Member(_MANIFEST)
    #: The config file, the local modules that it imports, and its inputs, as executed.
    config = _Member("config")
    #: The registration before the first run, if there was one.
    registration = _Member("registration.json")
    #: The report, with its tables and figures; made anew whenever it is asked for.
    report = _Member("report")
    #: The logs of building revisions of a repository.
    revisions = _Member("revisions")
    #: Files of software under test of `per="experiment"`: a folder for each start of each subject.
    subjects = _Member("subjects")
    #: Files of attempts before the last one.
    earlier_attempts = _Member("earlier_attempts")
    #: Run tables that differed from the journal, numbered.
    earlier_tables = _Member("earlier_tables")
    #: Configs that were executed before the config changed, numbered.
    earlier_configs = _Member("earlier_configs")
    #: The copy of a config, until it is whole.
    unfinished_config = _Member(".config.tmp")
    #: Held by the process that executes the experiment.
    lock = _Member(".lock")
    #: A request of a second terminal to the orchestrator.
    control = _Member(".control")
    #: Exists while the experiment is to pause between two runs.
    pause = _Member(".pause")
    #: Exists from a request to stop, as by Ctrl-C, until the orchestrator takes it.
    stop = _Member(".stop")
    #: The processes that may outlive the run that started them.
    outliving = _Member(".outliving")

    def __post_init__(self) -> None:
        # Made once: every run asks for them, and making a path is slow.
        object.__setattr__(self, "runs", self.root / self.runs_name)
        object.__setattr__(self, "current_log", self.root / f"current_log{self._of_slot}.txt")

    @property
    def _of_slot(self) -> str:
        """The suffix of a slot's files; empty for the first slot."""
        return "" if self.slot == 1 else f"_{self.slot}"

    def at_slot(self, slot: int) -> ExperimentFolder:
        """Return the same folder with the files of this slot."""
        return self if slot == self.slot else replace(self, slot=slot)

    def used_slots(self) -> list[int]:
        """Return the numbers of the slots that have files, the first one always among them."""
        used = {1}
        for pattern in ("current_log_*.txt", ".alive_*", ".standing_by_*", ".to_make_safe_*"):
            ends = (path.stem.rpartition("_")[2] for path in self.root.glob(pattern))
            used.update(int(end) for end in ends if end.isdecimal())
        return sorted(used)

    @classmethod
    def found_at(cls, root: Path) -> ExperimentFolder:
        """Return the folder of an existing experiment, of ours or of an earlier tool."""
        keeps_runs_in_root = (root / _MANIFEST).exists() and not (root / _RUNS).exists()
        return cls(root, "" if keeps_runs_in_root else _RUNS)

    def uncommitted(self, digest: str) -> Path:
        """Return the file of changes that were not committed to the config's repository, by their SHA-256."""
        return self.config / f"uncommitted-{digest[:12]}.diff"

    @property
    def alive(self) -> Path:
        """Locked by each process of a run, as long as it lives."""
        return self.root / f".alive{self._of_slot}"

    @property
    def standing_by(self) -> Path:
        """Locked by the standby of a run; it contains that process's id."""
        return self.root / f".standing_by{self._of_slot}"

    @property
    def to_make_safe(self) -> Path:
        """Exists from the beginning of a run until its systems are safe, see `SystemsFile`."""
        return self.root / f".to_make_safe{self._of_slot}"

    def run(self, run_id: str) -> Path:
        """Return the folder of a run: its log, and a folder for each plugin's raw data."""
        return self.runs / run_id

    def log(self, run_id: str) -> Path:
        """Return the log of a run that has ended: all that its callbacks printed."""
        return self.run(run_id) / _LOG

    def refused(self, run_id: str) -> Path:
        """Return the file of values that the run table could not take."""
        return self.run(run_id) / "refused.jsonl"


def _open_log(folder: ExperimentFolder) -> int:
    """Return a descriptor that appends to the log of the run that is being executed.

    Raises:
        StorageError: it cannot be opened.
    """
    return open_descriptor(folder.current_log, folder.root, os.O_WRONLY | os.O_CREAT | os.O_APPEND)


def print_to_log(folder: ExperimentFolder) -> None:
    """Redirect this process's output to the log of the current run, for programs that it starts and for C code, too.

    Raises:
        StorageError: the log cannot be opened.
    """
    log = _open_log(folder)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)


class LazyLog(io.TextIOBase):
    """The log of the run that is being executed, as a text stream: opened once something is printed."""

    def __init__(self, folder: ExperimentFolder) -> None:
        self._folder = folder
        self._file: io.TextIOWrapper | None = None

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, text: str) -> int:
        """Append to the log."""
        return self._opened().write(text)

    def flush(self) -> None:
        """Flush the log, if it was opened."""
        if self._file is not None:
            self._file.flush()

    def fileno(self) -> int:
        """Return its descriptor, for programs that print to it."""
        return self._opened().fileno()

    @property
    def buffer(self) -> Any:
        """The binary stream beneath it."""
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
            binary = os.fdopen(_open_log(self._folder), "ab")
            self._file = MaskedText(binary, encoding="utf-8", errors="backslashreplace")
        return self._file


def keep_log(folder: ExperimentFolder, run_id: str) -> bool:
    """Move the log of a run into its folder, with secrets of the environment masked; return False where it is empty.

    Raises:
        StorageError: it cannot be moved.
    """
    return _keep_log(folder, folder.log(run_id))


def keep_unknown_log(folder: ExperimentFolder) -> Path | None:
    """Move away the log of a run that the journal does not know, so that the next run does not append to it.

    Return where it is now; None where it is empty.

    Raises:
        StorageError: it cannot be moved.
    """
    kept = _free(folder.earlier_attempts / _UNKNOWN / "1") / _LOG
    return kept if _keep_log(folder, kept) else None


def _keep_log(folder: ExperimentFolder, kept: Path) -> bool:
    """Move the current log unless it is empty; return whether it was moved."""
    with storage_errors(kept, "written"):
        if has_printed := _size(folder.current_log) > 0:
            make_folder(kept.parent, folder.root)
            mask_log(folder.current_log, folder.root)
            folder.current_log.replace(kept)
    return has_printed


def remove_half_written(folder: ExperimentFolder) -> None:
    """Remove half-written temporary files of a killed process; the caller must hold the experiment's lock.

    Raises:
        StorageError: it cannot be removed.
    """
    for path in (folder.run_table, folder.schema, folder.manifest):
        for half in folder.root.glob(f".{path.name}.*.tmp"):
            remove(half, folder.root)


def drop_empty_log(folder: ExperimentFolder) -> None:
    """Remove the current log, if it is empty, once no run is executed any more."""
    if _size(folder.current_log) == 0:
        folder.current_log.unlink(missing_ok=True)


def keep_refused(folder: ExperimentFolder, run_id: str, refused: Mapping[str, Any]) -> None:
    """Keep a value that the run table could not take, one JSON record a line in the run's `refused.jsonl`.

    Raises:
        StorageError: it cannot be written.
    """
    path = folder.refused(run_id)
    make_folder(path.parent, folder.root)
    with open_to_append(path, folder.root) as file:
        file.write(f"{json.dumps(refused, default=str)}\n".encode())


def _size(path: Path) -> int:
    try:
        return path.lstat().st_size
    except FileNotFoundError:
        return 0


def put_earlier_attempt_away(folder: ExperimentFolder, run_id: str, attempt: int) -> None:
    """Move the folder of an earlier attempt at a run away, so that the next one begins without files.

    Raises:
        StorageError: it cannot be moved.
    """
    left = folder.run(run_id)
    with storage_errors(left, "moved"):
        if left.exists():
            kept = _free(folder.earlier_attempts / run_id / str(attempt))
            make_folder(kept.parent, folder.root)
            left.rename(kept)


def next_in(folder: Path, root: Path) -> Path:
    """Return the next free path in a folder with numbered members; the folder is made if missing.

    Raises:
        StorageError: it cannot be made.
    """
    make_folder(folder, root)
    return folder / str(1 + members_in(folder))


def members_in(folder: Path) -> int:
    """Return the number of members of a folder; 0 if there is none."""
    return sum(1 for _ in folder.iterdir()) if folder.is_dir() else 0


def last_config(folder: ExperimentFolder) -> Path:
    """Return the folder with the config as executed last: an earlier one where a kill kept the next from its place."""
    if folder.config.exists() or not folder.earlier_configs.is_dir():
        return folder.config
    numbered = (path for path in folder.earlier_configs.iterdir() if path.name.isdecimal())
    return max(numbered, key=lambda path: int(path.name), default=folder.config)


def runs_put_away(folder: ExperimentFolder) -> list[str]:
    """Return the runs whose earlier attempts were moved away."""
    return [path.name for path in folder.earlier_attempts.iterdir()] if folder.earlier_attempts.is_dir() else []


def put_attempt_back(folder: ExperimentFolder, run_id: str, attempt: int) -> bool:
    """Move the folder of a run's last attempt back, if no other attempt has begun since; return whether it was moved.

    Raises:
        StorageError: it cannot be moved.
    """
    put_away = folder.earlier_attempts / run_id / str(attempt)
    with storage_errors(put_away, "moved"):
        if folder.run(run_id).exists() or not put_away.exists():
            return False
        put_away.rename(folder.run(run_id))
    return True


def _free(wanted: Path) -> Path:
    # Attempts may be counted from 1 again, after edits of the table: nothing is ever overwritten.
    others = (wanted.with_name(f"{wanted.name}-{number}") for number in count(2))
    return next(path for path in chain([wanted], others) if not path.exists())


#: The defaults of the XDG Base Directory Specification (0.8).
_FOLDERS = {"XDG_STATE_HOME": "~/.local/state", "XDG_CACHE_HOME": "~/.cache"}


def home_folder() -> Path | None:
    """Return the user's home folder; None where there is none, as for a user without a name in some containers."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def user_folder(variable: str) -> Path:
    """Return our folder in the user's for state (`XDG_STATE_HOME`) or for caches (`XDG_CACHE_HOME`).

    A relative path in the variable is ignored, as its specification says: it would depend on the current folder.

    Raises:
        StorageError: the user has no home folder, as in some containers.
    """
    try:
        given = Path(os.environ.get(variable, "")).expanduser()
        return (given if given.is_absolute() else Path(_FOLDERS[variable]).expanduser()) / "robot-runner"
    except RuntimeError as error:
        fix = f"Set {variable} to a folder of your own."
        raise StorageError("the user has no home folder", where=_FOLDERS[variable], fix=fix) from error
