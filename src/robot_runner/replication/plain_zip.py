"""A zip file whose bytes depend on its contents alone, written as its contents come."""

from __future__ import annotations

import hashlib
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias

from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.system_refusals import fsync_file, fsync_folder, storage_error, storage_errors

#: Called with the number of bytes that are done, and with that of all.
Progress: TypeAlias = "Callable[[int, int], None]"

#: The time of every file in a package: the earliest that a zip file can say.
_STAMP = (1980, 1, 1, 0, 0, 0)
_LEVEL = 6
_LARGE = 1 << 30
_BLOCK = 1 << 16
#: What a zip file says of each file takes a hundredth of one of this size: many smaller ones are no bomb together.
_SMALL = 1 << 14
#: Half of what is taken for a zip bomb: a file whose secrets are replaced may shrink more.
_MOST_TIMES_SMALLER = 100
#: Compressed already.
_COMPRESSED = (".bz2", ".gz", ".npz", ".parquet", ".pdf", ".png", ".whl", ".woff2", ".xz", ".zip", ".zst")


class StoredFile(NamedTuple):
    """What was written under one name: its size in bytes, uncompressed, and its SHA-256 in hexadecimal digits."""

    name: str
    size: int
    sha256: str


class PlainZip:
    """A zip file being written.

    Attributes:
        stored: what was written so far, by name.
    """

    def __init__(self, target: Path | BinaryIO) -> None:
        self._archive = zipfile.ZipFile(target, "x", allowZip64=True)
        self.stored: dict[str, StoredFile] = {}

    def add(self, name: str, blocks: Iterable[bytes], *, size: int = 0, is_stored: bool = False) -> StoredFile:
        """Write a file block by block.

        Args:
            name: in the zip file.
            blocks: its contents.
            size: about how large it will be: above 1 GiB it is written in the form for large files.
            is_stored: whether it is written as it is, and not deflated.

        Raises:
            OSError: it cannot be read or written.
        """
        entry = _entry(name, 0o100644)
        is_stored = is_stored or name.casefold().endswith(_COMPRESSED)
        entry.compress_type = zipfile.ZIP_STORED if is_stored else zipfile.ZIP_DEFLATED
        entry._compresslevel = _LEVEL  # type: ignore[attr-defined] # noqa: SLF001 - public from Python 3.13 only
        digest, written = hashlib.sha256(), 0
        with self._archive.open(entry, "w", force_zip64=size > _LARGE) as file:
            for block in blocks:
                digest.update(block)
                written += len(block)
                file.write(block)
        self.stored[name] = StoredFile(name, written, digest.hexdigest())
        return self.stored[name]

    def add_folders(self, names: Iterable[str]) -> None:
        """Write an entry for each of these folders, whose names end with `/`: what describes a package names them.

        Raises:
            OSError: it cannot be written.
        """
        for name in sorted(names):
            entry = _entry(name, 0o40755)
            entry.external_attr |= 0x10  # how MS-DOS marks a folder
            self._archive.writestr(entry, b"")

    def close(self) -> None:
        """Write the directory of the zip file, and close it."""
        self._archive.close()


def looks_like_a_bomb(path: Path, size: int) -> bool:
    """Whether a file would shrink so much that who receives it takes it for a zip bomb: one line again and again.

    Raises:
        StorageError: it cannot be read.
    """
    if size <= _SMALL:
        return False
    deflated, packed = zlib.compressobj(_LEVEL), 0
    with storage_errors(path, "read"), open_to_read(path) as file:
        while packed * _MOST_TIMES_SMALLER < size and (block := file.read(_BLOCK)):
            packed += len(deflated.compress(block))
    return packed * _MOST_TIMES_SMALLER < size


def _entry(name: str, mode: int) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _STAMP)
    entry.create_system = 3  # Unix, wherever the package is made
    entry.external_attr = mode << 16
    return entry


@contextmanager
def written_beside(target: Path) -> Iterator[PlainZip]:
    """Yield a zip file beside `target`, which replaces it once everything is in it and on the disk.

    Raises:
        StorageError: it cannot be written; what stood at `target` is intact.
    """
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        beside.unlink(missing_ok=True)
        archive = PlainZip(beside)
        try:
            yield archive
        finally:
            archive.close()
        with beside.open("rb") as file:
            fsync_file(file.fileno())
        beside.replace(target)
        fsync_folder(target.parent)
    except OSError as error:
        raise storage_error(target, "written", error) from error
    finally:
        beside.unlink(missing_ok=True)
