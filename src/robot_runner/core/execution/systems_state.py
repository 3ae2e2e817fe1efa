"""Which process is responsible for a run's systems: shared by the run, its keeper, its standby and the orchestrator.

If all of them are killed, a file in the experiment's folder tells the next execution what is not safe yet. A copy
beside the user's claims tells any experiment that uses the robot next, as the folder may have been removed or renamed.
"""

from __future__ import annotations

import json
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeGuard

from robot_runner.core.errors import StorageError
from robot_runner.core.links.commanded_topics import STOPPED_BY_EMPTY, Commanded
from robot_runner.core.storage.claim_locks import state_folder
from robot_runner.core.storage.guarded_files import open_to_append, open_to_fill, read_text, remove, replace
from robot_runner.core.storage.journal import journal_lines
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.system_refusals import fsync_file

# Layout of the shared file: one byte for `Care`, the reason, and a line for each commanded topic or action.
#: The size of the reason, bytes; a longer one is cut.
_REASON = 2000
#: Where the topics begin.
_TOPICS = 1 + _REASON
#: The longest list of topics, bytes; a robot has one or two.
_LONGEST_LIST = 100_000
#: The folder of the copies, beside that of the claims.
_COPIES = "left"
#: The types by which a robot is stopped. A list, as what was read from a file need not be hashable.
_STOPPED = sorted(STOPPED_BY_EMPTY)


class Care(IntEnum):
    """The process that is responsible for a run's systems, or their final state."""

    NOBODY_YET = 0
    RUN = 1
    SAFE = 2
    STANDBY = 3
    MADE_SAFE = 4
    OUT_OF_REACH = 5


