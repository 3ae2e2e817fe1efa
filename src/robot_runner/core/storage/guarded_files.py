"""The one way to open a file of an experiment folder, which an attacker may have prepared.

Folders come by git, tar and shared disks. So below the experiment's folder no symbolic link is followed, neither in
place of a file nor of a folder on the way to it; only regular files are opened, so that a named pipe or a device is not
waited for; what is read whole has a limit. The folder itself may be reached over links: people keep results on other
disks.

Whoever may read the experiment's folder may read what is made in it, as far as the user's umask allows: its permissions
are those of the files (0700 gives 0600).

Each function takes the file's path and the experiment's folder, `root`; without it, the file's own folder is meant.
What cannot be done is a `StorageError` that names the file, why, and what to do; a missing file a `MissingFileError`.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO, cast

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.declared_shapes import DEEPEST, levels_of, parsed_json, shape_findings
from robot_runner.core.storage.guarded_paths import (
    ONLY_FILES,
    MissingFileError,
    folder_inside,
    kind_of,
    make_experiment_folder,
    make_folder,
    refusals,
    rights_of,
)
from robot_runner.core.storage.system_refusals import fsync_file, fsync_folder, storage_errors

if TYPE_CHECKING:
    from io import BufferedReader

__all__ = [
    "LINE_LIMIT",
    "DamagedFileError",
    "MissingFileError",
    "make_experiment_folder",
    "make_folder",
    "open_descriptor",
    "open_text",
    "open_to_append",
    "open_to_fill",
    "open_to_read",
    "open_to_write",
    "read_blocks",
    "read_bytes",
    "read_declared",
    "read_json",
    "read_text",
    "remove",
    "replace",
    "require_file",
    "sha256_of",
]

#: JSON takes up to 24 times its length in memory (a list of empty objects): 8 MB become 200 MB.
JSON_LIMIT = 8_000_000
#: Text that is read whole, and the longest line of what is read line by line.
TEXT_LIMIT = 64_000_000
LINE_LIMIT = 16_000_000
#: How much of a file of many lines is read at once.
_BLOCK = 1_000_000

#: O_NONBLOCK has a meaning for pipes and devices only, which may have taken the file's place since we looked.
_FILE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC

_UNITS = ("B", "kB", "MB", "GB", "TB")
_WRITING = os.O_WRONLY | os.O_RDWR


class DamagedFileError(StorageError):
    """The content of a file is not text, not JSON, too large, or nested too deeply."""


def require_file(path: Path, root: Path | None = None) -> None:
    """Require a regular file that is reached without links, for a library that opens it by its name.

    Raises:
        MissingFileError: there is none.
        StorageError: it is not a regular file inside the folder.
    """
    with refusals(path, root, "read") as (top, (*folders, name)), folder_inside(top, folders) as folder:
        _require_regular(path, os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)


def open_to_read(path: Path, root: Path | None = None, *, limit: int | None = None) -> BufferedReader:
    """Open a file to read its bytes; `root` is the experiment's folder.

    A file with more bytes than `limit` is refused; it is None where the file is read piece by piece.

    Raises:
        MissingFileError: there is none.
        StorageError: it is not a regular file inside the folder, larger than the limit, or cannot be read.
    """
    file = cast("BufferedReader", _opened(path, root, os.O_RDONLY, "rb", -1))
    size = os.fstat(file.fileno()).st_size
    if limit is not None and size > limit:
        file.close()
        raise _too_large(path, f"the file has {_in_words(size)}", limit)
    return file


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits; raise what `open_to_read` does."""
    with storage_errors(path, "read"), open_to_read(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def open_text(path: Path, root: Path | None = None) -> TextIO:
    """Open a CSV file to read its text (UTF-8, wrong bytes replaced), lines ending as they stand.

    Raises:
        StorageError: as `open_to_read` says; or it is larger than what is read as text.
    """
    file = open_to_read(path, root, limit=TEXT_LIMIT)
    return io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace", newline="")


def read_bytes(path: Path, root: Path | None = None, *, limit: int = TEXT_LIMIT) -> bytes:
    """Return the bytes of a file; raise what `open_to_read` does."""
    with open_to_read(path, root, limit=limit) as file, storage_errors(path, "read"):
        size = os.fstat(file.fileno()).st_size
        content = file.read(size + 1)  # not `limit`, as that much memory would be allocated
        if len(content) > size:
            content += file.read(limit + 1 - len(content))
    if len(content) > limit:  # it has grown since
        raise _too_large(path, f"the file has more than {_in_words(limit)}", limit)
    return content


def read_text(path: Path, root: Path | None = None, *, limit: int = TEXT_LIMIT, errors: str = "strict") -> str:
    """Return the text of a file (UTF-8, with or without a byte order mark).

    Raises:
        StorageError: as `open_to_read`; or it is not UTF-8.
    """
    try:
        return read_bytes(path, root, limit=limit).decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise _damaged(path, f"the file is not text in UTF-8: {error.reason} at byte {error.start}") from error


def read_json(path: Path, root: Path | None = None, *, limit: int = JSON_LIMIT) -> Any:
    """Return the value of a JSON file.

    Raises:
        StorageError: as `open_to_read`; or it is not JSON, or nested too deeply.
    """
    content = read_bytes(path, root, limit=limit)
    try:
        value = parsed_json(content.decode("utf-8-sig"))
        if all(level < DEEPEST for level, _ in enumerate(levels_of(value))):
            return value
    except RecursionError:
        pass
    except ValueError as error:
        raise _damaged(path, f"the file is not valid JSON: {error}") from error
    raise _damaged(path, f"its JSON is nested deeper than {DEEPEST} levels")


def read_declared(path: Path, what: str, shape: Any, *, newest: int, fix: str, limit: int = JSON_LIMIT) -> Any:
    """Return the value in a JSON file of a declared shape, whose `format` is at most `newest`; `what` names the file.

    Raises:
        MissingFileError: there is none.
        StorageError: it cannot be read, its format is newer, or its shape is another one: each fault is named.
    """
    try:
        value = read_json(path, limit=limit)
    except DamagedFileError as error:
        raise StorageError(f"the {what} cannot be read: {error.problem}", where=error.where, fix=fix) from error
    found = value.get("format") if isinstance(value, dict) else None
    if isinstance(found, int) and found > newest:
        problem = f"the {what} has format {found}, newer than {newest}, which this version knows"
        raise StorageError(problem, where=str(path), fix="Update robot-runner.")
    StorageError.refuse(shape_findings(str(path), f"a {what}", value, shape, fix))
    return value


def read_blocks(path: Path, root: Path | None = None, *, longest: int = LINE_LIMIT) -> Iterator[bytes]:
    """Yield a file in blocks of whole lines; the last line of the file may lack its end.

    Raises:
        StorageError: as `open_to_read`; or a line has more than `longest` bytes.
    """
    rest = b""
    with open_to_read(path, root) as file, storage_errors(path, "read"):
        for piece in iter(partial(file.read, min(_BLOCK, longest)), b""):
            block = rest + piece
            end = block.rfind(b"\n") + 1
            rest = block[end:]
            if max(len(rest), block.find(b"\n") + 1) > longest:  # a later line lies within the piece
                raise _too_large(path, f"the file has a line of more than {_in_words(longest)}", longest)
            if end:
                yield block[:end]
    if rest:
        yield rest


def open_to_append(path: Path, root: Path | None = None) -> BinaryIO:
    """Open a file, or make it, to append bytes without a buffer.

    Raises:
        StorageError: it is not a regular file inside the folder, another user's by a hard link, or cannot be written.
    """
    return _opened(path, root, os.O_WRONLY | os.O_CREAT | os.O_APPEND, "ab", 0)


def open_to_fill(path: Path, root: Path | None = None) -> BinaryIO:
    """Open a file, emptied, to write it in place; `open_to_write` keeps the old content until the end.

    Raises:
        StorageError: it is not a regular file inside the folder, another user's by a hard link, or cannot be written.
    """
    file = _opened(path, root, os.O_WRONLY | os.O_CREAT, "wb", -1)
    file.truncate()  # only after it was checked
    return file


def open_descriptor(path: Path, root: Path | None = None, flags: int = os.O_RDWR | os.O_CREAT, *, mode: int = 0) -> int:
    """Return a descriptor of a file: to lock it, to hand it to a program, or to write into it at a place.

    `flags` are as `os.open` takes them: with O_CREAT, a missing file is made. `root` is the experiment's folder; `mode`
    has the permissions of a file that is made, 0 for those of that folder.

    Raises:
        MissingFileError: there is none, and none was to be made.
        StorageError: it is not a regular file inside the folder, another user's by a hard link, or cannot be opened.
    """
    action = "written" if flags & _WRITING else "read"
    with refusals(path, root, action) as (top, (*folders, name)), folder_inside(top, folders) as folder:
        return _open_regular(path, folder, name, flags, mode or (flags & os.O_CREAT and rights_of(top) & 0o666))


@contextmanager
def open_to_write(
    path: Path, root: Path | None = None, *, mode: int = 0, is_lasting: bool = True
) -> Iterator[BinaryIO]:
    """Write a file beside `path`, flush it to the disk, and rename it over `path` when the block ends.

    Where anything fails, the file at `path` is intact and nothing is left beside it. A link at `path` is refused:
    neither its target nor the link itself is replaced. `mode` has the file's permissions, of which the umask takes its
    part; 0 for those of the experiment's folder, `root`. It is flushed where it `is_lasting`, to survive a power
    failure; many files that can be made again need not be.

    Raises:
        StorageError: at `path` is something else than a regular file, or it cannot be written.
    """
    with refusals(path, root, "written") as (top, (*folders, name)):
        with (
            folder_inside(top, folders) as folder,
            _beside(path, folder, name, mode or rights_of(top) & 0o666, is_lasting) as file,
        ):
            yield file
        if is_lasting:
            fsync_folder(path.parent)


@contextmanager
def _beside(path: Path, folder: int, name: str, mode: int, is_lasting: bool) -> Iterator[BinaryIO]:
    _look_at(path, folder, name)
    # In the same folder: renaming across file systems is neither possible nor atomic.
    beside = f".{name}.{threading.get_native_id()}.tmp"  # unique among the threads of the machine
    _unlink(beside, folder)  # left by a thread of this number that was killed, or planted: O_EXCL follows no link
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FILE
    try:
        opener = partial(os.open, mode=mode, dir_fd=folder)
        with open(path.with_name(beside), "wb", opener=lambda *_: opener(beside, flags)) as file:
            yield file
            file.flush()
            if is_lasting:
                fsync_file(file.fileno())
        os.replace(beside, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        _unlink(beside, folder)
        raise


def replace(path: Path, content: str | bytes, root: Path | None = None, *, is_lasting: bool = True) -> None:
    """Give a file new content (text as UTF-8), whole or not at all; see `open_to_write`.

    Raises:
        StorageError: as `open_to_write` says.
    """
    with open_to_write(path, root, is_lasting=is_lasting) as file:
        file.write(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def remove(path: Path, root: Path | None = None) -> bool:
    """Remove a file, or a link in its place, and return whether it was there.

    Raises:
        StorageError: the path leads over a link or outside, or the system refuses.
    """
    with (
        suppress(MissingFileError),
        refusals(path, root, "removed") as (top, (*folders, name)),
        folder_inside(top, folders) as folder,
    ):
        return _unlink(name, folder)
    return False


def _opened(path: Path, root: Path | None, flags: int, kind: str, buffering: int) -> BinaryIO:
    # By an opener, so that the file has its name, which messages of libraries show.
    return cast("BinaryIO", open(path, kind, buffering, opener=lambda *_: open_descriptor(path, root, flags)))


def _open_regular(path: Path, folder: int, name: str, flags: int, mode: int) -> int:
    _look_at(path, folder, name)  # first, since opening a device or a pipe has effects
    descriptor = os.open(name, flags | _FILE, mode, dir_fd=folder)
    try:
        found = os.fstat(descriptor)
        _require_regular(path, found.st_mode)
        if flags & _WRITING:
            _require_own(path, found)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _look_at(path: Path, folder: int, name: str) -> None:
    with suppress(FileNotFoundError):
        _require_regular(path, os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)


def _require_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise StorageError(f"this is {kind_of(mode)}, not a regular file", where=str(path), fix=ONLY_FILES)


def _require_own(path: Path, found: os.stat_result) -> None:
    if found.st_nlink > 1 and found.st_uid != os.geteuid():
        problem = "the file is a hard link to another user's file, which would be changed"
        raise StorageError(problem, where=str(path), fix="Copy it, and put the copy in its place.")


def _unlink(name: str, folder: int) -> bool:
    with suppress(FileNotFoundError):
        os.unlink(name, dir_fd=folder)
        return True
    return False


def _too_large(path: Path, problem: str, limit: int) -> DamagedFileError:
    limits = f"at most {_in_words(limit)} are read"
    fix = "Restore the file from a backup, or remove it."
    return DamagedFileError(f"{problem}; {limits}", where=str(path), fix=fix)


def _damaged(path: Path, problem: str) -> DamagedFileError:
    return DamagedFileError(problem, where=str(path), fix="Restore it from a backup.")


def _in_words(size: float) -> str:
    power = min(max(len(str(int(size))) - 1, 0) // 3, len(_UNITS) - 1)
    return f"{size / 1000**power:.{1 if power else 0}f} {_UNITS[power]}"
