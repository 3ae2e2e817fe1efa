"""Files that are no text in UTF-8, looked through for secrets: other encodings, archives, commits, recordings."""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import lzma
import tarfile
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import IO, TYPE_CHECKING, BinaryIO, cast

from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.replication.named_secrets import Grammar
from robot_runner.replication.redaction import Hits

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.replication.redaction import Redactor

_BLOCK = 1 << 20
_SNIFFED = 8192
#: So much of what is packed in an archive is unpacked to look at it, in all: more may be a bomb.
_MOST_UNPACKED = 4 << 30
#: Archives in archives.
_DEEPEST = 3
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


def _gunzipped(file: BinaryIO) -> IO[bytes]:
    return cast("IO[bytes]", gzip.GzipFile(fileobj=file))


def _bunzipped(file: BinaryIO) -> IO[bytes]:
    return bz2.BZ2File(file)


def _unxzipped(file: BinaryIO) -> IO[bytes]:
    return lzma.LZMAFile(file)


_Opener = Callable[[BinaryIO], IO[bytes]]
_PRESSED: tuple[tuple[bytes, _Opener], ...] = (
    (b"\x1f\x8b", _gunzipped),
    (b"BZh", _bunzipped),
    (b"\xfd7zXZ\0", _unxzipped),
)
#: A file of git's objects begins with this and one of two versions, and then tells their number (gitformat-pack).
_GIT_PACKS, _GIT_HEADER = (b"PACK\0\0\0\2", b"PACK\0\0\0\3"), 12
#: The kinds of objects that are deltas against another one.
_GIT_DELTAS = {6, 7}
#: An object is unpacked as a whole, bytes.
_MOST_OF_OBJECT = 256 << 20
_UNKNOWN = {b"7z\xbc\xaf": "7z", b"Rar!": "RAR", b"PAR1": "Parquet", b"\x28\xb5\x2f\xfd": "Zstandard"}
_DAMAGED = (OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zipfile.BadZipFile, tarfile.TarError,
            lzma.LZMAError, zlib.error)  # fmt: skip


def wide_encoding(path: Path) -> str | None:
    """Return the encoding of a text of two or four bytes a letter; None where it is none, or does not decode.

    Raises:
        OSError: the file cannot be read.
    """
    with open_to_read(path) as file:
        start = file.read(_SNIFFED)
        encoding = next((name for mark, name in _MARKS if start.startswith(mark)), None) or _guessed(start)
        if encoding is None:
            return None
        file.seek(0)
        try:
            for _ in recoded(file, encoding):
                pass
        except UnicodeError:
            return None
    return encoding


def _guessed(start: bytes) -> str | None:
    """Return UTF-16 where nearly each letter has a byte that is zero, as those of European languages have."""
    half = len(start) // 2
    if half < 4:  # noqa: PLR2004 - too few to judge
        return None
    zeros = start[0::2].count(0) / half, start[1::2].count(0) / half
    encoding = "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"
    text = start[: 2 * half].decode(encoding, "replace")
    is_readable = sum(each.isprintable() or each in "\r\n\t" for each in text) > 0.95 * len(text)
    return encoding if max(zeros) > 0.7 and is_readable else None  # noqa: PLR2004 - well apart from numbers


def recoded(file: BinaryIO, encoding: str) -> Iterator[bytes]:
    """Yield a text in blocks of UTF-8.

    Raises:
        UnicodeError: it is no text in this encoding.
        OSError: it cannot be read.
    """
    decoder = codecs.getincrementaldecoder(encoding)("strict")
    for block in _chunks(file):
        yield decoder.decode(block).encode()
    yield decoder.decode(b"", final=True).encode()


@dataclass(slots=True)
class Searched:
    """What is known of a file in which nothing can be replaced.

    Attributes:
        found: how many secrets of each kind are in it.
        unread: why some of it could not be looked into, in words.
    """

    found: Counter[str] = field(default_factory=Counter)
    unread: list[str] = field(default_factory=list)


def search(path: Path, redactor: Redactor) -> Searched:
    """Look through a file as it is, and through what is packed in it.

    Raises:
        OSError: it cannot be read.
    """
    searched = Searched()
    with open_to_read(path) as file:
        _Search(redactor, searched).look(file, path.name, 0)
    return searched


