"""Claims of an experiment, which keep other experiments on this machine from using the same robot or device.

Each claim is a file in `$XDG_STATE_HOME/robot-runner/claims/<host>` that is locked while the experiment is executed.
The system releases the lock when the process dies, however it dies; the file stays, and names the holder. What this
machine has claimed under another name, as DHCP gives it, is known by the holder's `machine`. That is for experiments of
this user; `shared_claims` keeps out those of other users.
"""

from __future__ import annotations

import fcntl
import os
import socket
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Self
from urllib.parse import quote, unquote

from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.storage.file_shapes import ClaimFile
from robot_runner.core.storage.guarded_files import open_descriptor
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.layout import user_folder
from robot_runner.core.storage.lock_files import sign, signature_of, this_boot, try_lock
from robot_runner.core.storage.shared_claims import hold_against_users, may_be_one
from robot_runner.core.storage.system_refusals import storage_error

#: How often a lock is tried that another process may have for a moment to look at it, and how long to wait between, s.
_TRIES, _BETWEEN = 50, 0.01
#: A claim file names at most so many folders of earlier holders that may have left something.
_MOST_EARLIER = 16
_HAVE_IT_WAIT = (
    "Have this one wait: `robot-runner queue add`, or `run --wait`; or end the other with Ctrl-C in its terminal."
)
_AWAIT_ITS_END = (
    "It ends by itself: try again in a moment, or have this one wait: `robot-runner run --wait`. If it goes on for "
    "minutes, start the other one again, which ends it."
)
_ASK_THEM = "Have this one wait: `robot-runner queue add`, or `run --wait`; or ask the other user."
_NAME_A_FOLDER = "Set XDG_STATE_HOME to a folder of your own."


def state_folder(name: str) -> Path:
    """Return a folder that this user's experiments on this machine share.

    Raises:
        StorageError: the user has no home folder, as in some containers.
    """
    return user_folder("XDG_STATE_HOME") / name / (quote(socket.gethostname(), safe="") or "host")


@dataclass(frozen=True, slots=True)
class ClaimHolder:
    """The holder of a claim: the experiment, its folder, its process, and since when (UTC).

    Attributes:
        before: the folders of earlier holders that were killed and may have left something.
        machine: its, as in `_this_machine`.
    """

    experiment: str = "another one"
    folder: str = "a folder that is not known"
    pid: int = 0
    since: str = "a moment ago"
    before: Sequence[str] = ()
    machine: str = ""

    def in_words(self) -> str:
        """Return the same in words."""
        return f"the experiment {self.experiment!r} in {self.folder} (process {self.pid}, since {self.since})"

    def left_in_words(self, root: str) -> str:
        """Return in words the experiment that was killed in `root`, this one or an earlier holder."""
        return self.in_words() if root == self.folder else f"an experiment in {root}"

    def roots_but(self, own: str) -> list[str]:
        """Return its folder and those of earlier holders, without `own`: any of them may have been killed."""
        return [each for each in dict.fromkeys((self.folder, *self.before)) if each != own]


def claim_holders(claims: Collection[str]) -> dict[str, ClaimHolder]:
    """Return the holders of these claims at this moment, without changing anything."""
    found: dict[str, ClaimHolder] = {}
    for claim in sorted(claims):
        with suppress(StorageError):
            for path in (*_under_other_names(quote(claim, safe="")), _path_of(claim)):
                with suppress(StorageError, OSError):
                    holder, is_held = _looked_at(path)
                    if is_held:
                        found[claim] = holder
    return found


def claiming_folders() -> list[Path]:
    """Return the existing folders of the last holders of all claims, without changing anything.

    Raises:
        StorageError: the user has no home folder, as in some containers.
    """
    found: dict[str, None] = {}
    for path in _files():
        with suppress(StorageError, OSError):
            found.update(dict.fromkeys(_looked_at(path)[0].roots_but("")))
    return [Path(each) for each in found if _is_folder(each)]


