"""Open a package, zipped or unpacked; reading it writes nothing and executes nothing."""

from __future__ import annotations

import io
import os
import shutil
import signal
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath

from robot_runner.core.errors import Finding, PackageError, StorageError
from robot_runner.core.execution.interruption import stop_signals_handled
from robot_runner.core.storage.guarded_files import open_to_read, read_bytes
from robot_runner.core.storage.system_refusals import storage_error, storage_errors
from robot_runner.replication.contents import DESCRIPTION, DESKTOP_FILES, SUMS, fault_of_name
from robot_runner.replication.plain_zip import LARGEST_DIRECTORY, Progress
from robot_runner.replication.redaction import chunks_of

#: The compression ratio of a zip bomb: Deflate reaches up to about 1000, and measured data stays far below this.
_MOST_TIMES_SMALLER = 200
_SMALL = 64 << 20
#: Bytes that must stay free on the disk to which a package is unpacked.
_SPARE = 64 << 20
#: A local file header without the name (APPNOTE.TXT, 4.3.7): its third to sixth field are flags, method, time and date.
_LOCAL = struct.Struct("<4s5H3I2H")
_LINK, _NOT_REGULAR = "the file is a symbolic link", "the file is not a regular one"
_GET_IT_AGAIN = "Get it again from where it came from."


@dataclass(frozen=True, slots=True)
class OpenPackage:
    """The files of a package.

    Attributes:
        where: the zip file or folder.
        sizes: the size of each file in bytes, by its name.
        faults: an error finding for each forbidden entry, such as a symbolic link.
        blocks: yields a file block by block; raises PackageError if it is damaged, StorageError if it cannot be read.
    """

    where: Path
    sizes: Mapping[str, int]
    faults: tuple[Finding, ...]
    blocks: Callable[[str], Iterator[bytes]]


@contextmanager
def open_package(path: Path) -> Iterator[OpenPackage]:
    """Open a package: a zip file, or the folder to which it was unpacked.

    Raises:
        PackageError: the file is not a package, or is damaged.
        StorageError: the file cannot be read.
    """
    if path.is_dir():
        yield _unpacked(path)
        return
    if not path.exists():
        raise PackageError("there is no such file or folder", where=str(path), fix="Correct the path.")
    if not path.is_file():  # opening a named pipe blocks, and a device has no end
        raise PackageError("this is neither a regular file nor a folder", where=str(path), fix="Name a package.")
    with ExitStack() as opened:
        yield _zipped(path, _archive(path, opened))


def is_package(path: Path) -> bool:
    """Return whether a file is a package in one file; its content is not verified."""
    try:
        with ExitStack() as opened:
            return path.is_file() and DESCRIPTION in _archive(path, opened).namelist()
    except (PackageError, StorageError):
        return False


def _archive(path: Path, opened: ExitStack) -> zipfile.ZipFile:
    try:
        return opened.enter_context(zipfile.ZipFile(opened.enter_context(_BoundedReads(path))))
    # The library raises the others for invalid names, offsets or numbers in the directory.
    except (zipfile.BadZipFile, ValueError, OverflowError, EOFError, struct.error) as error:
        problem = f"the file is not a zip file, or its end is missing: {error}"
        raise PackageError(problem, where=str(path), fix=_GET_IT_AGAIN) from error
    except (OSError, NotImplementedError) as error:
        raise storage_error(path, "read", error if isinstance(error, OSError) else OSError(str(error))) from error


class _BoundedReads(io.FileIO):
    """A file with a limit on the size of one read.

    The directory of a zip file is read as a whole, and takes up to twenty times its size in memory.
    """

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most so many bytes.

        Raises:
            zipfile.BadZipFile: the size exceeds the limit.
        """
        wanted = os.fstat(self.fileno()).st_size - self.tell() if size is None or size < 0 else size
        if wanted > LARGEST_DIRECTORY:
            raise zipfile.BadZipFile(f"its directory has more than {LARGEST_DIRECTORY:,} bytes")
        return super().read(size)

    def seek(self, place: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a place in the file.

        Raises:
            zipfile.BadZipFile: a number in the zip file names a place before the beginning of the file.
        """
        if whence == os.SEEK_SET and place < 0:
            raise zipfile.BadZipFile("it names a place outside of itself")
        return super().seek(place, whence)