class _Search:
    def __init__(self, redactor: Redactor, searched: Searched) -> None:
        self._redactor = redactor
        self._searched = searched
        self._left = _MOST_UNPACKED

    def look(self, file: BinaryIO, name: str, depth: int) -> None:
        """Look through one file, or one member of an archive."""
        start = file.read(_SNIFFED)
        file.seek(0)
        if kind := next((words for magic, words in _UNKNOWN.items() if start.startswith(magic)), None):
            self._searched.unread.append(f"{name}: {kind} is looked through as it is, not unpacked")
        opener = next((opener for magic, opener in _PRESSED if start.startswith(magic)), None)
        is_tar, is_git = start[257:262] == b"ustar", start.startswith(_GIT_PACKS)
        if not (opener or is_tar or is_git or start.startswith(b"PK\x03\x04")):
            self._look_through(file, start)
        elif depth >= _DEEPEST:
            self._searched.unread.append(f"{name}: an archive in an archive")
        else:
            self._unpack(file, name, depth, opener, is_tar=is_tar, is_git=is_git)

    def _unpack(
        self, file: BinaryIO, name: str, depth: int, opener: _Opener | None, *, is_tar: bool, is_git: bool
    ) -> None:
        try:
            if opener is not None:
                with opener(file) as inner:
                    self.look(self._spooled(inner), name.rpartition(".")[0], depth + 1)
            elif is_git:
                for number, inside in enumerate(_git_objects(file)):
                    self.look(self._spooled(inside), f"{name}/{number}", depth + 1)
            elif is_tar:
                with tarfile.open(fileobj=file, mode="r:") as archive:
                    for member in archive:
                        if member.isreg() and (content := archive.extractfile(member)):
                            self.look(self._spooled(content), f"{name}/{member.name}", depth + 1)
            else:
                with zipfile.ZipFile(file) as zipped:
                    for entry in zipped.infolist():
                        self._look_at_entry(zipped, entry, name, depth)
        except _DAMAGED as error:
            self._searched.unread.append(f"{name}: {str(error) or type(error).__name__}")

    def _look_at_entry(self, zipped: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str, depth: int) -> None:
        if entry.is_dir():
            return
        inside = f"{name}/{entry.filename}"
        if entry.flag_bits & 1:
            self._searched.unread.append(f"{inside}: encrypted")
            return
        with zipped.open(entry) as content:
            self.look(self._spooled(content), inside, depth + 1)

    def _spooled(self, file: IO[bytes]) -> BinaryIO:
        """Return a stream that can be read twice from its start, bounded in what it unpacks."""
        return io.BufferedReader(_Bounded(file, self), _BLOCK)

    def take(self, count: int) -> None:
        """Count what was unpacked.

        Raises:
            ValueError: it is more than is looked at.
        """
        self._left -= count
        if self._left < 0:
            raise ValueError("it unpacks to more than 4 GiB, and was not looked through to its end")

    def _look_through(self, file: BinaryIO, start: bytes) -> None:
        is_text = b"\0" not in start
        hits = Hits()
        for _ in self._redactor.cleaned(_chunks(file), hits, Grammar.TEXT if is_text else Grammar.MARKUP):
            pass
        if not is_text:  # texts of two bytes a letter are texts without their zeros
            file.seek(0)
            without_zeros = (chunk.replace(b"\0", b"") for chunk in _chunks(file))
            for _ in self._redactor.cleaned(without_zeros, hits, Grammar.MARKUP):
                pass
        self._searched.found += hits.replaced


class _Bounded(io.RawIOBase):
    """What an archive holds, counted as it is unpacked; it may go back to its start, as long as the archive can."""

    def __init__(self, file: IO[bytes], search: _Search) -> None:
        self._file = file
        self._search = search

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, place: int, whence: int = 0) -> int:
        return self._file.seek(place, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, target: memoryview) -> int:  # type: ignore[override] # the buffer that io hands in
        block = self._file.read(len(target))
        self._search.take(len(block))
        target[: len(block)] = block
        return len(block)


def _git_objects(file: BinaryIO) -> Iterator[BinaryIO]:
    """Yield the objects of a pack of git, one after another.

    Raises:
        ValueError: one of them is too large, or is a delta, which means nothing without the object that it changes.
    """
    count = int.from_bytes(file.read(_GIT_HEADER)[8:], "big")
    rest = b""
    for _ in range(count):
        kind, is_head = None, True
        while is_head:  # kind and size, seven bits a byte; the kind is in the first one
            rest = rest or _block(file)
            kind = rest[0] >> 4 & 7 if kind is None else kind
            is_head, rest = rest[0] >= 0x80, rest[1:]  # noqa: PLR2004 - the bit that says that another byte follows
        if kind in _GIT_DELTAS:
            raise ValueError("it holds deltas between files, which cannot be looked through")
        stream, content = zlib.decompressobj(), bytearray()
        while not stream.eof:
            content += stream.decompress(rest or _block(file), _MOST_OF_OBJECT + 1 - len(content))
            rest = stream.unused_data or stream.unconsumed_tail
            if len(content) > _MOST_OF_OBJECT:
                raise ValueError("a file in it is larger than 256 MiB, and was not looked through")
        yield io.BytesIO(content)


def _block(file: BinaryIO) -> bytes:
    if block := file.read(_BLOCK):
        return block
    raise EOFError("it ends too early")


def _chunks(file: BinaryIO) -> Iterator[bytes]:
    return iter(partial(file.read, _BLOCK), b"")
