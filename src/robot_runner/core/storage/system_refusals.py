"""An OSError about a file or folder as a `StorageError` with a fix; and flushing both to the disk."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from robot_runner.core.errors import StorageError

#: Errors of a USB stick that was pulled out, a failing disk, or a network folder whose server or FUSE process is gone.
GONE = frozenset(
    {errno.EIO, errno.ENODEV, errno.ENXIO, errno.ENOTCONN, errno.ESTALE, errno.EHOSTDOWN, errno.EHOSTUNREACH}
)
_FIXES = {
    errno.ENOSPC: "Make room on the disk, then try again.",
    errno.EDQUOT: "Make room in your quota, then try again.",
    errno.EACCES: "Correct the permissions of the file and its folder.",
    errno.EPERM: "Correct the permissions of the file and its folder.",
    errno.EROFS: "Choose a folder on a file system that can be written.",
    errno.ENOENT: "Correct the path, or make the folder first.",
    errno.ENOTDIR: "Correct the path: a part of it is a file.",
    errno.EISDIR: "Move the folder of that name out of the way.",
    errno.ENAMETOOLONG: "Choose a shorter name.",
    errno.EFBIG: "Raise the limit of a file's size (ulimit -f), or choose a file system for larger files.",
    errno.EMFILE: "Raise the limit of open files (ulimit -n).",
    **dict.fromkeys(GONE, "See that its disk or network folder is there again, and sound; then try again."),
}

#: Errors of file systems that cannot flush: FUSE, networks, pseudo-files of some containers.
_CANNOT_FLUSH = frozenset({errno.EINVAL, errno.ENOTSUP, errno.ENOSYS})


def fsync_file(descriptor: int) -> None:
    """Flush an open file or folder to the disk, where its file system can.

    Raises:
        OSError: it cannot be flushed.
    """
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT_FLUSH:
            raise


def fsync_folder(folder: Path) -> None:
    """Flush a folder to the disk, so that files made or renamed in it survive a power failure.

    Raises:
        OSError: it cannot be opened or flushed.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fsync_file(descriptor)
    finally:
        os.close(descriptor)


def storage_error(path: Path, action: str, error: OSError) -> StorageError:
    """Return the error for an OSError; `action` completes "the file cannot be ..."."""
    reason = error.strerror or str(error)
    fix = _FIXES.get(error.errno or 0, "Correct what the system names, then try again.")
    if error.errno == errno.ENOSPC and _lacks_inodes(path.parent):
        fix = "Remove files, however small: the disk has room, and no inodes (df -i). Then try again."
    if error.errno in {errno.EACCES, errno.EPERM} and (whose := _whose(path)):
        fix = f"{whose}: have it given to you (sudo chown), or shared with you (chmod)."
    kind = "folder" if action == "made" or os.path.isdir(path) else "file"  # noqa: PTH112  # it raises nothing for a name that is too long
    return StorageError(f"the {kind} cannot be {action}: {reason}", where=str(path), fix=fix)


@contextmanager
def storage_errors(path: Path, action: str) -> Iterator[None]:
    """Turn an OSError into a `StorageError`; `action` completes "the file cannot be ..."."""
    try:
        yield
    except OSError as error:
        raise storage_error(path, action, error) from error


def _lacks_inodes(folder: Path) -> bool:
    """Return whether a disk that refuses another file has space but no inodes (`df -i`)."""
    try:
        found = os.statvfs(folder)
    except OSError:
        return False
    return found.f_files > 0 and found.f_favail == 0 and found.f_bavail > 0


def _whose(path: Path) -> str:
    """Return in words the owner of a file, or of the existing folder above it, where it is another user; else empty."""
    for each in (path, *path.parents):
        with suppress(OSError):
            owner = each.lstat().st_uid
            return "" if owner == os.geteuid() else f"{'It' if each == path else each} is {user_name(owner)}'s"
    return ""


def user_name(user: int) -> str:
    """Return the name of a user, or the number if it has none."""
    import pwd  # noqa: PLC0415 - of errors alone

    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:  # in a container, or of a computer that is not reached
        return f"user {user}"