def unpack(package: OpenPackage, target: Path, progress: Progress = lambda _, __: None) -> None:
    """Write the files of a package to the new folder `target`; nothing is done if it was unpacked there before.

    Args:
        package: the opened package, which was found to be intact.
        target: the folder. Until all files are written, it has another name.
        progress: called with the number of bytes written and the total.

    Raises:
        KeyboardInterrupt: a stop signal came; nothing is left beside `target`.
        PackageError: another package is there, or the disk is full.
        StorageError: the folder cannot be written.
    """
    if target.exists():
        _refuse_other(package, target)
        return
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    with storage_errors(target, "written"), stop_signals_handled(signal.default_int_handler):
        target.parent.mkdir(parents=True, exist_ok=True)
        _refuse_without_room(package, target.parent)
        beside.mkdir()
        try:
            _write(package, beside, progress)
            beside.rename(target)
        finally:
            shutil.rmtree(beside, ignore_errors=True)


def _write(package: OpenPackage, folder: Path, progress: Progress) -> None:
    total, done = sum(package.sizes.values()), 0
    for name in package.sizes:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            for block in package.blocks(name):
                file.write(block)
                done += len(block)
                progress(done, total)


def _refuse_other(package: OpenPackage, target: Path) -> None:
    """Refuse a folder with another package: one with other checksums of its files."""
    sums = target / SUMS
    if not (sums.is_file() and read_bytes(sums) == b"".join(package.blocks(SUMS))):
        fix = "Name another folder with --to."
        raise PackageError("another package is unpacked here", where=str(target), fix=fix)


def _refuse_without_room(package: OpenPackage, folder: Path) -> None:
    needed, free = sum(package.sizes.values()), shutil.disk_usage(folder).free
    if needed + _SPARE > free:
        problem = f"{needed:,} bytes are needed for the package, {_SPARE:,} for what comes after, and {free:,} are free"
        raise PackageError(problem, where=str(folder), fix="Make room, or name a folder on another disk with --to.")


def _unpacked(root: Path) -> OpenPackage:
    sizes: dict[str, int] = {}
    faults: list[Finding] = []
    with storage_errors(root, "read"):
        for path in sorted(Path(top, name) for top, folders, files in os.walk(root) for name in (*folders, *files)):
            try:
                name, status = path.relative_to(root).as_posix(), path.lstat()
            except FileNotFoundError:  # renamed or removed since it was listed
                continue
            if stat.S_ISREG(status.st_mode) and path.name in DESKTOP_FILES:
                continue
            if stat.S_ISREG(status.st_mode):
                sizes[name] = status.st_size
            elif not stat.S_ISDIR(status.st_mode):
                faults.append(_fault(root, name, _LINK if stat.S_ISLNK(status.st_mode) else _NOT_REGULAR))
    return OpenPackage(root, sizes, tuple(faults), partial(_blocks_of_file, root))


def _blocks_of_file(root: Path, name: str) -> Iterator[bytes]:
    with storage_errors(root / name, "read"), open_to_read(root / name, root) as file:
        yield from chunks_of(file)


def _zipped(path: Path, archive: zipfile.ZipFile) -> OpenPackage:
    entries = archive.infolist()
    if min((entry.header_offset for entry in entries), default=0) > 0:
        # If the end is cut off, the last directory in the file may be that of a wheel in the package.
        problem = "the zip file's end is missing, or something stands before its beginning"
        raise PackageError(problem, where=str(path), fix=_GET_IT_AGAIN)
    listed = {entry.filename: entry.file_size for entry in entries if _is_content(entry)}
    around = _folder_around(listed)
    sizes = {name.removeprefix(around): size for name, size in listed.items()}
    faults = [*_entry_faults(path, entries), *_layout_faults(path, entries), *_header_faults(path, entries)]
    return OpenPackage(path, sizes, tuple(faults), lambda name: _blocks_of_entry(path, archive, f"{around}{name}"))


