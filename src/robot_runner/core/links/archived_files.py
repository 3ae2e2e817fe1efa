"""Packing and unpacking files for hosts as tar archives: nothing outside the folder is written, no link followed."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING

from robot_runner.core.words import one_line

if TYPE_CHECKING:
    import tarfile

#: The size of headers and padding that an archive may have beyond its files, bytes.
TAR_MARGIN = 10_000_000
_MODE = 0o644
_FULL = {errno.ENOSPC, errno.EDQUOT}


@dataclass(slots=True)
class Unpacked:
    """The result of unpacking an archive.

    Attributes:
        files: their paths.
        size: of all of them, bytes.
        problems: members that were not unpacked, and why, as parts of sentences.
        is_too_much: whether there was more than allowed.
    """

    files: list[Path] = field(default_factory=list)
    size: int = 0
    problems: list[str] = field(default_factory=list)
    is_too_much: bool = False


def pack(source: Path, name: str, archive: IO[bytes]) -> None:
    """Write a file or a folder into an archive under a name, without an owner, and rewind."""
    import tarfile  # noqa: PLC0415 - of hosts alone, and in the memory of each process that a run forks

    def own(member: tarfile.TarInfo) -> tarfile.TarInfo:
        member.uid = member.gid = 0
        member.uname = member.gname = ""
        return member

    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.add(source.resolve(), arcname=name, filter=own)
    archive.flush()
    archive.seek(0)


def unpack(archive: IO[bytes], folder: Path, most: int) -> Unpacked:
    """Unpack the regular files of an archive into a folder; a file that is cut off is left out.

    The archive may be cut off; the folder must exist. `most` bytes are allowed.
    """
    import tarfile  # noqa: PLC0415 - as above

    unpacked = Unpacked()
    seen: dict[str, tarfile.TarInfo] = {}
    try:
        # An archive may end anywhere, if its program was ended.
        with suppress(tarfile.TarError, EOFError), tarfile.open(fileobj=archive, mode="r:") as tar:
            for member in tar:
                # What has a second name stands in the archive under its first one.
                held = seen[member.name] = seen.get(member.linkname, member) if member.islnk() else member
                if unpacked.size + held.size > most:
                    unpacked.is_too_much = True
                    break
                if not member.isdir() and not _unpack_member(tar, member.name, held, folder, unpacked):
                    break
    except (ValueError, OverflowError, MemoryError):  # an invalid sparse map, or an endless header
        unpacked.problems.append("the archive that came cannot be read to its end")
    return unpacked


def _unpack_member(tar: tarfile.TarFile, name: str, held: tarfile.TarInfo, folder: Path, unpacked: Unpacked) -> bool:
    """Put a file into the folder, or add a problem; return False if unpacking must end."""
    parts = [part for part in PurePosixPath(name).parts if part not in {"/", "."}]
    shown = one_line("/" + "/".join(parts))
    if ".." in parts or not parts or any("\0" in part for part in parts):
        unpacked.problems.append(f"{shown} is not a path that a file here can have")
    elif held.issym():
        unpacked.problems.append(f"{shown} is a link to {one_line(held.linkname)}, which is not followed")
    elif not held.isfile() or (source := tar.extractfile(held)) is None:
        unpacked.problems.append(f"{shown} is not a file")
    else:
        target = folder.joinpath(*parts)
        try:
            _write(source, target, folder)
            with suppress(OverflowError, ValueError):  # an archive may say anything
                os.utime(target, (held.mtime, held.mtime))  # when it was written there
        except OSError as error:
            unpacked.problems.append(f"{shown} cannot be written here: {error.strerror}")
            return error.errno not in _FULL
        unpacked.files.append(target)
        unpacked.size += held.size
    return True


def _write(source: IO[bytes], target: Path, folder: Path) -> None:
    """Write beside and rename, so that a file is whole or missing; a link in the path is replaced."""
    for above in _between(folder, target.parent):
        if above.is_symlink():
            above.unlink()
        above.mkdir(exist_ok=True)
    beside = target.with_name(f".{os.getpid()}.part")  # short, as the file's own name may have the maximal length
    beside.unlink(missing_ok=True)
    try:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, _MODE)
        with os.fdopen(descriptor, "wb") as file:
            shutil.copyfileobj(source, file)
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)


def _between(folder: Path, inner: Path) -> Iterator[Path]:
    """Yield the folders from one to another within it, the outer first."""
    above = folder
    for part in inner.relative_to(folder).parts:
        above = above / part
        yield above
