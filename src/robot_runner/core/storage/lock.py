"""What a second terminal tells the orchestrator, a word and what goes with it in one file; and who executes it."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Self

from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.storage.declared_shapes import faults_of, parsed_json
from robot_runner.core.storage.file_shapes import HolderFile, RequestFile
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.safe_write import storage_error, write_beside_and_rename

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from types import TracebackType

__all__ = [
    "Command",
    "ExperimentLock",
    "Holder",
    "Request",
    "forget_command",
    "forget_pause",
    "holder_of",
    "pause_is_requested",
    "request_pause",
    "send_command",
    "take_command",
    "take_request",
]


# Who executes an experiment: one process at a time, known to the others.


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that executes an experiment."""

    pid: int
    host: str
    since: str


class ExperimentLock:
    """Keeps a second orchestrator out. The system lets go of it when the process dies, however it dies.

    A POSIX record lock: unlike `flock` it is not inherited by the runs that are forked from the holder.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = -1

    def __enter__(self) -> Self:
        try:
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise storage_error(self._path, "written", error) from error
        try:
            fcntl.lockf(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _read(self._descriptor)
            os.close(self._descriptor)
            raise _refusal(self._path, holder, error) from error
        self._sign()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)  # the file stays: removing it would race with the next holder

    def _sign(self) -> None:
        os.ftruncate(self._descriptor, 0)
        holder = Holder(os.getpid(), socket.gethostname(), utc_now())
        os.pwrite(self._descriptor, json.dumps(asdict(holder)).encode(), 0)


_SIGNED = tuple(HolderFile.__annotations__)


def holder_of(path: Path) -> Holder | None:
    """Return who holds the lock at this moment, or None; nothing is changed by asking."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return _read(descriptor)
    else:
        return None
    finally:
        os.close(descriptor)


def _read(descriptor: int) -> Holder:
    try:
        said = json.loads(os.pread(descriptor, 4096, 0))
    except (ValueError, RecursionError):  # locked and not yet signed
        said = None
    return Holder(0, "unknown", "") if faults_of(said, HolderFile) else Holder(**{name: said[name] for name in _SIGNED})


def _refusal(path: Path, holder: Holder, error: OSError) -> ExecutionError | StorageError:
    if error.errno not in {errno.EACCES, errno.EAGAIN}:
        return StorageError(
            f"the folder's file system offers no locks: {error.strerror}",
            where=str(path),
            fix="Keep the results on a local disk (results_output_path).",
        )
    return ExecutionError(
        f"the experiment is being executed by process {holder.pid} on {holder.host} since {holder.since}",
        where=str(path.parent),
        fix="Wait until it ends, or stop it with Ctrl-C in its terminal.",
    )


class Command(Enum):
    """What can be said."""

    CONTINUE = "continue"


@dataclass(frozen=True, slots=True)
class Request:
    """A command, and the answers that go with it: texts by the names of the questions."""

    command: Command
    answers: Mapping[str, str] = field(default_factory=dict)


#: A longer request is none of ours.
_MOST_BYTES = 64 * 1024


def send_command(control: Path, command: Command, answers: Mapping[str, str] | None = None) -> None:
    """Leave a command for the orchestrator, with answers to what it asks.

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    request = json.dumps({"command": command.value, "answers": dict(answers or {})})
    write_beside_and_rename(control, lambda file: file.write(request))


def take_command(control: Path) -> Command | None:
    """Return the command that was left, and remove it; None where there is none, or none that is known."""
    request = take_request(control)
    return request.command if request else None


def take_request(control: Path) -> Request | None:
    """Return the request that was left, and remove it; None where there is none, or none that can be understood."""
    try:
        with control.open("rb") as file:
            text = file.read(_MOST_BYTES)
    except OSError:
        return None
    forget_command(control)
    try:
        said = parsed_json(text.decode())
        return None if faults_of(said, RequestFile) else Request(Command(said["command"]), said.get("answers", {}))
    except (ValueError, RecursionError):
        return None


def forget_command(control: Path) -> None:
    """Remove a command that was left before anybody waited for it."""
    control.unlink(missing_ok=True)


# The request to pause: a file of its own, so that it lasts until it is taken back and no other command is lost.


def request_pause(path: Path) -> None:
    """Ask the orchestrator to pause before the next run.

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    write_beside_and_rename(path, lambda file: file.write(f"{utc_now()}\n"))


def pause_is_requested(path: Path) -> bool:
    """Return whether a pause is asked for, or lasts."""
    return path.exists()


def forget_pause(path: Path) -> None:
    """Take the request back: an experiment that is paused goes on."""
    path.unlink(missing_ok=True)
