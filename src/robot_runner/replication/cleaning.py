"""Decide for each file of a package: pack it unchanged, pack it with its secrets replaced, or leave it out.

Files other than text in UTF-8 are searched, too: other encodings, archives, commits, recordings.
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
#: At most so many bytes of an archive are unpacked for the search: more may be a zip bomb.
_MOST_UNPACKED = 4 << 30
#: The deepest nesting of archives that is searched.
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
#: A pack file of git begins with one of these and the number of its objects (gitformat-pack).
_GIT_PACKS, _GIT_HEADER = (b"PACK\0\0\0\2", b"PACK\0\0\0\3"), 12
#: The types of objects that are deltas against another object.
_GIT_DELTAS = {6, 7}
#: The largest object that is unpacked, as it is held in memory as a whole, bytes.
_MOST_OF_OBJECT = 256 << 20
_UNKNOWN = {b"7z\xbc\xaf": "7z", b"Rar!": "RAR", b"PAR1": "Parquet", b"\x28\xb5\x2f\xfd": "Zstandard"}
_DAMAGED = (OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zipfile.BadZipFile, tarfile.TarError,
            lzma.LZMAError, zlib.error)  # fmt: skip


def wide_encoding(path: Path) -> str | None:
    """Return the encoding of a text in UTF-16 or UTF-32; None if it is in neither, or does not decode.

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
    """Return UTF-16 if nearly each character has a zero byte, as in European languages; else None."""
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
        UnicodeError: the file is not text in this encoding.
        OSError: the file cannot be read.
    """
    decoder = codecs.getincrementaldecoder(encoding)("strict")
    for block in chunks_of(file):
        yield decoder.decode(block).encode()
    yield decoder.decode(b"", final=True).encode()


class Search:
    """A search for secrets in a file that cannot be changed, and in the members of an archive.

    Attributes:
        found: the number of secrets of each kind.
        unread: reasons why parts of it could not be searched.

    Raises:
        OSError: the file cannot be read.
    """

    def __init__(self, path: Path, redactor: Redactor) -> None:
        self.found: Counter[str] = Counter()
        self.unread: list[str] = []
        self._redactor = redactor
        self._left = _MOST_UNPACKED
        with open_to_read(path) as file:
            self._look(file, path.name, 0)

    def _look(self, file: BinaryIO, name: str, depth: int) -> None:
        """Search one file, or one member of an archive."""
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
                    # Seekable, since it is read twice, and limited in the number of unpacked bytes.
                    self._look(io.BufferedReader(_Bounded(content, self), _BLOCK), inside, depth + 1)
            except _DAMAGED as error:
                self.unread.append(f"{name}: {str(error) or type(error).__name__}")

    def _members(self, file: BinaryIO, start: bytes, name: str) -> Iterable[tuple[str, IO[bytes]]] | None:
        """Return the members of an archive with their names; None if the file is not an archive."""
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
        """Count unpacked bytes.

        Raises:
            ValueError: the limit is exceeded.
        """
        self._left -= count
        if self._left < 0:
            raise ValueError("the contents unpack to more than 4 GiB, and were not looked through to their end")

    def _look_through(self, file: BinaryIO, start: bytes) -> None:
        has_zeros = b"\0" in start
        self.found += self._redactor.secrets_in(chunks_of(file), Grammar.MARKUP if has_zeros else Grammar.TEXT)
        if has_zeros:
            file.seek(0)  # text in UTF-16 becomes readable without its zeros
            without_zeros = (chunk.replace(b"\0", b"") for chunk in chunks_of(file))
            self.found += self._redactor.secrets_in(without_zeros, Grammar.MARKUP)


class _Bounded(io.RawIOBase):
    """A member of an archive, whose bytes are counted as they are unpacked; seekable if the archive's member is."""

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
    """Yield the objects of a pack file of git.

    Raises:
        ValueError: an object is too large, or is a delta, which cannot be searched without its base object.
    """
    count = int.from_bytes(file.read(_GIT_HEADER)[8:], "big")
    rest = b""
    for _ in range(count):
        kind, is_head = None, True
        while is_head:  # type and size, seven bits a byte; the type is in the first byte
            rest = rest or _block(file)
            kind = rest[0] >> 4 & 7 if kind is None else kind
            is_head, rest = rest[0] >= 0x80, rest[1:]  # noqa: PLR2004 - the bit that says that another byte follows
        if kind in _GIT_DELTAS:
            raise ValueError("the pack holds deltas between files, which cannot be looked through")
        stream, content = zlib.decompressobj(), bytearray()
        while not stream.eof:
            content += stream.decompress(rest or _block(file), _MOST_OF_OBJECT + 1 - len(content))
            rest = stream.unused_data or stream.unconsumed_tail
            if len(content) > _MOST_OF_OBJECT:
                raise ValueError("a file in the pack is larger than 256 MiB, and was not looked through")
        yield io.BytesIO(content)


def _block(file: BinaryIO) -> bytes:
    if block := file.read(_BLOCK):
        return block
    raise EOFError("the pack ends too early")


@dataclass(frozen=True, slots=True)
class Replaced:
    """Secrets of one kind in a file, certain or possible: their kind, number and first lines."""

    name: str
    what: str
    count: int
    lines: tuple[int, ...] = ()


@dataclass(slots=True)
class Cleaning:
    """Cleans the files of a package, and records the replacements.

    Attributes:
        redactor: finds and replaces secrets.
        keep: patterns of the names of files that are packed unchanged.
        left_out: files that hold secrets and cannot be changed.
        replaced: the replaced secrets.
        doubtful: possible secrets that were not replaced.
        unread: files that could not be searched, and why.
    """

    redactor: Redactor
    keep: tuple[str, ...] = ()
    left_out: list[LeftOut] = field(default_factory=list)
    replaced: list[Replaced] = field(default_factory=list)
    doubtful: list[Replaced] = field(default_factory=list)
    unread: list[LeftOut] = field(default_factory=list)

    def blocks_of(self, file: PackedFile) -> Iterator[bytes] | None:
        """Return a file's contents for the package, block by block; None if the file is left out.

        Raises:
            StorageError: the file cannot be read.
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
            kinds = sorted(counts.items())
            noted += [Replaced(file.name, what, count, tuple(hits.lines[what])) for what, count in kinds]

    def refusals(self) -> list[Finding]:
        """Return an error for each possible secret that was neither replaced nor allowed."""
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
    """Return kinds with their counts, such as `password (2), token (1)`."""
    return ", ".join(f"{what} ({count})" for what, count in sorted(found.items()))
