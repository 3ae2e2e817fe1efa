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
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Self
from urllib.parse import quote

from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.storage.guarded_files import open_descriptor
from robot_runner.core.storage.journal import utc_now

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

__all__ = ["HeldClaims"]

#: Nobody signs with more.
_MOST_BYTES = 4096


class HeldClaims:
    """Holds claims against other experiments. A context manager.

    Args:
        claims: what the experiment claims, such as `serial:/dev/ttyUSB0`.
        experiment: its name, which is told to who is refused.
        folder: its folder, likewise.

    Attributes:
        findings: that claims could not be held, as their files cannot be written; others are not kept out then.

    Raises:
        ExecutionError: on entering: another experiment holds some of them; each is named, with who holds it.
    """

    def __init__(self, claims: Collection[str], experiment: str, folder: Path) -> None:
        self._claims = sorted(claims)
        self._signature = json.dumps(
            {"experiment": experiment, "folder": str(folder), "pid": os.getpid(), "since": utc_now()}
        )
        self._held = ExitStack()
        self.findings: list[Finding] = []

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            refusals = [finding for claim in self._claims for finding in self._hold(claim, opened)]
            if refusals:
                raise ExecutionError.of_findings(refusals)
            self._held = opened.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        self._held.close()

    def _hold(self, claim: str, opened: ExitStack) -> Iterator[Finding]:
        """Lock the file of a claim; yield who has it where somebody has."""
        path = _folder() / quote(claim, safe="")
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            descriptor = open_descriptor(path, path.parent, mode=0o600)
        except (OSError, StorageError) as error:
            reason = error.problem if isinstance(error, StorageError) else error.strerror
            problem = f"nobody is kept out who claims {claim} as well, as {path} cannot be written: {reason}"
            self.findings.append(Finding.warning("claims", problem, "Set XDG_STATE_HOME to a folder of your own."))
            return
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in {errno.EACCES, errno.EAGAIN}:
                yield _refusal(claim, descriptor)
            os.close(descriptor)
            return
        opened.callback(os.close, descriptor)
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, self._signature.encode(), 0)


def _folder() -> Path:
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(home).expanduser() / "robot-runner" / "claims" / (quote(socket.gethostname(), safe="") or "host")


def _refusal(claim: str, descriptor: int) -> Finding:
    holder: dict[str, object] = {}
    with suppress(ValueError):  # locked and not yet signed
        read = json.loads(os.pread(descriptor, _MOST_BYTES, 0))
        holder = read if isinstance(read, dict) else {}
    name, folder = holder.get("experiment", "another one"), holder.get("folder", "a folder that is not known")
    process = f"process {holder.get('pid', 'unknown')}, since {holder.get('since', 'a moment ago')}"
    problem = f"{claim} is in use by the experiment {name!r} in {folder} ({process})"
    return Finding.error("claims", problem, "Wait until it has ended, or end it with Ctrl-C in its terminal.")
