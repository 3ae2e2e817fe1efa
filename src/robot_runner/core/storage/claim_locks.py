"""What an experiment has claimed for itself, known to other experiments of this user on this machine.

Each claim is a file in `$XDG_STATE_HOME/robot-runner/claims/<host>` that is locked while the experiment is executed.
The system lets go of the lock when the process dies, however it dies; the file stays.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import time
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self
from urllib.parse import quote

from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.storage.declared_shapes import faults_of
from robot_runner.core.storage.file_shapes import ClaimFile
from robot_runner.core.storage.guarded_files import open_descriptor
from robot_runner.core.storage.journal import utc_now

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence


#: Nobody signs with more.
_MOST_BYTES = 4096
#: How often a file is tried that nobody holds and somebody merely looks at, and how long to wait between, s.
_TRIES, _BETWEEN = 50, 0.01
_SIGNED = tuple(ClaimFile.__annotations__)


def state_folder(name: str) -> Path:
    """Return the folder for what this user's experiments on this machine know of each other."""
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(home).expanduser() / "robot-runner" / name / (quote(socket.gethostname(), safe="") or "host")


@dataclass(frozen=True, slots=True)
class ClaimHolder:
    """Who has claimed something: the experiment, its folder, its process, and since when (UTC)."""

    experiment: str = "another one"
    folder: str = "a folder that is not known"
    pid: int = 0
    since: str = "a moment ago"

    def in_words(self) -> str:
        """Return the same as a user reads it."""
        return f"the experiment {self.experiment!r} in {self.folder} (process {self.pid}, since {self.since})"


def claim_holders(claims: Collection[str]) -> dict[str, ClaimHolder]:
    """Return which of these claims are held at this moment, and by whom; nothing is changed by asking."""
    found: dict[str, ClaimHolder] = {}
    for claim in sorted(claims):
        path = _path_of(claim)
        with suppress(StorageError):
            descriptor = open_descriptor(path, path.parent, os.O_RDONLY)
            try:
                if not _locked(descriptor, fcntl.LOCK_SH):
                    found[claim] = _holder(descriptor)
            finally:
                os.close(descriptor)
    return found


class HeldClaims:
    """Holds claims against other experiments. A context manager.

    Args:
        claims: what the experiment claims, such as `serial:/dev/ttyUSB0`.
        experiment: its name, which is told to who is refused.
        folder: its folder, likewise.
        wait: called with who holds the claims where others do, again and again; it waits a moment and returns, or
            raises. None where the experiment is refused then.

    Attributes:
        findings: that claims could not be held, as their files cannot be written; others are not kept out then.

    Raises:
        ExecutionError: on entering: another experiment holds some of them; each is named, with who holds it.
    """

    def __init__(
        self,
        claims: Collection[str],
        experiment: str,
        folder: Path,
        wait: Callable[[Sequence[Finding]], None] | None = None,
    ) -> None:
        self._claims = sorted(claims)
        self._signature = ClaimHolder(experiment, str(folder), os.getpid())
        self._wait = wait
        self._held = ExitStack()
        self.findings: list[Finding] = []

    def __enter__(self) -> Self:
        while refusals := self._take_all():
            if self._wait is None:
                raise ExecutionError.of_findings(refusals)
            self._wait(refusals)
        return self

    def __exit__(self, *raised: object) -> None:
        self._held.close()

    def _take_all(self) -> list[Finding]:
        """Take all claims, or none: then return who has those that are in use."""
        self.findings.clear()
        with ExitStack() as opened:
            refusals = [finding for claim in self._claims for finding in self._hold(claim, opened)]
            if not refusals:
                self._held = opened.pop_all()
            return refusals

    def _hold(self, claim: str, opened: ExitStack) -> Iterator[Finding]:
        """Lock the file of a claim; yield who has it where somebody has."""
        path = _path_of(claim)
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            descriptor = open_descriptor(path, path.parent, mode=0o600)
        except (OSError, StorageError) as error:
            reason = error.problem if isinstance(error, StorageError) else error.strerror
            problem = f"nobody is kept out who claims {claim} as well, as {path} cannot be written: {reason}"
            self.findings.append(Finding.warning("claims", problem, "Set XDG_STATE_HOME to a folder of your own."))
            return
        try:
            is_mine = _locked(descriptor, fcntl.LOCK_EX)
        except OSError:  # the file system has no locks
            os.close(descriptor)
            return
        if not is_mine:
            yield _refusal(claim, _holder(descriptor))
            os.close(descriptor)
            return
        opened.callback(os.close, descriptor)
        os.ftruncate(descriptor, 0)
        signature = {**asdict(self._signature), "since": utc_now()}
        os.pwrite(descriptor, json.dumps(signature).encode(), 0)


def _path_of(claim: str) -> Path:
    return state_folder("claims") / quote(claim, safe="")


def _locked(descriptor: int, kind: int) -> bool:
    """Lock a file, and return whether that was possible: nobody holds it who has claimed what it stands for.

    Who merely looks has a shared lock for a moment; that refuses nobody.
    """
    for _ in range(_TRIES):
        if _tried(descriptor, kind):
            return True
        if kind == fcntl.LOCK_SH or not _tried(descriptor, fcntl.LOCK_SH):
            return False
        time.sleep(_BETWEEN)
    return False


def _tried(descriptor: int, kind: int) -> bool:
    try:
        fcntl.lockf(descriptor, kind | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in {errno.EACCES, errno.EAGAIN}:
            return False
        raise
    return True


def _holder(descriptor: int) -> ClaimHolder:
    try:
        said = json.loads(os.pread(descriptor, _MOST_BYTES, 0))
    except (ValueError, RecursionError):  # locked and not yet signed
        said = None
    return ClaimHolder() if faults_of(said, ClaimFile) else ClaimHolder(**{name: said[name] for name in _SIGNED})


def _refusal(claim: str, holder: ClaimHolder) -> Finding:
    fix = "Have this one wait: `robot-runner queue add`, or `run --wait`; or end the other with Ctrl-C in its terminal."
    return Finding.error("claims", f"{claim} is in use by {holder.in_words()}", fix)