def _looked_at(path: Path) -> tuple[ClaimHolder, bool]:
    """Return the holder of a claim, or its last one, and whether it is held now.

    Of another machine with which the home folder is shared, none is returned.
    """
    descriptor = open_descriptor(path, path.parent, os.O_RDONLY)
    try:
        machine = _holder(descriptor).machine
        if path.parent != state_folder("claims") and (not machine or machine != _this_machine()):
            return ClaimHolder(), False
        is_held = not _locked(descriptor, fcntl.LOCK_SH)
        return _holder(descriptor), is_held
    finally:
        os.close(descriptor)


class HeldClaims:
    """Holds claims against other experiments. A context manager.

    Args:
        claims: what the experiment claims, such as `serial:/dev/ttyUSB0`.
        experiment: its name, for the message of an experiment that is refused.
        folder: its folder, likewise.
        wait: called repeatedly while others hold claims, with findings that name them; it waits a moment and returns,
            or raises. None to refuse the experiment instead.
        goes_on: returns whether processes of the experiment in a folder are alive though nobody executes it: after a
            kill the system has released its claims, but its run may still be closing, or its robot being stopped.
        own: claims that this process, or the one that has forked it, holds already. They are in nobody's way, and their
            files are not opened: a process that closes a file which it has locked loses its lock.

    Attributes:
        findings: warnings of claims whose files cannot be locked, so that others are not kept out.

    Raises:
        ExecutionError: on entering: another experiment holds some of them; each is named, with who holds it.
    """

    def __init__(
        self,
        claims: Collection[str],
        experiment: str,
        folder: Path,
        wait: Callable[[Sequence[Finding]], None] | None = None,
        goes_on: Callable[[Path], bool] = lambda _: False,
        own: Collection[str] = (),
    ) -> None:
        self._claims = sorted(claims)
        self._own = {*claims, *own}
        self._signature = ClaimHolder(experiment, str(folder), os.getpid(), machine=_this_machine())
        self._wait = wait
        self._goes_on = goes_on
        self._held = ExitStack()
        self._descriptors: list[int] = []
        self.findings: list[Finding] = []

    def __enter__(self) -> Self:
        while refusals := self._take_all():
            if self._wait is None:
                raise ExecutionError.of_findings(refusals)
            self._wait(refusals)
        return self

    def __exit__(self, *raised: object) -> None:
        self._held.close()

    def forget_earlier(self) -> None:
        """Forget earlier holders: their processes and robots were seen to, and the next holder need not."""
        for descriptor in self._descriptors:
            self._sign(descriptor, ())

    def _take_all(self) -> list[Finding]:
        """Take all claims, or none, and return their holders."""
        self.findings.clear()
        self._descriptors.clear()
        with ExitStack() as opened:
            refusals = [finding for claim in self._claims for finding in self._hold(claim, opened)]
            refusals += self._overlapping()
            refusals += [finding for claim in self._claims for finding in self._against_users(claim, opened)]
            if not refusals:
                self._held = opened.pop_all()
            return refusals

    def _overlapping(self) -> Iterator[Finding]:
        """Yield holders of the whole graph of one of our robots, or of a robot on a graph of ours."""
        paths: list[Path] = []
        with suppress(StorageError):  # of a user without a home folder: told where a claim is to be held
            paths = [path for path in _files() if unquote(path.name) not in self._own] + _under_other_names("*")
        for path in paths:
            other = unquote(path.name)
            with suppress(StorageError, OSError):
                claims = [*filter(partial(may_be_one, other), self._claims)]
                who, fix = self._who_has(path) if claims else ("", "")
                for claim in claims if who else ():
                    is_in_use = "is in use" if claim == other else f"may be one robot with {other}, which is in use"
                    yield Finding.error("claims", f"{claim} {is_in_use} by {who}", fix)

    def _who_has(self, path: Path) -> tuple[str, str]:
        """Return in words the holder of a claim, or one that left something there, and a fix; empty if none."""
        holder, is_held = _looked_at(path)
        return (holder.in_words(), _HAVE_IT_WAIT) if is_held else self._who_is_left(holder)

    def _who_is_left(self, before: ClaimHolder) -> tuple[str, str]:
        """Return in words an earlier holder that still has processes, and a fix; empty if there is none."""
        for root in before.roots_but(self._signature.folder):
            if self._goes_on(Path(root)):
                return f"the remaining processes of {before.left_in_words(root)}, which was killed", _AWAIT_ITS_END
        return "", ""

    def _against_users(self, claim: str, opened: ExitStack) -> Iterator[Finding]:
        try:
            for who in hold_against_users(claim, opened):
                yield Finding.error("claims", f"{claim} is in use by {who}", _ASK_THEM)
        except OSError as error:
            problem = f"other users who claim {claim} are not kept out: {error.strerror} ({error.filename})"
            self.findings.append(Finding.warning("claims", problem, "Correct what the system names."))

    def _hold(self, claim: str, opened: ExitStack, looked_at: ClaimHolder | None = None) -> Iterator[Finding]:
        """Lock the file of a claim; yield its holder, or one that left something unless that is `looked_at`."""
        try:
            path = _path_of(claim)
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            descriptor = open_descriptor(path, path.parent, mode=0o600)
            opened.callback(os.close, descriptor)
            is_mine = _locked(descriptor, fcntl.LOCK_EX)
        except (OSError, StorageError) as error:
            refusal = error if isinstance(error, StorageError) else storage_error(path, "locked", error)
            problem = f"other experiments that claim {claim} are not kept out: {refusal.problem} ({refusal.where})"
            self.findings.append(Finding.warning("claims", problem, _NAME_A_FOLDER))
            return
        if not is_mine:
            yield Finding.error("claims", f"{claim} is in use by {_holder(descriptor).in_words()}", _HAVE_IT_WAIT)
            return
        before = _holder(descriptor)
        earlier = before.roots_but(self._signature.folder)
        if earlier and before != looked_at:
            # Looking takes a while: the lock is released meanwhile, so that others are not refused because of us.
            fcntl.lockf(descriptor, fcntl.LOCK_UN)
            who, fix = self._who_is_left(before)
            if who:
                yield Finding.error("claims", f"{claim} is in use by {who}", fix)
            else:
                yield from self._hold(claim, opened, before)
            return
        self._descriptors.append(descriptor)
        # Earlier holders stay in the file until `forget_earlier`: this process may die before it cleans up.
        self._sign(descriptor, [each for each in earlier if _is_folder(each)][:_MOST_EARLIER])

    def _sign(self, descriptor: int, before: Sequence[str]) -> None:
        with suppress(OSError):  # on a full disk the holder is not named, but others are kept out all the same
            sign(descriptor, replace(self._signature, since=utc_now(), before=before))


