"""Who executes an experiment, known to all; and what a second terminal asks of it: to go on, to pause, to stop."""

from __future__ import annotations

import errno
import json
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
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
    """Keeps a second orchestrator out. The system lets go of it when the process dies, however it dies.

    A POSIX record lock: unlike `flock` it is not inherited by the runs that are forked from the holder. Nobody but the
    folder's owner, or the group that may write in it, can hold it, see `lock_files`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = -1
        self._folder = -1

    def __enter__(self) -> Self:
        self._take()
        # Held open, so that no other folder is mistaken for it: one that is made anew may get its number.
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
        """Return, in words, what stands in the place of what was locked; empty where nothing that keeps us out does."""
        if is_at(self._descriptor, self._path):
            return ""
        if holder_of(self._path) is not None:
            return "another process has executed the experiment anew since"
        return "" if self._has_folder else "its folder was made anew since"

    @property
    def _has_folder(self) -> bool:
        """Whether the experiment's folder is still the one whose lock was taken; it may be reached through a link."""
        try:
            return os.path.samestat(os.fstat(self._folder), os.stat(self._path.parent))  # noqa: PTH116 - as it is held
        except OSError as error:
            return error.errno not in {errno.ENOENT, errno.ENOTDIR, errno.ESTALE}  # else it cannot be looked at

    def look_after(self, journal: Journal) -> list[Finding]:
        """Check that the locked file is still the one that others see, and take the lock again if it is not.

        Somebody may have removed it, by hand or by `git clean`, and so let a second orchestrator in. Asked before each
        run, it finds that out at the latest after the run that was executed meanwhile, once that is recorded.

        Returns:
            what there is to tell.

        Raises:
            ExecutionError: another process executes the experiment, or has since the file was removed; or the folder
                was moved or removed.
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
        return [Finding.warning(where, f"{problem}: it is locked anew", "Leave that file alone: it keeps others out.")]

    def refuse_other_folder(self, journal: Journal) -> None:
        """Check that nobody has moved or removed the experiment: a run that goes on may have made its folder anew.

        Its journal and the files of its runs would be in two folders, or those of earlier runs gone without a word.

        Raises:
            ExecutionError: somebody has.
        """
        where = str(self._path.parent)
        if there := journal.moved_to:
            raise ExecutionError(
                f"the experiment was moved or renamed while it was executed: its journal is {there}",
                where=where,
                fix="Move it back, with what was written here since, and start the experiment again: it resumes.",
            )
        if self._has_folder:
            return
        problem, fix = REMOVED
        if (other := holder_of(self._path)) is not None:
            refusal = _refusal(self._path, other)
            problem, fix = f"{problem}, and now {refusal.problem}", refusal.fix
        raise ExecutionError(problem, where=where, fix=fix)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
#: The locks that this process holds, by their descriptors; a process that is forked from it holds none of them.
_HELD: dict[int, Holder] = {}


def _own_holder(path: Path) -> Holder | None:
    """Return this process where it holds the lock: it must not open the file, as closing it would let go of that."""
    own = (held for held, holder in _HELD.items() if holder.pid == os.getpid() and is_at(held, path))
    return next(map(_HELD.__getitem__, own), None)


def holder_of(path: Path) -> Holder | None:
    """Return who holds the lock at this moment, or None; nothing is changed by asking."""
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
    return ExecutionError(
        f"the experiment is being executed by {who}",
        where=str(path.parent),
        fix="Wait until it ends, or stop it with Ctrl-C in its terminal.",
    )


#: What somebody is asked before a run, or in it: the run, and the step; empty where it is whether the run may start.
Asked = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Request:
    """That a person says to go on, the answers (texts by the names of the questions), and what the person was asked."""

    answers: Mapping[str, str] = field(default_factory=dict)
    asked: Asked | None = None


#: The one command that the control file may hold.
_CONTINUE = "continue"
#: A longer request is none of ours.
_MOST_BYTES = 64 * 1024


def send_continue(control: Path, answers: Mapping[str, str] | None = None, asked: Asked | None = None) -> None:
    """Tell the orchestrator to go on, with answers, by name, to what was asked (None where that is not known).

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    said = {} if asked is None else {"run": asked[0], "step": asked[1]}
    replace(control, json.dumps({"command": _CONTINUE, "answers": dict(answers or {}), **said}))


def take_request(control: Path, asked: Asked | None = None) -> Request | None:
    """Return the request that was left, and remove it; None if there is none, or it cannot be read.

    Args:
        control: the file for the request.
        asked: what is asked; a request that answers another question is left in place. None takes every request.
    """
    try:
        text = read_bytes(control, limit=_MOST_BYTES)
    except MissingFileError:
        return None
    except StorageError:  # nothing that we wrote
        remove(control)
        return None
    request = _understood(text)
    if request is not None and asked is not None and request.asked not in {None, asked}:
        return None
    return request if remove(control) else None  # else who has left it has taken it back meanwhile


def _understood(text: bytes) -> Request | None:
    try:
        said = parsed_json(text.decode())
        if faults_of(said, RequestFile) or said["command"] != _CONTINUE:
            return None
        asked = (said["run"], said.get("step", "")) if "run" in said else None
        return Request(said.get("answers", {}), asked)
    except (ValueError, RecursionError):
        return None


# Requests to pause and to stop: each a file of its own, so that it lasts until it is taken back and no command is lost.


def leave_request(path: Path) -> None:
    """Ask the orchestrator to pause before the next run, or to stop as by Ctrl-C: which one, the file says.

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    replace(path, f"{utc_now()}\n")


def is_requested(path: Path) -> bool:
    """Return whether a pause is asked for, or lasts; or whether the orchestrator is asked to stop.

    A folder that cannot be read counts as no request: the next record that is to be written there fails, and says why.
    """
    return os.path.isfile(path)  # noqa: PTH113 - that of a path raises what the system refuses, before Python 3.14


def forget_requests(*paths: Path) -> None:
    """Take requests back: a paused experiment goes on, and what was seen or is of no use any longer is removed."""
    for path in paths:
        remove(path)
