"""A package as its files, zipped or unpacked; looking at it writes nothing and executes nothing."""

from __future__ import annotations

import os
import stat
import struct
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from robot_runner.core.errors import Finding, PackageError
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.replication.contents import DESCRIPTION, fault_of_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = ["OpenPackage", "open_package"]

_BLOCK = 1 << 20
#: Deflate cannot do better than about 1000 to 1, and data that was measured never comes near this.
_MOST_TIMES_SMALLER = 200
_SMALL = 64 << 20
#: A local file header, without the name (APPNOTE.TXT, 4.3.7): flags, method, time and date are its third to sixth part.
_LOCAL = struct.Struct("<4s5H3I2H")
_HEADER = _LOCAL.size
_GET_IT_AGAIN = "Get it again from where it came from."


class OpenPackage(Protocol):
    """The files of a package."""

    @property
    def where(self) -> Path:
        """The file or folder that it is."""

    @property
    def sizes(self) -> Mapping[str, int]:
        """The size of each file in bytes, by its name."""

    @property
    def faults(self) -> tuple[Finding, ...]:
        """What must not be, each an error finding."""

    def blocks(self, name: str) -> Iterator[bytes]:
        """Yield a file block by block.

        Raises:
            PackageError: it is damaged.
            StorageError: it cannot be read.
        """


@contextmanager
def open_package(path: Path) -> Iterator[OpenPackage]:
    """Open a package: a zip file, or the folder that one was unpacked to.

    Raises:
        PackageError: it is no package, or is damaged.
        StorageError: it cannot be read.
    """
    if path.is_dir():
        yield _Unpacked.at(path)
        return
    if not path.exists():
        raise PackageError("there is no such file or folder", where=str(path), fix="Mend the path.")
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        problem = f"it is no zip file, or its end is missing: {error}"
        raise PackageError(problem, where=str(path), fix=_GET_IT_AGAIN) from error
    except (OSError, NotImplementedError) as error:
        raise storage_error(path, "read", _as_os_error(error)) from error
    with archive:
        yield _Zipped.of(path, archive)


def _as_os_error(error: Exception) -> OSError:
    return error if isinstance(error, OSError) else OSError(str(error))


@dataclass(frozen=True, slots=True)
class _Unpacked:
    where: Path
    sizes: Mapping[str, int]
    faults: tuple[Finding, ...]

    @classmethod
    def at(cls, root: Path) -> _Unpacked:
        sizes: dict[str, int] = {}
        faults: list[Finding] = []
        try:
            for path in sorted(_entries(root)):
                name = path.relative_to(root).as_posix()
                status = path.lstat()
                if stat.S_ISREG(status.st_mode):
                    sizes[name] = status.st_size
                elif not stat.S_ISDIR(status.st_mode):
                    what = "it is a symbolic link" if stat.S_ISLNK(status.st_mode) else "it is no regular file"
                    faults.append(_fault(root, name, what))
        except OSError as error:
            raise storage_error(root, "read", error) from error
        return cls(root, sizes, tuple(faults))

    def blocks(self, name: str) -> Iterator[bytes]:
        try:
            with (self.where / name).open("rb") as file:
                while block := file.read(_BLOCK):
                    yield block
        except OSError as error:
            raise storage_error(self.where / name, "read", error) from error


def _entries(root: Path) -> Iterator[Path]:
    for folder, folders, names in os.walk(root):
        yield from (Path(folder) / name for name in (*folders, *names))


@dataclass(frozen=True, slots=True)
class _Zipped:
    where: Path
    sizes: Mapping[str, int]
    faults: tuple[Finding, ...]
    archive: zipfile.ZipFile

    @classmethod
    def of(cls, path: Path, archive: zipfile.ZipFile) -> _Zipped:
        entries = archive.infolist()
        if min((entry.header_offset for entry in entries), default=0) > 0:
            # Where the end is cut off, the directory that is found last may be that of a wheel in the package.
            problem = "its end is missing, or something stands before its beginning"
            raise PackageError(problem, where=str(path), fix=_GET_IT_AGAIN)
        sizes = {entry.filename: entry.file_size for entry in entries if not entry.is_dir()}
        if DESCRIPTION not in sizes:
            problem = f"it has no {DESCRIPTION}: it was not made by `robot-runner pack`"
            raise PackageError(problem, where=str(path), fix="Name a package.")
        faults = [*_entry_faults(path, entries), *_layout_faults(path, entries), *_header_faults(path, entries)]
        return cls(path, sizes, tuple(faults), archive)

    def blocks(self, name: str) -> Iterator[bytes]:
        left = self.sizes[name]
        try:
            with self.archive.open(name) as file:
                while block := file.read(_BLOCK):
                    left -= len(block)
                    if left < 0:
                        raise _damaged(self.where, name, "it is larger than it says")
                    yield block
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
            raise _damaged(self.where, name, str(error)) from error
        except OSError as error:
            raise storage_error(self.where, "read", error) from error


