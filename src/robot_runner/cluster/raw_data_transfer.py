"""Copies raw data piece by piece from a worker into the run's folder.

What a worker says about its files is not trusted: each name has to lead into the run's folder, no link is followed or
made, and no more is written than was announced and fits on the disk. A piece with a wrong checksum is requested again;
a file with a wrong checksum is an error. Memory is bounded by the size of a piece.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import make_folder, open_descriptor

#: Bytes of a piece: some hundred of them are on their way at most (see `gateway.py`), and each costs a round trip.
PIECE = 1 << 20
#: How often a piece is requested before its wrong checksum is an error.
_ATTEMPTS = 3
#: The longest list of files of one run, bytes: some 400,000 files.
_LONGEST_LIST = 64_000_000
_DEEPEST = 64

#: Gets a piece and its SHA-256 from the worker, given the name of a file (that of the list of files is empty), where
#: the piece begins, and its size.
Read = Callable[[str, int, int], Awaitable[tuple[bytes, str]]]


class TransferError(Exception):
    """The worker's files could not be copied correctly."""


def open_up(path: Path) -> None:
    """Let this process read and remove what a run has left that its user may: it may have taken away these rights."""
    with suppress(OSError):  # it is somebody else's, or not there
        mode = path.lstat().st_mode
        if stat.S_ISREG(mode) and not mode & stat.S_IRUSR:
            path.chmod(mode | stat.S_IRUSR)
        elif stat.S_ISDIR(mode):
            if mode & stat.S_IRWXU != stat.S_IRWXU:
                path.chmod(mode | stat.S_IRWXU)
            for each in path.iterdir():
                open_up(each)


def listed_files(folder: Path) -> tuple[list[tuple[str, int, str]], list[str], list[str]]:
    """Return name, size and SHA-256 of each regular file of a folder, and the names of what else is there.

    These are the names of links, pipes and devices, and those of files and folders that may not be read.

    Raises:
        OSError: something cannot be read for another reason.
    """
    files: list[tuple[str, int, str]] = []
    others: list[str] = []
    unread: list[str] = []
    for path in _paths(folder):
        name = path.relative_to(folder).as_posix()
        try:
            mode = path.lstat().st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                others.append(name)
                continue
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
                files.append((name, file.tell(), digest))
        except PermissionError:
            unread.append(name)
    return files, others, unread


def _paths(folder: Path) -> Iterator[Path]:
    """Yield what is in a folder and in those below; a folder itself only where it may not be read."""
    try:
        inside = sorted(os.scandir(folder), key=lambda each: each.name)
    except PermissionError:
        yield folder
        return
    for each in inside:
        if each.is_dir(follow_symlinks=False):
            yield from _paths(folder / each.name)
        else:
            yield folder / each.name


async def bring_home(read: Read, ended: Mapping[str, Any], run: Path, root: Path) -> None:
    """Write all that an attempt has left on its worker into the run's folder.

    `ended` is the worker's message about the end: `files`, `bytes`, and the length of the `list`.

    Raises:
        TransferError: the worker sends something else than it announced, or a name that leads elsewhere.
        StorageError: it cannot be written here.
        OSError: the worker is out of reach.
    """
    free = shutil.disk_usage(root).free
    if ended["bytes"] > free:
        sizes = f"{ended['bytes'] / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free here"
        raise StorageError(f"the run has left {sizes}", where=str(run), fix="Make room, and execute the run again.")
    listed = await _listed(read, ended)
    if len(listed) != ended["files"] or sum(size for _, size, _ in listed) != ended["bytes"]:
        raise TransferError("the list of files is not the one that was announced")
    for name, size, digest in listed:
        path = run.joinpath(*_parts(name))
        make_folder(path.parent, root)
        descriptor = open_descriptor(path, root, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        try:
            await _copy(read, name, size, digest, partial(_write, descriptor, path))
        finally:
            os.close(descriptor)


async def _listed(read: Read, ended: Mapping[str, Any]) -> list[tuple[str, int, str]]:
    if not 0 <= ended["list"] <= _LONGEST_LIST:
        raise TransferError("the list of files is too long")
    text = b""
    while len(text) < ended["list"]:
        text += await _piece(read, "", len(text), ended["list"] - len(text))
    try:
        listed = [json.loads(line) for line in text.splitlines()]
        return [(str(name), _size(size), str(digest)) for name, size, digest in listed]
    except (ValueError, TypeError) as error:
        raise TransferError(f"the list of files cannot be read: {error}") from error


def _size(size: Any) -> int:
    if type(size) is not int or size < 0:
        raise TransferError(f"a file has the size {size!r}")
    return size


def _parts(name: str) -> tuple[str, ...]:
    """Return the parts of a file's name, none of which leads elsewhere."""
    parts = PurePosixPath(name).parts
    is_odd = not parts or len(parts) > _DEEPEST or name != "/".join(parts) or name.startswith("/")
    if is_odd or ".." in parts or "\0" in name:
        raise TransferError(f"a file has the name {name[:200]!r}, which does not lead into the run's folder")
    return parts


async def _copy(read: Read, name: str, size: int, digest: str, write: Callable[[bytes], None]) -> None:
    whole, offset = hashlib.sha256(), 0
    while offset < size:
        piece = await _piece(read, name, offset, size - offset)
        whole.update(piece)
        offset += len(piece)
        write(piece)
    if whole.hexdigest() != digest:
        raise TransferError(f"the file {name[:200]!r} has another SHA-256 than the worker reported")


def _write(descriptor: int, path: Path, piece: bytes) -> None:
    view = memoryview(piece)
    try:
        while view:
            view = view[os.write(descriptor, view) :]
    except OSError as error:
        raise StorageError(str(error), where=str(path), fix="Make room, and execute the run again.") from error


async def _piece(read: Read, name: str, offset: int, left: int) -> bytes:
    wanted = min(PIECE, left)
    for _ in range(_ATTEMPTS):
        piece, digest = await read(name, offset, wanted)
        if len(piece) == wanted and hashlib.sha256(piece).hexdigest() == digest:
            return piece
    raise TransferError(f"a piece of {name[:200]!r} came {_ATTEMPTS} times with another checksum or length")
