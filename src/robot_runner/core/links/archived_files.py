"""Files on their way to and from hosts, as tar archives: nothing outside its folder is written, no link is followed."""

from __future__ import annotations

import os
import shutil
import tarfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING

from robot_runner.core.words import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator


#: What an archive may have beyond the bytes of its files: headers, and the blocks that it is filled up with.
TAR_MARGIN = 10_000_000
_MODE = 0o644


@dataclass(slots=True)
class Unpacked:
    """What came out of an archive.

    Attributes:
        files: where they are.
        size: of all of them, bytes.
        problems: what did not come, and why, as parts of sentences.
        is_too_much: whether there was more than there may be.
    """

    files: list[Path] = field(default_factory=list)
    size: int = 0
    problems: list[str] = field(default_factory=list)
    is_too_much: bool = False


def pack(source: Path, name: str, archive: IO[bytes]) -> None:
    """Write a file or a folder into an archive under a name, for whoever takes it out to own, and rewind."""

    def own(member: tarfile.TarInfo) -> tarfile.TarInfo:
        member.uid = member.gid = 0
        member.uname = member.gname = ""
        return member

    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.add(source.resolve(), arcname=name, filter=own)
    archive.flush()
    archive.seek(0)


def unpack(archive: IO[bytes], folder: Path, most: int) -> Unpacked:
    """Take the regular files out of an archive, whole ones alone, and put each into a folder under its own path.

    Args:
        archive: at its beginning; it may be cut off.
        folder: is there.
        most: how many bytes may come.
    """
    unpacked = Unpacked()
    # An archive ends anywhere where its program was ended.
    with suppress(tarfile.TarError, EOFError), tarfile.open(fileobj=archive, mode="r:") as tar:
        for member in tar:
            if unpacked.size + member.size > most:
                unpacked.is_too_much = True
                break
            _unpack_member(tar, member, folder, unpacked)
    return unpacked


def _unpack_member(tar: tarfile.TarFile, member: tarfile.TarInfo, folder: Path, unpacked: Unpacked) -> None:
    parts = [part for part in PurePosixPath(member.name).parts if part not in {"/", "."}]
    shown = one_line("/" + "/".join(parts))
    if member.isdir():
        return
    if ".." in parts or not parts or any("\0" in part for part in parts):
        unpacked.problems.append(f"{shown} is no path that a file here can have")
    elif member.issym():
        unpacked.problems.append(f"{shown} is a link to {one_line(member.linkname)}, which is not followed")
    elif not (member.isfile() or member.islnk()):
        unpacked.problems.append(f"{shown} is no file")
    else:
        source = tar.extractfile(member)  # of a second name for a file: what stands in the archive under the first
        if source is not None:
            target = folder.joinpath(*parts)
            _write(source, target, folder, member.size)
            unpacked.files.append(target)
            unpacked.size += target.stat().st_size


def _write(source: IO[bytes], target: Path, folder: Path, size: int) -> None:
    """Write beside and rename, so that a file is whole or not there; a link that stands on the way is replaced."""
    for above in _between(folder, target.parent):
        if above.is_symlink() or (above.exists() and not above.is_dir()):
            above.unlink()
        above.mkdir(exist_ok=True)
    beside = target.with_name(f".{target.name[:200]}.part")
    beside.unlink(missing_ok=True)
    try:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, _MODE)
        with os.fdopen(descriptor, "wb") as file:
            shutil.copyfileobj(source, file)
            if size and file.tell() < size:
                raise EOFError(f"{target} is cut off")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)


def _between(folder: Path, inner: Path) -> Iterator[Path]:
    """Yield the folders from one to another within it, the outer first."""
    above = folder
    for part in inner.relative_to(folder).parts:
        above = above / part
        yield above