def _entry_faults(path: Path, entries: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    for entry in entries:
        name = entry.filename.removesuffix("/") if entry.is_dir() else entry.filename
        kind = entry.external_attr >> 16
        fault = fault_of_name(name) or fault_of_name(entry.orig_filename.removesuffix("/"))
        if fault:
            yield _fault(path, entry.orig_filename, fault)
        if stat.S_ISLNK(kind):
            yield _fault(path, name, "it is a symbolic link")
        elif stat.S_IFMT(kind) not in {0, stat.S_IFREG, stat.S_IFDIR}:
            yield _fault(path, name, "it is no regular file")
        if entry.flag_bits & 1:
            yield _fault(path, name, "it is encrypted")
        if entry.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            yield _fault(path, name, f"it is compressed in a way (number {entry.compress_type}) that no package is")
        if entry.file_size > _SMALL and entry.file_size > _MOST_TIMES_SMALLER * max(1, entry.compress_size):
            problem = f"it would unpack to {entry.file_size:,} bytes out of {entry.compress_size:,}: a zip bomb"
            yield _fault(path, name, problem)


def _header_faults(path: Path, entries: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Yield files whose own header says something else than the directory at the end, which is what is read."""
    with path.open("rb") as file:
        for entry in entries:
            file.seek(entry.header_offset)
            header = file.read(_HEADER)
            if len(header) < _HEADER:
                yield _fault(path, entry.filename, "its header is cut off")
                continue
            magic, _, flags, method, time, date, *_ = _LOCAL.unpack(header)
            day = ((date >> 9) + 1980, date >> 5 & 0xF, date & 0x1F)
            stamp = (*day, time >> 11, time >> 5 & 0x3F, (time & 0x1F) * 2)
            wanted = (b"PK\x03\x04", entry.flag_bits, entry.compress_type, entry.date_time)
            if (magic, flags, method, stamp) != wanted:
                yield _fault(path, entry.filename, "its header is damaged: the directory of the zip file differs")


def _layout_faults(path: Path, entries: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Yield names that stand twice or in each other's way, and files that share bytes."""
    seen: set[str] = set()
    folders: set[str] = set()
    for entry in entries:
        name = entry.filename.removesuffix("/")
        if name in seen:
            yield _fault(path, name, "there are two files of this name")
        seen.add(name)
        parts = name.split("/")
        folders.update("/".join(parts[:place]) for place in range(1, len(parts)))
    files = {entry.filename for entry in entries if not entry.is_dir()}
    for name in sorted(files & folders):
        yield _fault(path, name, "it is a file and a folder at once")
    end = 0
    for entry in sorted(entries, key=lambda each: each.header_offset):
        if entry.header_offset < end:
            yield _fault(path, entry.filename, "it shares bytes with another file: a zip bomb")
        end = max(end, entry.header_offset + _HEADER + len(entry.orig_filename) + entry.compress_size)
    packed = path.stat().st_size
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > _SMALL and unpacked > _MOST_TIMES_SMALLER * packed:
        yield _fault(path, path.name, f"it would unpack to {unpacked:,} bytes out of {packed:,}: a zip bomb")


def _fault(path: Path, name: str, problem: str) -> Finding:
    return Finding.error(f"{path}, {name}", problem, "Do not unpack it; ask whoever made it for the original.")


def _damaged(path: Path, name: str, problem: str) -> PackageError:
    return PackageError(f"it is damaged: {problem}", where=f"{path}, {name}", fix=_GET_IT_AGAIN)
