"""Lock files of an experiment that other local users cannot lock, and so cannot use to block its owner.

A user who can open a file can lock it. So only the owner may open these files, and a group that may write in the
experiment's folder. Earlier versions made them readable by everybody, so another user may still have one open: such a
file is replaced, as changing its permissions would be too late.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import stat
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.declared_shapes import faults_of
from robot_runner.core.storage.guarded_files import open_descriptor
from robot_runner.core.storage.guarded_paths import rights_of

#: The longest signature that is read: the holder of a claim names folders, and a path may have 4096 bytes.
_MOST_BYTES = 128 * 1024
_OWNER, _GROUP = 0o600, 0o060
#: How often a lock is tried that another process replaces at the same moment, and how long to wait between, s.
_TRIES, _BETWEEN = 50, 0.01


def open_to_lock(path: Path, root: Path) -> int:
    """Return a descriptor of a file to lock, which is made where it is missing; no other user can open it.

    Raises:
        StorageError: it is not a regular file, or cannot be written.
    """
    wanted = _wanted(root)
    descriptor = open_descriptor(path, root, mode=wanted)
    found = os.fstat(descriptor)
    if found.st_uid == os.geteuid() and wanted & ~found.st_mode:  # the umask has removed the group's rights
        _set_rights(descriptor, stat.S_IMODE(found.st_mode) | wanted)
    return descriptor


def was_open_to_strangers(path: Path, root: Path) -> bool:
    """Return whether users who may not write in the experiment's folder can open the file, and so lock it."""
    try:
        return bool(stat.S_IMODE(path.lstat().st_mode) & 0o077 & ~_wanted(root))
    except FileNotFoundError:
        return False


def lock_exclusively(path: Path) -> int | None:
    """Lock a file with a POSIX record lock, and return its descriptor; None where another process of ours holds it.

    Only exclusive locks count, since they need the right to write. Users with the right to read can hold a shared lock:
    then the file is replaced by one that they cannot open.

    Raises:
        StorageError: the file cannot be opened, or its file system offers no locks.
    """
    for _ in range(_TRIES):
        descriptor = open_to_lock(path, path.parent)
        if _strangers_may_write(descriptor, path):
            taken = _put_in_place(path, descriptor)
        elif _try(descriptor, fcntl.LOCK_EX, path):
            taken = _narrowed(descriptor, path)
        elif _try(descriptor, fcntl.LOCK_SH, path):
            taken = _put_in_place(path, descriptor)
        else:
            os.close(descriptor)
            return None
        if taken != descriptor:
            os.close(descriptor)
        if taken is not None and is_at(taken, path):
            return taken
        if taken is not None:
            os.close(taken)
        time.sleep(_BETWEEN)  # another process of ours has replaced it meanwhile
    return None


def is_held_exclusively(descriptor: int, path: Path) -> bool:
    """Return whether another process of ours holds the lock of a file that is open for reading."""
    try:
        return not _strangers_may_write(descriptor, path) and not try_lock(descriptor, fcntl.LOCK_SH)
    except OSError:  # where its file system offers no locks, nobody can hold one
        return False


def _put_in_place(path: Path, old: int) -> int | None:
    """Replace a lock file that other users can lock by a new, locked one, and return its descriptor.

    No process of ours can lock the old file exclusively meanwhile: the caller holds a shared lock, or it is not in use.
    Of several processes that do this at once, the one that locks the new file wins; the others get None.
    """
    new = path.with_name(f"{path.name}.new")
    descriptor = open_to_lock(new, path.parent)
    if _try(descriptor, fcntl.LOCK_EX, new) and is_at(descriptor, new):
        if is_at(old, path):
            new.replace(path)
            return _narrowed(descriptor, path)
        new.unlink()  # another process was faster
    os.close(descriptor)
    return None


def _narrowed(descriptor: int, path: Path) -> int:
    if os.fstat(descriptor).st_uid == os.geteuid():
        _set_rights(descriptor, _wanted(path.parent))
    return descriptor


def _set_rights(descriptor: int, mode: int) -> None:
    """Change a file's permissions, where its file system has any (FAT has none)."""
    try:
        os.fchmod(descriptor, mode)
    except OSError as error:
        if error.errno not in {errno.EPERM, errno.EACCES, errno.ENOTSUP, errno.ENOSYS}:
            raise


def _strangers_may_write(descriptor: int, path: Path) -> bool:
    if os.stat(path.parent).st_mode & (stat.S_IWOTH | stat.S_ISVTX) == stat.S_IWOTH:  # noqa: PTH116 - as `rights_of`
        return False  # everybody may remove the file here anyway
    return bool(os.fstat(descriptor).st_mode & 0o022 & ~_wanted(path.parent))


def try_lock(descriptor: int, kind: int) -> bool:
    """Lock a file, `fcntl.LOCK_EX` or `fcntl.LOCK_SH`, without waiting; return whether that succeeded.

    Raises:
        OSError: its file system offers no locks.
    """
    try:
        fcntl.lockf(descriptor, kind | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in {errno.EACCES, errno.EAGAIN}:
            return False
        raise
    return True


def sign(descriptor: int, signature: Any) -> None:
    """Write the holder, a dataclass, into a locked file; raise an `OSError` if the disk is full."""
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(asdict(signature)).encode(), 0)


def signature_of(descriptor: int, shape: Any) -> dict[str, Any] | None:
    """Return the holder in a locked file, by the keys of a TypedDict; None if it has none (yet)."""
    try:
        said = json.loads(os.pread(descriptor, _MOST_BYTES, 0))
    except (ValueError, RecursionError):
        said = None
    return None if faults_of(said, shape) else {name: said[name] for name in shape.__annotations__ if name in said}


def this_boot() -> str:
    """Return the identifier of this machine's present boot (Linux); elsewhere an empty text."""
    with suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return ""


def _try(descriptor: int, kind: int, path: Path) -> bool:
    try:
        return try_lock(descriptor, kind)
    except OSError as error:
        os.close(descriptor)
        problem = f"the folder's file system offers no locks: {error.strerror}"
        fix = "Keep the results on a local disk (results_output_path)."
        raise StorageError(problem, where=str(path), fix=fix) from error


def is_at(descriptor: int, path: Path) -> bool:
    """Return whether an open file is the one at `path`."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError as error:
        if error.errno in {errno.ENOENT, errno.ESTALE}:  # ESTALE: another machine has removed it
            return False
        raise


def _wanted(root: Path) -> int:
    return _OWNER | (_GROUP if rights_of(root) & stat.S_IWGRP else 0)