class SystemsState:
    """The state of a run's systems in an unnamed file, which all processes of the run inherit.

    Attributes:
        descriptor: of that file; a process that replaces itself hands it on.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None:
            with tempfile.TemporaryFile() as file:
                descriptor = os.dup(file.fileno())
        self.descriptor = descriptor
        self._lock = threading.Lock()

    @property
    def care(self) -> Care:
        """The process that is responsible for the systems now."""
        return Care((os.pread(self.descriptor, 1, 0) or b"\0")[0])

    @property
    def reason(self) -> str:
        """Why they could not be made safe; or what remains doubtful where they were."""
        return os.pread(self.descriptor, _REASON, 1).rstrip(b"\0").decode("utf-8", "replace")

    @property
    def commanded(self) -> list[Commanded]:
        """The topics and actions by which the run commands a robot."""
        lines = os.pread(self.descriptor, _LONGEST_LIST, _TOPICS).decode().splitlines()
        fields = (line.split(" ", len(Commanded._fields) - 1) for line in lines)
        return [Commanded(*each) for each in fields if len(each) == len(Commanded._fields)]  # the last may be cut

    def add_commanded(self, commanded: Commanded) -> None:
        """Add a topic or action by which the run is about to command a robot; it then has systems to care for."""
        with self._lock:
            end = max(_TOPICS, os.fstat(self.descriptor).st_size)
            os.pwrite(self.descriptor, f"{' '.join(commanded)}\n".encode(), end)
            if self.care is Care.NOBODY_YET:
                self.set(Care.RUN)

    def set(self, care: Care, reason: str = "") -> None:
        """Set the process that is responsible from now on."""
        os.pwrite(self.descriptor, reason.encode("utf-8", "backslashreplace")[:_REASON].ljust(_REASON, b"\0"), 1)
        os.pwrite(self.descriptor, bytes([care]), 0)

    def close(self) -> None:
        """Close the file."""
        os.close(self.descriptor)


@dataclass(frozen=True, slots=True)
class LeftSystems:
    """The systems of a run that has begun and is not known to have left them safe.

    Attributes:
        run_id: of the run.
        robot: how its robot is reached; None where it has none.
        task: the run, as plain data (`worker.described_task`).
        commanded: the topics and actions by which it has commanded a robot.
        systems: the names of those that have a `make_safe` of their own.
        is_told: whether its robot was commanded to stand still since, or a person was asked to stop it.
    """

    run_id: str
    robot: str | None
    task: Mapping[str, Any]
    commanded: tuple[Commanded, ...]
    systems: frozenset[str]
    is_told: bool = False

    @property
    def in_words(self) -> str:
        """The beginning of a finding about them."""
        robot = "" if self.robot is None else f" ({self.robot})"
        return (
            f"an earlier execution was killed in {self.run_id}{robot}, and no process was left to make its systems safe"
        )


@dataclass(frozen=True, slots=True)
class LeftCopy:
    """A copy of a run's `LeftSystems`, in a file of this user outside the experiment's folder.

    Attributes:
        path: where it is.
        original: the file in the experiment's folder, which may be gone.
        left: what it tells.
    """

    path: Path
    original: Path
    left: LeftSystems

    def remove(self) -> None:
        """Remove the copy: its robot was stopped, or a person was asked to."""
        with suppress(StorageError):
            remove(self.path, self.path.parent)


def left_copies() -> list[LeftCopy]:
    """Return the copies of all files of this user about robots that may be moving."""
    found = []
    with suppress(StorageError):  # a user without a home folder has none
        for path in sorted(state_folder(_COPIES).glob("*")):
            lines = list(_lines_of(path, path.parent))
            match lines[0] if lines else None:
                case {"folder": str(folder), "file": str(name)} if (left := _left_of(lines)) is not None:
                    found.append(LeftCopy(path, Path(folder) / name, left))
    return found


class SystemsFile:
    """A file for the next execution: the systems of a run that are not safe yet; it is removed once they are.

    Where it cannot be written, the run goes on without it: it is needed only where keeper, standby and orchestrator are
    killed with the run.
    """

    def __init__(self, folder: ExperimentFolder) -> None:
        self._path, self._root, self._journal = folder.to_make_safe, folder.root, folder.journal
        self._copy = _copy_of(self._path.absolute())

    def begin(self, robot: str | None, task: Mapping[str, Any], systems: Sequence[str] = ()) -> None:
        """Write, in the run, that its systems are about to be used; flushed to the disk."""
        line = self._line(robot, task, systems).encode()
        if robot is not None and self._copy is not None:
            with suppress(OSError):
                self._copy.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            _fill(self._copy, self._copy.parent, line)
        _fill(self._path, self._root, line)

    def leave(self, left: LeftSystems) -> None:
        """Keep only systems with a `make_safe`, if any: the robot was stopped, or a person asked to (`is_told`)."""
        self._remove_copies()
        with suppress(StorageError):
            if left.systems:
                replace(self._path, self._line(left.robot, left.task, sorted(left.systems), is_told=True), self._root)
            else:
                remove(self._path, self._root)

    def _line(self, robot: str | None, task: Mapping[str, Any], systems: Sequence[str], **more: object) -> str:
        where = {"folder": str(self._root.absolute()), "file": self._path.name}
        told = {"robot": robot, "systems": systems, **where, "task": task, **more}
        return f"{json.dumps(told, default=str)}\n"

    def add_commanded(self, commanded: Commanded) -> None:
        """Add, in the run, a topic or action by which a robot will be commanded; flushed to the disk."""
        told = {"topic": commanded.topic, "type": commanded.message_type, "graph": commanded.graph}
        line = f"{json.dumps(told)}\n".encode()
        for path, root in ((self._copy, self._copy and self._copy.parent), (self._path, self._root)):
            if path is not None:
                with suppress(OSError, StorageError), open_to_append(path, root) as file:
                    file.write(line)
                    fsync_file(file.fileno())

    def remove(self) -> None:
        """Remove the file: they are safe, or a person was told that they are not."""
        if any(map(os.path.lexists, filter(None, (self._path, self._copy)))):  # nearly always, neither is there
            self._remove_copies()  # first: a copy without the file tells of a robot that is moving
            with suppress(StorageError):
                remove(self._path, self._root)

    def _remove_copies(self) -> None:
        """Remove the copy, also the one of the folder that this one was before it was moved."""
        told = next(_lines_of(self._path, self._root), {})
        before = Path(str(told.get("folder"))) / str(told.get("file"))
        for copy in {self._copy, _copy_of(before)}:
            if copy is not None:
                with suppress(StorageError):
                    remove(copy, copy.parent)

    def left(self) -> LeftSystems | None:
        """Return what is not safe yet; None where nothing is, or the file is not what a run has written here."""
        lines = list(_lines_of(self._path, self._root))
        return None if lines and self._is_copied_from(lines[0].get("folder")) else _left_of(lines)

    def _is_copied_from(self, folder: object) -> bool:
        """Return whether this is a copy of an experiment folder that still exists, which cares for its systems."""
        with suppress(OSError, StorageError, ValueError):
            if isinstance(folder, str) and not self._root.samefile(folder):
                begun = next(journal_lines(self._journal), None)
                return begun is not None and begun == next(journal_lines(Path(folder) / self._journal.name), None)
        return False


def _copy_of(path: Path) -> Path | None:
    """Return where the copy of a file is; None where the user has no home folder."""
    with suppress(StorageError):
        return state_folder(_COPIES) / sha256(str(path).encode("utf-8", "backslashreplace")).hexdigest()
    return None


def _fill(path: Path, root: Path, content: bytes) -> None:
    with suppress(OSError, StorageError), open_to_fill(path, root) as file:
        file.write(content)
        file.flush()
        fsync_file(file.fileno())


def _lines_of(path: Path, root: Path) -> Iterator[Mapping[str, Any]]:
    with suppress(StorageError, ValueError, RecursionError):  # the last line may be incomplete
        for line in read_text(path, root).splitlines():
            if isinstance(read := json.loads(line), dict):
                yield read


def _left_of(lines: Sequence[Mapping[str, Any]]) -> LeftSystems | None:
    match lines[0] if lines else None:
        case {"robot": str() | None as robot, "task": {"run_id": str(run_id)} as task}:
            topics = ((line.get("topic"), line.get("type"), line.get("graph", "")) for line in lines)
            # No others: an empty message of another type may be a command to do something.
            commanded = (
                Commanded(topic, kind, graph)
                for topic, kind, graph in topics
                if _is_name(topic) and kind in _STOPPED and isinstance(graph, str) and graph.isprintable()
            )
            names = told if isinstance(told := lines[0].get("systems"), list) else []
            systems = frozenset(each for each in names if isinstance(each, str))
            return LeftSystems(run_id, robot, task, tuple(commanded), systems, lines[0].get("is_told") is True)
    return None


def _is_name(topic: object) -> TypeGuard[str]:
    """Return whether a value can be a topic's name in the lines of `SystemsState`, which are separated by blanks."""
    return isinstance(topic, str) and topic.isascii() and topic.isprintable() and " " not in topic
