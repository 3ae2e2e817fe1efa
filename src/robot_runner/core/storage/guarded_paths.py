"""Folders of an experiment: reached without links below the experiment's folder, and never outside it.

`guarded_files` opens files in them. Each folder is opened relative to the descriptor of the one above it, so that none
on the way can be replaced by a link after it was checked.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.system_refusals import storage_error, storage_errors

#: A folder that is only passed through need not be readable.
_FOLDER = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC

_KINDS = {
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
    stat.S_IFREG: "a regular file",
}
ONLY_FILES = "Put the file or folder itself in its place, or remove it: links, pipes and devices are not opened here."


class MissingFileError(StorageError):
    """There is no such file."""


def make_folder(path: Path, root: Path) -> None:
    """Make a folder inside the experiment's, and those above it; it may exist.

    Raises:
        StorageError: a part of the path is a link or no folder, or the system refuses.
    """
    if path != root:
        with refusals(path, root, "made") as (top, parts), folder_inside(top, parts, make=True):
            pass


def make_experiment_folder(root: Path) -> None:
    """Make the folder of an experiment, for its owner alone, since raw data may be private.

    Where the folder above passes its group on (`chmod g+s`), a group shares it on purpose, and gets the rights that the
    user's umask allows. An existing folder keeps its permissions.

    Raises:
        StorageError: it cannot be made.
    """
    with storage_errors(root, "made"):
        root.parent.mkdir(parents=True, exist_ok=True)
        is_shared = bool(root.parent.stat().st_mode & stat.S_ISGID)
        root.mkdir(0o770 if is_shared else 0o700, exist_ok=True)


def open_folder(root: Path, folders: Sequence[str], *, make: bool = False) -> int:
    """Return a descriptor of a folder in an experiment's, reached without links; `make` makes those on the way."""
    folder = os.open(root, _FOLDER)
    for name in folders:
        try:
            if make:
                with suppress(FileExistsError):
                    os.mkdir(name, rights_of(root), dir_fd=folder)
            below = os.open(name, _FOLDER | os.O_NOFOLLOW, dir_fd=folder)
        finally:
            os.close(folder)
        folder = below
    return folder


@contextmanager
def folder_inside(root: Path, folders: Sequence[str], *, make: bool = False) -> Iterator[int]:
    """Hold a descriptor of a folder in an experiment's, reached without links, and close it at the end."""
    folder = open_folder(root, folders, make=make)
    try:
        yield folder
    finally:
        os.close(folder)


@contextmanager
def refusals(path: Path, root: Path | None, action: str) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """Yield the experiment's folder and the parts of a path below it; an OSError becomes a `StorageError`."""
    top = root or path.parent
    try:
        yield top, parts_below(path, top)
    except OSError as error:
        raise refusal_of(path, top, action, error) from error


def parts_below(path: Path, root: Path) -> tuple[str, ...]:
    """Return the parts of a path below the experiment's folder.

    Raises:
        StorageError: the path leads out of the experiment's folder.
    """
    above, parts = root.parts, path.parts  # not by `relative_to`, which is slow: each opening asks for them
    is_below = parts[: len(above)] == above and path.anchor == root.anchor
    parts = parts[len(above) :]
    if not (is_below and parts) or ".." in parts or any("\0" in part for part in parts):
        problem = "the path leads out of the experiment's folder"
        raise StorageError(problem, where=str(path), fix=f"Name a file inside {root}.")
    return parts


def rights_of(root: Path) -> int:
    """Return the permissions of the experiment's folder, which those of its files and folders follow.

    Raises:
        StorageError: there is no such folder.
    """
    with storage_errors(root, "read"):
        return root.stat().st_mode & 0o777


def refusal_of(path: Path, root: Path, action: str, error: OSError) -> StorageError:
    """Return the error for an OSError; where a part of the path is a link, it names that."""
    if error.errno in {errno.ELOOP, errno.ENOTDIR}:
        below = path.relative_to(root)
        for part in (*reversed(below.parents[:-1]), below):
            with suppress(OSError):
                if not stat.S_ISDIR(mode := os.lstat(root / part).st_mode):
                    problem = f"the folder {str(part)!r} is {kind_of(mode)}, not a folder"
                    return StorageError(problem, where=str(path), fix=ONLY_FILES)
    refusal = storage_error(path, action, error)
    if error.errno == errno.ENOENT:
        return MissingFileError(refusal.problem, where=refusal.where, fix=refusal.fix)
    return refusal


def kind_of(mode: int) -> str:
    """Return the kind of a file in words, by its `st_mode`."""
    return _KINDS.get(stat.S_IFMT(mode), "something else")
