"""Which form a file goes into a package in: as it is, without its secrets, or not at all.

Files that are no text in UTF-8 are looked through as well: other encodings, archives, commits, recordings.
"""

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
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import IO, BinaryIO, cast

from robot_runner.core.errors import Finding
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.words import one_line
from robot_runner.replication.contents import LeftOut, PackedFile
from robot_runner.replication.named_secrets import Grammar
from robot_runner.replication.redaction import Hits, Redactor, chunks_of, grammar_of, is_binary

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


_PRESSED: dict[bytes, Callable[[BinaryIO], IO[bytes]]] = {
    b"\x1f\x8b": lambda file: cast("IO[bytes]", gzip.GzipFile(fileobj=file)),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\0": lzma.LZMAFile,
}
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
    for block in chunks_of(file):
        yield decoder.decode(block).encode()
    yield decoder.decode(b"", final=True).encode()


class Search:
    """Looks through a file in which nothing can be replaced, as it is, and through what is packed in it.

    Attributes:
        found: how many secrets of each kind are in it.
        unread: why some of it could not be looked into, in words.

    Raises:
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, redactor: Redactor) -> None:
        self.found: Counter[str] = Counter()
        self.unread: list[str] = []
        self._redactor = redactor
        self._left = _MOST_UNPACKED
        with open_to_read(path) as file:
            self._look(file, path.name, 0)

    def _look(self, file: BinaryIO, name: str, depth: int) -> None:
        """Look through one file, or one member of an archive."""
        start = file.read(_SNIFFED)
        file.seek(0)
        if kind := next((words for magic, words in _UNKNOWN.items() if start.startswith(magic)), None):
            self.unread.append(f"{name}: {kind} is looked through as it is, not unpacked")
        members = self._members(file, start, name)
        if members is None:
            self._look_through(file, start)
        elif depth >= _DEEPEST:
            self.unread.append(f"{name}: an archive in an archive")
        else:
            try:
                for inside, content in members:
                    # It can be read twice from its start, and is bounded in what it unpacks.
                    self._look(io.BufferedReader(_Bounded(content, self), _BLOCK), inside, depth + 1)
            except _DAMAGED as error:
                self.unread.append(f"{name}: {str(error) or type(error).__name__}")

    def _members(self, file: BinaryIO, start: bytes, name: str) -> Iterable[tuple[str, IO[bytes]]] | None:
        """Return what is packed in a file, each with its name; None where it is no archive."""
        if opener := next((opener for magic, opener in _PRESSED.items() if start.startswith(magic)), None):
            return [(name.rpartition(".")[0], opener(file))]
        if start.startswith(_GIT_PACKS):
            return ((f"{name}/{number}", inside) for number, inside in enumerate(_git_objects(file)))
        if start[257:262] == b"ustar":
            return _members_of_tar(file, name)
        return self._members_of_zip(file, name) if start.startswith(b"PK\x03\x04") else None

    def _members_of_zip(self, file: BinaryIO, name: str) -> Iterator[tuple[str, IO[bytes]]]:
        with zipfile.ZipFile(file) as archive:
            for entry in (each for each in archive.infolist() if not each.is_dir()):
                inside = f"{name}/{entry.filename}"
                if entry.flag_bits & 1:
                    self.unread.append(f"{inside}: encrypted")
                    continue
                with archive.open(entry) as content:
                    yield inside, content

    def take(self, count: int) -> None:
        """Count what was unpacked.

        Raises:
            ValueError: it is more than is looked at.
        """
        self._left -= count
        if self._left < 0:
            raise ValueError("it unpacks to more than 4 GiB, and was not looked through to its end")

    def _look_through(self, file: BinaryIO, start: bytes) -> None:
        if b"\0" not in start:
            self.found += self._redactor.secrets_in(chunks_of(file), Grammar.TEXT)
            return
        self.found += self._redactor.secrets_in(chunks_of(file), Grammar.MARKUP)
        file.seek(0)  # texts of two bytes a letter are texts without their zeros
        without_zeros = (chunk.replace(b"\0", b"") for chunk in chunks_of(file))
        self.found += self._redactor.secrets_in(without_zeros, Grammar.MARKUP)


class _Bounded(io.RawIOBase):
    """What an archive holds, counted as it is unpacked; it may go back to its start, as long as the archive can."""

    def __init__(self, file: IO[bytes], search: Search) -> None:
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


def _members_of_tar(file: BinaryIO, name: str) -> Iterator[tuple[str, IO[bytes]]]:
    with tarfile.open(fileobj=file, mode="r:") as archive:
        for member in archive:
            if member.isreg() and (content := archive.extractfile(member)):
                yield f"{name}/{member.name}", content


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


@dataclass(frozen=True, slots=True)
class Replaced:
    """What was replaced in a file, or may have to be: of which kind, how many, and in which lines at first."""

    name: str
    what: str
    count: int
    lines: tuple[int, ...] = ()


@dataclass(slots=True)
class Cleaning:
    """Cleans the files of a package, and remembers what it did.

    Attributes:
        redactor: finds and replaces secrets.
        keep: patterns of names of files that go in as they are.
        left_out: files that hold secrets and cannot be changed.
        replaced: what was replaced.
        doubtful: what may be a secret, and stayed.
        unread: what could not be looked into, and why.
    """

    redactor: Redactor
    keep: tuple[str, ...] = ()
    left_out: list[LeftOut] = field(default_factory=list)
    replaced: list[Replaced] = field(default_factory=list)
    doubtful: list[Replaced] = field(default_factory=list)
    unread: list[LeftOut] = field(default_factory=list)

    def blocks_of(self, file: PackedFile) -> Iterator[bytes] | None:
        """Return a file's contents as they go into the package, block by block; None where it stays out.

        Raises:
            StorageError: it cannot be read.
        """
        if any(fnmatch(file.name, pattern) for pattern in self.keep):
            return _unchanged(file.path)
        with storage_errors(file.path, "read"):
            if not is_binary(file.path):
                return self._cleaned(file, None)
            if encoding := wide_encoding(file.path):
                return self._cleaned(file, encoding)
            searched = Search(file.path, self.redactor)
        self.unread += [LeftOut(file.name, one_line(why)) for why in searched.unread]
        if searched.found:
            found = in_words(searched.found)
            why = f"the file holds {found}, and nothing in it can be replaced (--keep packs it as it is)"
            self.left_out.append(LeftOut(file.name, why))
            return None
        return _unchanged(file.path)

    def _cleaned(self, file: PackedFile, encoding: str | None) -> Iterator[bytes]:
        hits = Hits()
        with open_to_read(file.path) as source:
            texts = chunks_of(source) if encoding is None else recoded(source, encoding)
            cleaned = self.redactor.cleaned(texts, hits, grammar_of(file.path))
            if encoding is None:
                yield from cleaned
            else:
                yield from (text.encode(encoding) for text in codecs.iterdecode(cleaned, "utf-8"))
        for counts, noted in ((hits.replaced, self.replaced), (hits.doubtful, self.doubtful)):
            noted += [
                Replaced(file.name, what, count, tuple(hits.lines[what])) for what, count in sorted(counts.items())
            ]

    def refusals(self) -> list[Finding]:
        """Return an error for whatever may be a secret and was neither replaced nor allowed."""
        fix = "Look at it. --doubtful keep packs it as it is, --doubtful replace without it; or change the file."
        return [
            Finding.error(place, f"this line has {each.what}", fix)
            for each in self.doubtful
            for place in ([f"{each.name}:{line}" for line in each.lines] or [each.name])
        ]


def _unchanged(path: Path) -> Iterator[bytes]:
    with open_to_read(path) as file:
        yield from chunks_of(file)


def in_words(found: Counter[str]) -> str:
    """Return kinds with their counts, as in `password (2), token (1)`."""
    return ", ".join(f"{what} ({count})" for what, count in sorted(found.items()))
