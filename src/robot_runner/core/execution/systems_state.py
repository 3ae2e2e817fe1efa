"""Which process is responsible for a run's systems: known to the run, its keeper, its standby and the orchestrator.

Where all of them were killed, a file in the experiment's folder tells the next execution what is not safe yet.
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
from pathlib import Path
from typing import Any, TypeGuard

from robot_runner.core.errors import StorageError
from robot_runner.core.links.commanded_topics import VELOCITIES
from robot_runner.core.storage.guarded_files import open_to_append, open_to_fill, read_text, remove, replace
from robot_runner.core.storage.journal import journal_lines
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.system_refusals import fsync_file

#: The longest reason that is kept of why a system could not be made safe, bytes.
_REASON = 2000
#: Behind it stand the commanded topics, a line each.
_TOPICS = 1 + _REASON
#: The longest list of them, bytes; a robot has one or two.
_LONGEST_LIST = 100_000
#: The types by which a robot is stopped; as a list, as whatever was read may be compared with it.
_STOPPED = sorted(VELOCITIES)


class Care(IntEnum):
    """Who has the care of a run's systems."""

    NOBODY_YET = 0
    RUN = 1
    SAFE = 2
    STANDBY = 3
    MADE_SAFE = 4
    OUT_OF_REACH = 5


class SystemsState:
    """What the processes of a run tell each other of its systems: a file without a name, which all of them inherit.

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
        """Who has the care of the systems now."""
        return Care((os.pread(self.descriptor, 1, 0) or b"\0")[0])

    @property
    def reason(self) -> str:
        """Why they could not be made safe; or what is not known of a robot that was told to stand still."""
        return os.pread(self.descriptor, _REASON, 1).rstrip(b"\0").decode("utf-8", "replace")

    @property
    def commanded(self) -> list[tuple[str, str]]:
        """The full name and the type of each topic on which the run commands a velocity."""
        lines = os.pread(self.descriptor, _LONGEST_LIST, _TOPICS).decode().splitlines()
        return [(topic, message_type) for topic, _, message_type in (line.partition(" ") for line in lines)]

    def add_commanded(self, topic: str, message_type: str) -> None:
        """Say, in the run, that velocities will be commanded on a topic."""
        with self._lock:
            end = max(_TOPICS, os.fstat(self.descriptor).st_size)
            os.pwrite(self.descriptor, f"{topic} {message_type}\n".encode(), end)

    def set(self, care: Care, reason: str = "") -> None:
        """Say who has it from now on."""
        os.pwrite(self.descriptor, reason.encode("utf-8", "backslashreplace")[:_REASON].ljust(_REASON, b"\0"), 1)
        os.pwrite(self.descriptor, bytes([care]), 0)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self.descriptor)


@dataclass(frozen=True, slots=True)
class LeftSystems:
    """The systems of a run that has begun, and of which nobody has said that they are safe.

    Attributes:
        run_id: of the run.
        robot: how its robot is reached; None where it has none.
        task: the run, as plain data (`worker.described_task`).
        commanded: the full name and the type of each topic on which it has commanded a velocity.
        systems: the names of those that have a `make_safe` of their own.
        is_told: whether its robot was told to stand still since, or a person to stop it.
    """

    run_id: str
    robot: str | None
    task: Mapping[str, Any]
    commanded: tuple[tuple[str, str], ...]
    systems: frozenset[str]
    is_told: bool = False

    @property
    def in_words(self) -> str:
        """What is said of it."""
        robot = "" if self.robot is None else f" ({self.robot})"
        return f"an earlier execution was killed in {self.run_id}{robot}, and nobody was left to make its systems safe"


class SystemsFile:
    """A file that tells the next execution which systems of a run are not safe yet; it is removed once they are.

    Where it cannot be written, the run goes on without it: it is needed only where all processes that stand by are
    killed.

    Args:
        folder: of the experiment, at the slot.
    """

    def __init__(self, folder: ExperimentFolder) -> None:
        self._path, self._root, self._journal = folder.to_make_safe, folder.root, folder.journal

    def begin(self, robot: str | None, task: Mapping[str, Any], systems: Sequence[str] = ()) -> None:
        """Say, in the run, that its systems are about to be used, and have it reach the disk."""
        with suppress(OSError, StorageError), open_to_fill(self._path, self._root) as file:
            file.write(self._line(robot, task, systems).encode())
            file.flush()
            fsync_file(file.fileno())

    def leave(self, left: LeftSystems) -> None:
        """Say that its systems alone are to be made safe yet, as its robot was told, or a person; see `is_told`."""
        with suppress(StorageError):
            if left.systems:
                replace(self._path, self._line(left.robot, left.task, sorted(left.systems), is_told=True), self._root)
            else:
                remove(self._path, self._root)

    def _line(self, robot: str | None, task: Mapping[str, Any], systems: Sequence[str], **more: object) -> str:
        told = {"robot": robot, "systems": systems, "folder": str(self._root.absolute()), "task": task, **more}
        return f"{json.dumps(told, default=str)}\n"

    def add_commanded(self, topic: str, message_type: str) -> None:
        """Say, in the run, that velocities will be commanded on a topic, and have it reach the disk."""
        with suppress(OSError, StorageError), open_to_append(self._path, self._root) as file:
            file.write(f"{json.dumps({'topic': topic, 'type': message_type})}\n".encode())
            fsync_file(file.fileno())

    def remove(self) -> None:
        """Say that they are safe, or that a person was told that they are not."""
        with suppress(StorageError):
            remove(self._path, self._root)

    def left(self) -> LeftSystems | None:
        """Return what is not safe yet; None where nothing is, or the file is not what a run has written here."""
        lines = list(self._lines())
        if lines and self._is_copied_from(lines[0].get("folder")):
            return None
        match lines[0] if lines else None:
            case {"robot": str() | None as robot, "task": {"run_id": str(run_id)} as task}:
                topics = ((line.get("topic"), line.get("type")) for line in lines)
                # Nothing else: an empty message of another type may have a robot do something.
                commanded = ((topic, kind) for topic, kind in topics if _is_name(topic) and kind in _STOPPED)
                names = told if isinstance(told := lines[0].get("systems"), list) else []
                systems = frozenset(each for each in names if isinstance(each, str))
                return LeftSystems(run_id, robot, task, tuple(commanded), systems, lines[0].get("is_told") is True)
        return None

    def _is_copied_from(self, folder: object) -> bool:
        """Whether the experiment is still in another folder, which tells of its run, and was copied meanwhile."""
        with suppress(OSError, StorageError, ValueError):
            if isinstance(folder, str) and not self._root.samefile(folder):
                begun = next(journal_lines(self._journal), None)
                return begun is not None and begun == next(journal_lines(Path(folder) / self._journal.name), None)
        return False

    def _lines(self) -> Iterator[Mapping[str, Any]]:
        with suppress(StorageError, ValueError, RecursionError):  # the last line may have been written by half
            for line in read_text(self._path, self._root).splitlines():
                if isinstance(read := json.loads(line), dict):
                    yield read


def _is_name(topic: object) -> TypeGuard[str]:
    """Whether it can be a topic's name: processes tell each other of each in a line, its type behind it."""
    return isinstance(topic, str) and topic.isascii() and topic.isprintable() and " " not in topic
