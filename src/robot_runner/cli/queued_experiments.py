"""The queue of a user's experiments on this machine: a file for each, so that it outlives the executing process.

`$XDG_STATE_HOME/robot-runner/queue/<host>` is writable for the user alone, as what is in it is executed. Experiment 7
is `7.json`. The process that executes it holds a lock on `7.lock`, which the system releases however the process ends:
an experiment that has begun and not ended, and whose lock is free, is begun again, and resumes.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING
from robot_runner.core.storage import guarded_files
from robot_runner.core.storage.claim_locks import state_folder
from robot_runner.core.storage.declared_shapes import shape_findings
from robot_runner.core.storage.file_shapes import QueuedFile
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.lock_files import is_held_exclusively, lock_exclusively, open_to_lock
from robot_runner.core.storage.system_refusals import storage_errors

_FILE = re.compile(r"([1-9][0-9]{0,8})\.json")
_READ = tuple(QueuedFile.__annotations__)
#: How long to wait for another process that is adding an experiment, and how often to look, s.
_PATIENCE, _LOOK = 10.0, 0.02
_ATTENDED, _ADDING = "attended.lock", "adding.lock"
_OWN = "Set XDG_STATE_HOME to a folder of your own."


@dataclass(frozen=True, slots=True)
class QueuedExperiment:
    """An experiment that was added to the queue.

    Attributes:
        number: tells it from the others; a later one has a higher number.
        config: its config file, an absolute path.
        options: those of `robot-runner run` that it is executed with.
        started_in: the folder in which it was added, and is executed.
        claims: what it claims against other experiments.
        python: the interpreter that it was added with, and is executed with.
        environment: variables that it was added with and that say which robot is meant.
        config_sha256: of the config file when it was added.
        added_at, began_at, ended_at: UTC.
        exit_code: of `robot-runner run`, once it has ended.
    """

    number: int
    config: str
    options: Sequence[str]
    started_in: str
    experiment: str
    results: str
    claims: Sequence[str]
    python: str
    environment: Mapping[str, str]
    config_sha256: str
    added_at: str = field(default_factory=utc_now)
    began_at: str | None = None
    ended_at: str | None = None
    exit_code: int | None = None
    problem: str = ""

    @property
    def has_ended(self) -> bool:
        """Whether there is nothing left to do."""
        return self.ended_at is not None

    @property
    def may_have_left_a_robot_moving(self) -> bool:
        """Whether it ended where nobody could stop its robot: whatever claims the same waits until it is dropped."""
        return self.has_ended and MAY_BE_MOVING in self.problem


class ExperimentQueue:
    """The queue on the disk.

    Raises:
        StorageError: its folder cannot be made, or others may write in it.
    """

    def __init__(self) -> None:
        self.folder = state_folder("queue")
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            found = self.folder.stat()
        except OSError as error:
            problem = f"the folder of the queue cannot be made: {error.strerror}"
            raise StorageError(problem, where=str(self.folder), fix=_OWN) from error
        if found.st_uid != os.geteuid() or found.st_mode & 0o022:
            problem = "others may write in the folder of the queue, and what stands in it is executed"
            raise StorageError(problem, where=str(self.folder), fix=f"Look at it, then: chmod 700 {self.folder}")

    def add(self, **facts: Any) -> QueuedExperiment:
        """Add an experiment at the end, and return it once it is on the disk; `facts` are its attributes.

        Raises:
            StorageError: it cannot be written.
        """
        with self._adding() as descriptor:
            last = os.pread(descriptor, 9, 0)  # the number of a dropped experiment is not given out again
            number = max(*self._numbers(), int(last) if last.isdigit() else 0, 0) + 1
            with storage_errors(self.folder / _ADDING, "written"):
                os.pwrite(descriptor, str(number).encode(), 0)
            added = QueuedExperiment(number, **facts)
            try:
                self.write(added)
            except (StorageError, KeyboardInterrupt):  # it may be there all the same; and who was refused adds it again
                with suppress(StorageError):
                    guarded_files.remove(self._file(number), self.folder)
                raise
        return added

    def read(self) -> tuple[list[QueuedExperiment], list[Finding]]:
        """Return the experiments in the queue, in order, and a finding for each damaged file.

        Raises:
            StorageError: the folder cannot be read.
        """
        found: list[QueuedExperiment] = []
        findings: list[Finding] = []
        for number in sorted(self._numbers()):
            with suppress(guarded_files.MissingFileError):  # dropped meanwhile
                each = self._read(number, findings)
                found += [] if each is None else [each]
        return found, findings

    def write(self, queued: QueuedExperiment) -> None:
        """Write the file of an experiment, completely or not at all; raise a `StorageError` if it cannot be written."""
        known = asdict(queued)
        del known["number"]
        guarded_files.replace(self._file(queued.number), json.dumps(known, indent=1), self.folder)

    def drop(self, number: int) -> None:
        """Remove an experiment from the queue; its results are not touched.

        Raises:
            ExecutionError: there is none of this number, or it is being executed.
        """
        if number not in self._numbers():
            known = ", ".join(map(str, sorted(self._numbers())))
            fix = f"There are: {known}." if known else "There is nothing to drop: the queue is empty."
            raise ExecutionError(f"there is no experiment {number} in the queue", where="robot-runner queue", fix=fix)
        with self.taken(number):
            guarded_files.remove(self._file(number), self.folder)
            guarded_files.remove(self._lock(number), self.folder)

    @contextmanager
    def taken(self, number: int) -> Iterator[None]:
        """Keep others from executing or dropping an experiment.

        Raises:
            ExecutionError: another process executes it.
        """
        descriptor = lock_exclusively(self._lock(number))
        if descriptor is None:
            fix = "Wait until it has ended, or end it with Ctrl-C in its terminal."
            raise ExecutionError(f"experiment {number} is being executed", where="robot-runner queue", fix=fix)
        try:
            yield
        finally:
            os.close(descriptor)

    def read_one(self, number: int) -> QueuedExperiment | None:
        """Return an experiment as it is on the disk now; None where it was dropped, or is damaged."""
        with suppress(guarded_files.MissingFileError):
            return self._read(number, [])
        return None

    def is_taken(self, number: int) -> bool:
        """Return whether another process executes an experiment at this moment."""
        path = self._lock(number)
        try:
            descriptor = guarded_files.open_descriptor(path, self.folder, os.O_RDONLY)
        except StorageError:
            return False
        try:
            return is_held_exclusively(descriptor, path)
        finally:
            os.close(descriptor)

    @contextmanager
    def attended(self) -> Iterator[None]:
        """While this lasts, other processes see that the queue is executed."""
        descriptor = open_to_lock(self.folder / _ATTENDED, self.folder)
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_SH)  # several may at once
            yield
        finally:
            os.close(descriptor)

    @property
    def is_attended(self) -> bool:
        """Whether another process executes the queue, or waits until that is possible."""
        descriptor = open_to_lock(self.folder / _ATTENDED, self.folder)
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False

    @contextmanager
    def _adding(self) -> Iterator[int]:
        """Keep others from taking the same number; yield the descriptor of the file that holds the last one."""
        path = self.folder / _ADDING
        deadline = time.monotonic() + _PATIENCE
        while (descriptor := lock_exclusively(path)) is None:
            if time.monotonic() > deadline:
                problem = f"another process has been adding to the queue for {_PATIENCE:g} s"
                raise StorageError(problem, where=str(path), fix="Look for a robot-runner that hangs, and end it.")
            time.sleep(_LOOK)
        try:
            yield descriptor
        finally:
            os.close(descriptor)

    def _numbers(self) -> set[int]:
        try:
            names = [path.name for path in self.folder.iterdir()]
        except OSError as error:
            problem = f"the folder of the queue cannot be read: {error.strerror}"
            raise StorageError(problem, where=str(self.folder), fix=_OWN) from error
        return {int(found[1]) for name in names if (found := _FILE.fullmatch(name))}

    def _read(self, number: int, findings: list[Finding]) -> QueuedExperiment | None:
        path = self._file(number)
        fix = f"Take it out of the queue: robot-runner queue drop {number}"
        try:
            said = guarded_files.read_json(path, self.folder)
        except guarded_files.MissingFileError:
            raise
        except StorageError as error:
            findings.append(Finding.error(str(path), error.problem, fix))
            return None
        faults = shape_findings(str(path), "an experiment of the queue", said, QueuedFile, fix)
        findings += faults
        return None if faults else QueuedExperiment(number, **{name: said[name] for name in _READ})

    def _file(self, number: int) -> Path:
        return self.folder / f"{number}.json"

    def _lock(self, number: int) -> Path:
        return self.folder / f"{number}.lock"
