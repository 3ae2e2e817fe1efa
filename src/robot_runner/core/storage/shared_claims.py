"""Claims that other users of this machine see: locked files in a folder where only owners can remove their files.

Each user has an empty file there for each claim, with a shared `flock` while an experiment of theirs goes on. Forked
processes inherit it: it is released once the last of them has died, however it dies. A process locks its own user's
file first and then looks at those of others, so that of two at the same time never both go on. Of another user's file
only owner and lock are looked at: so another user can do no more than keep us out, and is named then.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from hashlib import sha256
from pathlib import Path
from urllib.parse import quote, unquote

from robot_runner.core.storage.lock_files import is_at
from robot_runner.core.storage.system_refusals import user_name

#: Folders where all users of a machine may make files; the first existing one is used, so that all use the same.
_FOLDERS = (Path("/run/lock"), Path("/tmp"))  # noqa: S108 - shared on purpose, see above
#: The variable that names another folder, as for users in different containers; if empty, no other user is kept out.
_VARIABLE = "ROBOT_RUNNER_LOCKS"
_PREFIX = "robot-runner-claim."
#: The longest claim in a file's name, bytes: with the user's number, the name may have 255.
_MOST_BYTES = 200
#: Others may read it, to see whether it is locked.
_MODE = 0o644
#: O_NONBLOCK matters only if somebody has put a pipe there.
_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
#: How often a lock is tried that another process may have for a moment to look at it, and how long to wait between, s.
_TRIES, _BETWEEN = 50, 0.01


#: The files that this process and its forks hold: descriptor, and device and inode.
_held: dict[int, tuple[int, int]] = {}


def held_against_users() -> list[int]:
    """Return the descriptors that a program has to inherit to hold these claims, too; forks hold them in any case."""
    return [descriptor for descriptor, file in _held.items() if _file_of(descriptor) == file]


def hold_inherited(descriptors: Iterable[int]) -> None:
    """Remember the descriptors that this program has inherited, to pass them on in its turn."""
    for descriptor in descriptors:
        if (file := _file_of(descriptor)) is not None:
            os.set_inheritable(descriptor, False)  # noqa: FBT003 - the system's own signature
            _held[descriptor] = file


def _file_of(descriptor: int) -> tuple[int, int] | None:
    try:
        found = os.fstat(descriptor)
    except OSError:  # somebody has closed it
        return None
    return found.st_dev, found.st_ino


def may_be_one(claim: str, other: str) -> bool:
    """Return whether two claims may be about one robot: a claim without a namespace is about a whole graph.

    Example:
        >>> [may_be_one(each, "robot:domain 0/alice") for each in ("robot:domain 0", "robot:domain 0/bob")]
        [True, False]
    """
    if not claim.startswith("robot:"):
        return claim == other
    return claim == other or claim.startswith(f"{other}/") or other.startswith(f"{claim}/")


def hold_against_users(claim: str, opened: ExitStack) -> Iterator[str]:
    """Hold a claim against other users of this machine until `opened` is closed, and yield its other holders.

    Where the machine has no folder for all users, nothing is done.

    Raises:
        OSError: the file cannot be made or locked, or the folder that the environment names is not suitable.
    """
    folder = _folder()
    if folder is None:
        return
    name = quote(claim, safe="")
    name = name if len(name) <= _MOST_BYTES else sha256(claim.encode()).hexdigest()
    own = folder / f"{_PREFIX}{os.geteuid()}.{name}"
    if who := _hold(own, opened):
        yield who
    for path in sorted(folder.glob(f"{_PREFIX}*")):
        user, _, others = path.name.removeprefix(_PREFIX).partition(".")
        if path != own and (others == name or may_be_one(unquote(others), claim)) and user != str(os.geteuid()):
            yield from _holder(path, user)


def _folder() -> Path | None:
    named = os.environ.get(_VARIABLE)
    if named is None:
        return next(filter(_is_everybodys, map(Path.resolve, _FOLDERS)), None)  # on macOS, /tmp is a link
    if named and not _is_everybodys(Path(named)):
        raise OSError(errno.EINVAL, f"{_VARIABLE} is to name a folder of root with mode 1777", named)
    return Path(named) if named else None


def _is_everybodys(folder: Path) -> bool:
    """Return whether a folder is root's, and everybody may make files in it, but not remove another user's."""
    try:
        found = folder.lstat()
    except OSError:
        return False
    wanted = stat.S_ISVTX | 0o777
    return stat.S_ISDIR(found.st_mode) and found.st_uid == 0 and found.st_mode & wanted == wanted


def _hold(path: Path, opened: ExitStack) -> str:
    """Lock our own file; return the holder that prevents that, or empty."""
    for _ in range(_TRIES):
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CREAT | _FLAGS, _MODE)
        except OSError:
            if (owner := _owner(path)) in {None, os.geteuid()}:
                raise
            return f"{user_name(owner)}, who has put {path} in our place"
        held = ExitStack()
        held.callback(os.close, descriptor)
        found = os.fstat(descriptor)
        is_own = found.st_uid == os.geteuid() and stat.S_ISREG(found.st_mode)
        if not is_own or found.st_nlink > 1:  # by a hard link, we would open a private file of ours to all
            held.close()
            return f"{'another user' if is_own else user_name(found.st_uid)}, who has put {path} in our place"
        if stat.S_IMODE(found.st_mode) != _MODE:  # the umask has removed others' right to read
            os.fchmod(descriptor, _MODE)
        if _flock(descriptor, fcntl.LOCK_SH) and is_at(descriptor, path):  # else it was removed meanwhile
            opened.callback(_let_go, descriptor, path)
            _held[descriptor] = (found.st_dev, found.st_ino)
            return ""
        locker = _locker(descriptor)
        held.close()
        time.sleep(_BETWEEN)
    return f"{locker or 'another user'}, who keeps {path} locked"


def _let_go(descriptor: int, path: Path) -> None:
    """Release our own file, and remove it unless a process that we have started still holds it."""
    _held.pop(descriptor, None)
    os.close(descriptor)
    with suppress(OSError):
        again = os.open(path, os.O_RDONLY | _FLAGS)
        try:
            if _flock(again, fcntl.LOCK_EX) and is_at(again, path):
                path.unlink()
        finally:
            os.close(again)


def _holder(path: Path, user: str) -> Iterator[str]:
    """Yield the holder of another user's file, if there is one; a file that is not that user's own is ignored."""
    try:
        descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    except OSError:
        return
    try:
        found = os.fstat(descriptor)
        if str(found.st_uid) == user and stat.S_ISREG(found.st_mode) and _is_held(descriptor):
            yield f"an experiment of {_locker(descriptor) or user_name(found.st_uid)}"
    finally:
        os.close(descriptor)


def _is_held(descriptor: int) -> bool:
    for _ in range(_TRIES):
        if _flock(descriptor, fcntl.LOCK_EX):
            fcntl.flock(descriptor, fcntl.LOCK_UN)
            return False
        if _flock(descriptor, fcntl.LOCK_SH):  # else another process looks at it, as we do
            fcntl.flock(descriptor, fcntl.LOCK_UN)
            return True
        time.sleep(_BETWEEN)
    return True


def _flock(descriptor: int, kind: int) -> bool:
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _locker(descriptor: int) -> str:
    """Return in words the process that has locked a file; empty where the system hides it (`man 5 proc_locks`)."""
    found = os.fstat(descriptor)
    inode = f"{os.major(found.st_dev):02x}:{os.minor(found.st_dev):02x}:{found.st_ino}"
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            _, kind, _, _, pid, where, *_ = line.split()
            if kind == "FLOCK" and where == inode and (owner := _owner(Path("/proc") / pid)) is not None:
                return f"{user_name(owner)} (process {pid})"
    return ""


def _owner(path: Path) -> int | None:
    try:
        return path.lstat().st_uid
    except OSError:
        return None