def _is_folder(path: str) -> bool:
    """Return whether a path is a folder; False where the system cannot tell, as for a share that does not answer."""
    with suppress(OSError, ValueError):
        return bool(path) and Path(path).is_dir()
    return False


def _files() -> list[Path]:
    return sorted(state_folder("claims").glob("*"))


def _under_other_names(pattern: str) -> list[Path]:
    """Return the files of claims that were made under other names of this machine, or by others that share the home."""
    own = state_folder("claims")
    return sorted(path for path in own.parent.glob(f"*/{pattern}") if path.parent != own)


def _this_machine() -> str:
    """Return what tells this machine from others until it is started again; empty where that is not known.

    It is not made of names: they change, and those of copied systems are one. Containers with a network of their own
    count as machines, since they have graphs of their own.
    """
    with suppress(OSError):
        if boot := this_boot():
            return f"{boot} {Path('/proc/self/ns/net').readlink()}"
    return ""


def _path_of(claim: str) -> Path:
    return state_folder("claims") / quote(claim, safe="")


def _locked(descriptor: int, kind: int) -> bool:
    """Lock the file of a claim, and return whether that succeeded: no other process holds the claim.

    Looking at a claim takes a shared lock for a moment, which must refuse nobody.
    """
    for _ in range(_TRIES):
        if try_lock(descriptor, kind):
            return True
        if kind == fcntl.LOCK_SH or not try_lock(descriptor, fcntl.LOCK_SH):
            return False
        time.sleep(_BETWEEN)
    return False


def _holder(descriptor: int) -> ClaimHolder:
    return ClaimHolder(**(signature_of(descriptor, ClaimFile) or {}))
