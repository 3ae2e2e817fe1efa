"""Which form a file goes into a package in: as it is, without its secrets, or not at all."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import one_line
from robot_runner.replication.contents import LeftOut, PackedFile
from robot_runner.replication.redaction import Hits, Redactor, chunks_of, grammar_of, is_binary
from robot_runner.replication.searched_files import recoded, search, wide_encoding

if TYPE_CHECKING:
    from collections import Counter


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
        try:
            if not is_binary(file.path):
                return self._cleaned(file, None)
            if encoding := wide_encoding(file.path):
                return self._cleaned(file, encoding)
            searched = search(file.path, self.redactor)
        except OSError as error:
            raise storage_error(file.path, "read", error) from error
        self.unread += [LeftOut(file.name, one_line(why)) for why in searched.unread]
        if searched.found:
            found = in_words(searched.found)
            why = f"the file holds {found}, and nothing in it can be replaced (--keep packs it as it is)"
            self.left_out.append(LeftOut(file.name, why))
            return None
        return _unchanged(file.path)

    def _cleaned(self, file: PackedFile, encoding: str | None) -> Iterator[bytes]:
        hits = Hits()
        if encoding is None:
            yield from self.redactor.blocks(file.path, hits)
        else:
            with open_to_read(file.path) as source:
                cleaned = self.redactor.cleaned(recoded(source, encoding), hits, grammar_of(file.path))
                for text in codecs.iterdecode(cleaned, "utf-8"):
                    yield text.encode(encoding)
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
