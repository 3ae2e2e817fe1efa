"""What the system refuses of a file or folder, as an error with a fix; and folders flushed where it lets us."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

from robot_runner.core.errors import StorageError

if TYPE_CHECKING:
    from pathlib import Path


_FIXES = {
    errno.ENOSPC: "Make room on the disk, then try again.",
    errno.EDQUOT: "Make room in your quota, then try again.",
    errno.EACCES: "Mend the permissions of the file and its folder.",
    errno.EPERM: "Mend the permissions of the file and its folder.",
    errno.EROFS: "Choose a folder on a file system that can be written.",
    errno.ENOENT: "Mend the path, or make the folder first.",
    errno.ENOTDIR: "Mend the path: a part of it is a file.",
    errno.EISDIR: "Move the folder of that name out of the way.",
    errno.ENAMETOOLONG: "Choose a shorter name.",
}


def fsync_folder(folder: Path) -> None:
    """Flush a folder to the disk, so that what was made or renamed in it is still there after a power cut.

    Raises:
        OSError: it cannot be opened or flushed.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in {errno.EINVAL, errno.ENOTSUP}:  # some network file systems flush no folders
            raise
    finally:
        os.close(descriptor)


def storage_error(path: Path, action: str, error: OSError) -> StorageError:
    """Return the error to raise where the system refused a file."""
    reason = error.strerror or str(error)
    fix = _FIXES.get(error.errno or 0, "Mend what the system names, then try again.")
    kind = "folder" if action == "made" or os.path.isdir(path) else "file"  # noqa: PTH112  # it raises nothing for a name that is too long
    return StorageError(f"the {kind} cannot be {action}: {reason}", where=str(path), fix=fix)
