"""The lock of the process that executes an experiment; and requests of a second terminal to go on, pause or stop."""

from __future__ import annotations

import errno
import json
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.storage.declared_shapes import faults_of, parsed_json
from robot_runner.core.storage.file_shapes import HolderFile, RequestFile
from robot_runner.core.storage.guarded_files import MissingFileError, open_descriptor, read_bytes, remove, replace
from robot_runner.core.storage.guarded_paths import open_folder
from robot_runner.core.storage.journal import REMOVED, Journal, utc_now
from robot_runner.core.storage.lock_files import is_at, is_held_exclusively, lock_exclusively, sign, signature_of
from robot_runner.core.storage.system_refusals import storage_error


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that executes an experiment."""

    pid: int
    host: str
    since: str


class ExperimentLock:
    """Keeps a second orchestrator out. The system releases it when the process dies, however it dies.

    A POSIX record lock: unlike `flock` it is not inherited by the runs that are forked from the holder. Only the
    folder's owner, or a group that may write in it, can hold it, see `lock_files`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = -1
        self._folder = -1

    def __enter__(self) -> Self:
        self._take()
        # Kept open: otherwise a folder that is made anew could get the same inode number.
        try:
            self._folder = open_folder(self._path.parent, [])
        except OSError as error:
            self._let_go()
            raise storage_error(self._path.parent, "opened", error) from error
        return self

    def _take(self) -> None:
        if own := _own_holder(self._path):
            raise _refusal(self._path, own)
        descriptor = lock_exclusively(self._path)
        if descriptor is None:
            raise _refusal(self._path, holder_of(self._path) or _UNKNOWN)
        holder = Holder(os.getpid(), socket.gethostname(), utc_now())
        try:
            sign(descriptor, holder)
        except OSError as error:
            os.close(descriptor)
            raise storage_error(self._path, "written", error) from error
        _HELD[descriptor] = holder
        self._let_go()
        self._descriptor = descriptor

    def successor(self) -> str:
        """Return, in words, what has replaced the locked folder or its execution; empty where nothing has."""
        if is_at(self._descriptor, self._path):
            return ""
        if holder_of(self._path) is not None:
            return "another process has executed the experiment again since"
        return "" if self._has_folder else "its folder was made again since"

    @property
    def _has_folder(self) -> bool:
        """Return whether the experiment's folder is still the one whose lock was taken."""
        try:
            return os.path.samestat(os.fstat(self._folder), os.stat(self._path.parent))  # noqa: PTH116 - as it is held
        except OSError as error:
            return error.errno not in {errno.ENOENT, errno.ENOTDIR, errno.ESTALE}  # else it cannot be looked at

    def look_after(self, journal: Journal) -> list[Finding]:
        """Check that the locked file is still the one that others see, and take the lock again if it is not.

        A user or `git clean` may have removed it, and so let a second orchestrator in. Called before each run.

        Returns:
            a warning if the lock was taken again.

        Raises:
            ExecutionError: another process executes the experiment, or has done so since the file was removed; or the
                folder was moved or removed.
            StorageError: it cannot be locked.
        """
        self.refuse_other_folder(journal)
        if is_at(self._descriptor, self._path):
            return []
        where, problem = str(self._path.parent), f"{self._path.name} was removed while the experiment was executed"
        again = "start the experiment again: it resumes"
        try:
            self._take()
        except ExecutionError as error:
            fix = f"Leave that file alone. Once the other process has ended, {again}."
            raise ExecutionError(f"{problem}, and now {error.problem}", where=where, fix=fix) from error
        if not journal.is_ours_alone:
            problem += ", and another process has executed it since"
            raise ExecutionError(problem, where=where, fix=f"Leave that file alone, and {again}.")
        return [Finding.warning(where, f"{problem}: it is locked again", "Leave that file alone: it keeps others out.")]

    def refuse_other_folder(self, journal: Journal) -> None:
        """Check that the experiment was not moved or removed: a run in flight may have made a new folder at its path.

        Otherwise journal and files of runs would be in two folders, or those of earlier runs gone silently.

        Raises:
            ExecutionError: it was.
        """
        where = str(self._path.parent)
        if there := journal.moved_to:
            problem = f"the experiment was moved or renamed while it was executed: its journal is {there}"
            fix = "Move it back, with what was written here since, and start the experiment again: it resumes."
            raise ExecutionError(problem, where=where, fix=fix)
        if self._has_folder:
            return
        problem, fix = REMOVED
        if (other := holder_of(self._path)) is not None:
            refusal = _refusal(self._path, other)
            problem, fix = f"{problem}, and now {refusal.problem}", refusal.fix
        raise ExecutionError(problem, where=where, fix=fix)

    def __exit__(self, *raised: object) -> None:
        self._let_go()
        os.close(self._folder)

    def _let_go(self) -> None:
        if self._descriptor < 0:
            return
        del _HELD[self._descriptor]
        with suppress(OSError):  # another machine has removed it
            os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)  # the file stays: removing it would race with the next holder
        self._descriptor = -1


