"""Write a zip file as a stream; its bytes depend on its contents alone."""

from __future__ import annotations

import hashlib
import os
import signal
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias

from robot_runner.core.execution.interruption import stop_signals_handled
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.system_refusals import fsync_file, fsync_folder, storage_error, storage_errors

#: Called with the number of processed bytes and the total.
Progress: TypeAlias = "Callable[[int, int], None]"

#: The size limit of the directory of a zip file that is read, bytes: about 100,000 files.
LARGEST_DIRECTORY = 12 << 20
#: The entry of a file in the directory, without its name, and its extra field in a large zip file (APPNOTE.TXT, 4.3.12
#: and 4.5.3).
_ENTRY, _EXTRA = 46, 28

#: The time of every file in a package: the earliest that a zip file can hold.
_STAMP = (1980, 1, 1, 0, 0, 0)
_LEVEL = 6
_LARGE = 1 << 30
_BLOCK = 1 << 16
#: The metadata of a file takes a hundredth of this size, so that many smaller files together are not a zip bomb.
_SMALL = 1 << 14
#: Half the compression ratio of a zip bomb: a file whose secrets are replaced may shrink more.
_MOST_TIMES_SMALLER = 100
#: Suffixes of files that are already compressed.
_COMPRESSED = (".bz2", ".gz", ".npz", ".parquet", ".pdf", ".png", ".whl", ".woff2", ".xz", ".zip", ".zst")


class StoredFile(NamedTuple):
    """A written file: its uncompressed size in bytes, and its SHA-256 in hexadecimal digits."""

    name: str
    size: int
    sha256: str


class PlainZip:
    """A zip file being written.

    Attributes:
        stored: the files written so far, by name.
    """

    def __init__(self, target: Path | BinaryIO) -> None:
        self._archive = zipfile.ZipFile(target, "x", allowZip64=True)
        self.stored: dict[str, StoredFile] = {}

    def add(
        self, name: str, blocks: Iterable[bytes], *, size: int = 0, is_stored: bool = False, is_program: bool = False
    ) -> StoredFile:
        """Write a file block by block.

        Args:
            name: in the zip file.
            blocks: its contents.
            size: its approximate size, bytes: above 1 GiB it is written in the ZIP64 format.
            is_stored: whether to write it uncompressed.
            is_program: whether it is executable where it is unpacked.

        Raises:
            OSError: a file cannot be read or written.
        """
        entry = _entry(name, 0o100755 if is_program else 0o100644)
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
        """Write an entry for each of these folders, since the crate describes them; their names end with `/`.

        Raises:
            OSError: the zip file cannot be written.
        """
        for name in sorted(names):
            entry = _entry(name, 0o40755)
            entry.external_attr |= 0x10  # how MS-DOS marks a folder
            self._archive.writestr(entry, b"")

    def close(self) -> None:
        """Write the directory of the zip file, and close it."""
        self._archive.close()


def directory_size(names: Iterable[str], size: int) -> int:
    """Return at most how many bytes the directory of a zip file takes.

    Args:
        names: those of its files and folders.
        size: of its files, bytes.
    """
    around = _ENTRY + (_EXTRA if size > zipfile.ZIP64_LIMIT else 0)
    return sum(around + len(name.encode()) for name in names)


def looks_like_a_bomb(path: Path, size: int) -> bool:
    """Whether a file, such as one with equal lines, would be compressed so much that it looks like a zip bomb.

    Raises:
        StorageError: the file cannot be read.
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
    """Yield a zip file beside `target`; it replaces `target` when it is complete and on the disk.

    Raises:
        KeyboardInterrupt: a stop signal came; nothing is left beside `target`.
        StorageError: the file cannot be written; an earlier file at `target` is intact.
    """
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    with stop_signals_handled(signal.default_int_handler):  # SIGTERM, as of a batch system, would leave it there
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