def _is_content(entry: zipfile.ZipInfo) -> bool:
    """Return whether an entry is a file of somebody's, not what Finder adds to zip files and desktops to folders."""
    return not (
        entry.is_dir() or entry.filename.startswith("__MACOSX/") or PurePosixPath(entry.filename).name in DESKTOP_FILES
    )


def _folder_around(names: Collection[str]) -> str:
    """Return the folder that all files are in, if it has a package: as where an unpacked one was zipped again."""
    around = f"{next(iter(names), '').partition('/')[0]}/"
    return around if f"{around}{DESCRIPTION}" in names and all(name.startswith(around) for name in names) else ""


def _blocks_of_entry(path: Path, archive: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    left = archive.getinfo(name).file_size
    try:
        with archive.open(name) as file:
            for block in chunks_of(file):
                left -= len(block)
                if left < 0:
                    raise _damaged(path, name, "the file is larger than it says")
                yield block
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise _damaged(path, name, str(error)) from error
    except OSError as error:
        raise storage_error(path, "read", error) from error


def _entry_faults(path: Path, entries: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    for entry in entries:
        name = entry.filename.removesuffix("/") if entry.is_dir() else entry.filename
        kind = entry.external_attr >> 16
        fault = fault_of_name(name) or fault_of_name(entry.orig_filename.removesuffix("/"))
        if fault:
            yield _fault(path, entry.orig_filename, fault)
        if stat.S_ISLNK(kind):
            yield _fault(path, name, _LINK)
        elif stat.S_IFMT(kind) not in {0, stat.S_IFREG, stat.S_IFDIR}:
            yield _fault(path, name, _NOT_REGULAR)
        if entry.flag_bits & 1:
            yield _fault(path, name, "the file is encrypted")
        if entry.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            yield _fault(path, name, f"the file is compressed by method {entry.compress_type}, which no package is")
        if entry.file_size > _SMALL and entry.file_size > _MOST_TIMES_SMALLER * max(1, entry.compress_size):
            problem = f"the file would unpack to {entry.file_size:,} bytes out of {entry.compress_size:,}: a zip bomb"
            yield _fault(path, name, problem)


def _header_faults(path: Path, entries: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Yield an error for each file whose header differs from its entry in the directory, which is what is read."""
    with path.open("rb") as file:
        for entry in entries:
            file.seek(max(0, entry.header_offset))
            header = file.read(_LOCAL.size) if entry.header_offset >= 0 else b""
            if len(header) < _LOCAL.size:
                yield _fault(path, entry.filename, "the file's header is cut off")
                continue
            magic, _, flags, method, time, date, *_ = _LOCAL.unpack(header)
            day = ((date >> 9) + 1980, date >> 5 & 0xF, date & 0x1F)
            stamp = (*day, time >> 11, time >> 5 & 0x3F, (time & 0x1F) * 2)
            wanted = (b"PK\x03\x04", entry.flag_bits, entry.compress_type, entry.date_time)
            if (magic, flags, method, stamp) != wanted:
                problem = "the file's header is damaged: the directory of the zip file differs"
                yield _fault(path, entry.filename, problem)


def _layout_faults(path: Path, entries: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Yield an error for each duplicate name, each file whose name is also a folder's, and files that share bytes."""
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
        yield _fault(path, name, "the name is that of a file and a folder at once")
    end = 0
    for entry in sorted(entries, key=lambda each: each.header_offset):
        if entry.header_offset < end:
            yield _fault(path, entry.filename, "the file shares bytes with another one: a zip bomb")
        end = max(end, entry.header_offset + _LOCAL.size + len(entry.orig_filename) + entry.compress_size)
    packed = path.stat().st_size
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > _SMALL and unpacked > _MOST_TIMES_SMALLER * packed:
        yield _fault(path, path.name, f"the package would unpack to {unpacked:,} bytes out of {packed:,}: a zip bomb")


def _fault(path: Path, name: str, problem: str) -> Finding:
    return Finding.error(f"{path}, {name}", problem, "Do not unpack it; ask its author for the original.")


def _damaged(path: Path, name: str, problem: str) -> PackageError:
    return PackageError(f"the file is damaged: {problem}", where=f"{path}, {name}", fix=_GET_IT_AGAIN)