_UNKNOWN = Holder(0, "unknown", "")
#: The locks that this process holds, by descriptor; forked processes do not inherit them.
_HELD: dict[int, Holder] = {}


def _own_holder(path: Path) -> Holder | None:
    """Return the holder if it is this process, which must not open the file: closing it would release the lock."""
    own = (held for held, holder in _HELD.items() if holder.pid == os.getpid() and is_at(held, path))
    return next(map(_HELD.__getitem__, own), None)


def holder_of(path: Path) -> Holder | None:
    """Return the holder of the lock at this moment, or None, without changing anything."""
    if own := _own_holder(path):
        return own
    try:
        descriptor = open_descriptor(path, flags=os.O_RDONLY)
    except StorageError:
        return None
    try:
        if not is_held_exclusively(descriptor, path):
            return None
        signed = signature_of(descriptor, HolderFile)
        return Holder(**signed) if signed else _UNKNOWN
    finally:
        os.close(descriptor)


def _refusal(path: Path, holder: Holder) -> ExecutionError:
    who = f"process {holder.pid} on {holder.host} since {holder.since}" if holder.pid else "another process"
    fix = "Wait until it ends, or stop it with Ctrl-C in its terminal."
    return ExecutionError(f"the experiment is being executed by {who}", where=str(path.parent), fix=fix)


#: A question to the operator: the run, and the step, which is empty where the question is whether the run may start.
Asked = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Request:
    """A request to go on, with the answers (texts by name of the question), and the question that it answers."""

    answers: Mapping[str, str] = field(default_factory=dict)
    asked: Asked | None = None


#: The one command that the control file may hold.
_CONTINUE = "continue"
#: A longer file is not a request of ours.
_MOST_BYTES = 64 * 1024


def send_continue(control: Path, answers: Mapping[str, str] | None = None, asked: Asked | None = None) -> None:
    """Let the orchestrator go on, with answers by name; `asked` is the question, None where that is not known.

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    said = {} if asked is None else {"run": asked[0], "step": asked[1]}
    replace(control, json.dumps({"command": _CONTINUE, "answers": dict(answers or {}), **said}))


def take_request(control: Path, asked: Asked | None = None) -> Request | None:
    """Return the request, and remove it; None if there is none, or it cannot be read.

    Args:
        control: the file for the request.
        asked: the open question; a request that answers another one is left in place. None takes every request.
    """
    try:
        text = read_bytes(control, limit=_MOST_BYTES)
    except MissingFileError:
        return None
    except StorageError:  # no file of ours
        remove(control)
        return None
    request = _understood(text)
    if request is not None and asked is not None and request.asked not in {None, asked}:
        return None
    return request if remove(control) else None  # else it was taken back meanwhile


def _understood(text: bytes) -> Request | None:
    try:
        said = parsed_json(text.decode())
        if faults_of(said, RequestFile) or said["command"] != _CONTINUE:
            return None
        asked = (said["run"], said.get("step", "")) if "run" in said else None
        return Request(said.get("answers", {}), asked)
    except (ValueError, RecursionError):
        return None


# Requests to pause and to stop: each is a file of its own, which exists until it is taken back.


def leave_request(path: Path) -> None:
    """Ask the orchestrator to pause before the next run, or to stop as by Ctrl-C, by the name of the file.

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    replace(path, f"{utc_now()}\n")


def is_requested(path: Path) -> bool:
    """Return whether there is a request to pause or to stop, by the name of the file.

    A folder that cannot be read counts as no request: the next record to be written there fails, and says why.
    """
    return os.path.isfile(path)  # noqa: PTH113 - that of a path raises what the system refuses, before Python 3.14


def forget_requests(*paths: Path) -> None:
    """Remove requests to pause or to stop: a paused experiment goes on."""
    for path in paths:
        remove(path)
