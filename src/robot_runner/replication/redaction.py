"""Replace secrets in the files of a package, block by block, so that files of any size can be packed."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import IO

from robot_runner.core.secret_names import REDACTED
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.replication.code_secrets import found_in_code
from robot_runner.replication.named_secrets import (
    NAME_HINTS,
    Grammar,
    cells_apart,
    named_secrets,
    secret_columns,
    secrets_in_columns,
)
from robot_runner.replication.secret_kinds import HOME_PATH, Found, Kind, kinds, literal, reduced

_BLOCK = 1 << 20
#: A file up to this size is searched as a whole, bytes.
_WHOLE = 4 << 20
#: If a line is longer than a block, so many bytes move to the next block, to find secrets across the cut.
_KEPT_BACK = 8192
#: A longer line is not the heading of a table, bytes.
_LONGEST_HEADING = 1 << 16
#: At most so many line numbers are recorded for each kind and file.
_MOST_LINES = 20
_SNIFFED = 8192
_BINARY_TEXT = ".bag .bz2 .db3 .gz .mcap .npz .parquet .pdf .png .tar .tgz .whl .woff2 .xz .zip .zst"
_BINARY = frozenset(_BINARY_TEXT.split())
_GRAMMARS = {
    **dict.fromkeys((".json", ".jsonl", ".ipynb"), Grammar.DATA),
    **dict.fromkeys((".csv", ".tsv"), Grammar.TABLE),
    **dict.fromkeys((".html", ".svg"), Grammar.MARKUP),
    **dict.fromkeys((".py", ".pyi"), Grammar.CODE),
}


def chunks_of(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the rest of a file, block by block."""
    return iter(partial(file.read, _BLOCK), b"")


def grammar_of(path: Path) -> Grammar:
    """Return the grammar of a file, by its suffix."""
    return _GRAMMARS.get(path.suffix.casefold(), Grammar.TEXT)


def is_binary(path: Path) -> bool:
    """Whether a file is binary, so that replacing bytes would break it.

    Raises:
        OSError: the file cannot be read.
    """
    if path.suffix.casefold() in _BINARY:
        return True
    with open_to_read(path) as file:
        return b"\0" in file.read(_SNIFFED)


@dataclass(slots=True)
class Hits:
    """The secrets found in a file: number and first lines of each kind.

    Attributes:
        replaced: the number of replaced secrets of each kind.
        doubtful: the number of possible secrets of each kind that were not replaced.
        lines: the numbers of the first lines with each kind, from 1.
    """

    replaced: Counter[str] = field(default_factory=Counter)
    doubtful: Counter[str] = field(default_factory=Counter)
    lines: dict[str, list[int]] = field(default_factory=dict)

    def note(self, found: Found, line: int, *, is_replaced: bool) -> None:
        """Count a secret, and record its line."""
        (self.replaced if is_replaced else self.doubtful)[found.what] += 1
        lines = self.lines.setdefault(found.what, [])
        if len(lines) < _MOST_LINES and line not in lines[-1:]:
            lines.append(line)


@dataclass(frozen=True)
class Redactor:
    """Replaces secrets in files.

    Attributes:
        known: known secrets of this experiment, which are replaced wherever they occur, and the user's home folder.
        has_general: whether to search for all kinds of secrets, and not only for known ones and private keys.
        replaces_doubtful: whether to replace possible secrets, too.

    Example:
        >>> redactor = Redactor.knowing({"swordfish"}, home=None)
        >>> redactor.redacted(b"GET /home/ada/map.pgm with swordfish")
        b'GET ~/map.pgm with REDACTED'
    """

    known: tuple[Kind, ...]
    has_general: bool = True
    replaces_doubtful: bool = False

    @classmethod
    def knowing(cls, secrets: Iterable[str], *, home: Path | None, replaces_doubtful: bool = False) -> Redactor:
        """Return a redactor that also replaces these texts and the user's home folder."""
        texts = sorted(secrets, key=lambda text: (-len(text), text))
        known = [literal("password", text, REDACTED, is_whole=text.isalnum()) for text in texts]
        own = [literal(HOME_PATH, str(home), "~")] if home and len(home.parts) > 2 else []  # noqa: PLR2004
        return cls((*known, *own), replaces_doubtful=replaces_doubtful)

    @property
    def own(self) -> Redactor:
        """A redactor of only the known secrets, the home folder and private keys: code causes many false alarms."""
        return Redactor(self.known, has_general=False)

    @cached_property
    def _kinds(self) -> tuple[Kind, ...]:
        wanted = [*self.known, *(each for each in kinds() if self.has_general or each.what == "private key")]
        return tuple(sorted(wanted, key=lambda each: each.what == HOME_PATH))  # last: secrets in paths

    def find(self, block: bytes, grammar: Grammar, *, is_file: bool = False, separator: bytes = b",") -> list[Found]:
        """Return the secrets of a block in their order, without overlaps.

        Args:
            block: the text.
            grammar: its grammar.
            is_file: whether it is a whole file, so that code can be parsed.
            separator: between the columns of a table.
        """
        hinted = reduced(block)
        if not hinted:
            return []
        found: list[Found] = []
        if is_file and grammar is Grammar.CODE and self.has_general:
            found += found_in_code(block)
        searched = cells_apart(block, separator) if grammar is Grammar.TABLE else block
        for kind in self._kinds:
            if any(hint in hinted for hint in kind.hints):
                found += kind.find(block if kind in self.known else searched)
        if self.has_general and any(hint in hinted for hint in NAME_HINTS):
            found += named_secrets(searched, grammar)
        return _without_overlap(found)

    def secrets_in(self, chunks: Iterable[bytes], grammar: Grammar) -> Counter[str]:
        """Return the number of secrets of each kind in a text, which is given in chunks and stays unchanged."""
        hits = Hits()
        for _ in self.cleaned(chunks, hits, grammar):
            pass
        return hits.replaced

    def redacted(self, block: bytes, grammar: Grammar = Grammar.MARKUP) -> bytes:
        """Return a block with its secrets replaced."""
        return self._replaced(block, self.find(block, grammar), Hits(), 1)

    def cleaned(self, chunks: Iterable[bytes], hits: Hits, grammar: Grammar) -> Iterator[bytes]:
        """Yield a text with its secrets replaced; it is given in chunks of UTF-8, and yielded in other blocks."""
        kept, line, is_whole, is_in_row, separator, columns = b"", 1, True, False, b",", frozenset[int]()
        for chunk, is_last in _with_last(chunks):
            kept += chunk
            if not is_last and is_whole and len(kept) < _WHOLE:
                continue
            if is_whole and grammar is Grammar.TABLE and self.has_general:
                separator, columns = secret_columns(kept[:_LONGEST_HEADING])
            found = self.find(kept, grammar, is_file=is_whole and is_last, separator=separator)
            ends: list[int] = []
            if columns:
                in_columns, ends = _in_columns(kept, separator, columns, is_whole=is_whole, is_last=is_last)
                found = _without_overlap([*found, *in_columns])
            cut = len(kept) if is_last else _cut_of(kept, found)
            if columns and not is_last:
                row_end = _row_end(ends, cut, found)
                is_in_row = not row_end and (is_in_row or len(kept) >= 2 * _WHOLE)  # too long to keep
                cut = cut if is_in_row else row_end
            yield self._replaced(kept[:cut], [each for each in found if each.end <= cut], hits, line)
            line += kept.count(b"\n", 0, cut)
            kept, is_whole = kept[cut:], is_whole and not cut

    def _replaced(self, block: bytes, found: list[Found], hits: Hits, line: int) -> bytes:
        if not found:
            return block
        parts, end = [], 0
        for each in found:
            line += block.count(b"\n", end, each.start)
            is_replaced = each.is_sure or self.replaces_doubtful
            hits.note(each, line, is_replaced=is_replaced)
            parts += [block[end : each.start], each.replacement if is_replaced else block[each.start : each.end]]
            line += block.count(b"\n", each.start, each.end)
            end = each.end
        return b"".join([*parts, block[end:]])


def _in_columns(
    block: bytes, separator: bytes, columns: frozenset[int], *, is_whole: bool, is_last: bool
) -> tuple[list[Found], list[int]]:
    """Return the possible secrets in columns, and the ends of complete rows."""
    found, ends = secrets_in_columns(block, separator, columns, has_heading=is_whole, goes_on=not is_last)
    if is_last or len(block) - (ends[-1] if ends else 0) < _WHOLE:
        return found, ends
    # No cell is that long: the quotation mark is never closed.
    return secrets_in_columns(block, separator, columns, has_heading=is_whole, goes_on=False)


def _row_end(ends: list[int], cut: int, found: list[Found]) -> int:
    """Return the last end of a row before a cut that is not inside a found secret; 0 if there is none."""
    end = ends[at - 1] if (at := bisect_right(ends, cut)) else 0
    for each in reversed(found):
        if each.begin < end < each.end:
            end = ends[at - 1] if (at := bisect_right(ends, each.begin)) else 0
    return end


def _with_last(chunks: Iterable[bytes]) -> Iterator[tuple[bytes, bool]]:
    """Yield each chunk, and whether it is the last one."""
    before: bytes | None = None
    for chunk in chunks:
        if before is not None:
            yield before, False
        before = chunk
    if before is not None:
        yield before, True


def _without_overlap(found: list[Found]) -> list[Found]:
    """Return the findings in the order of the text; overlapping ones are merged."""
    kept: list[Found] = []
    for each in sorted(found, key=lambda each: each.start):
        if kept and each.start < kept[-1].end:
            kept[-1] = _joined(kept[-1], each)
        else:
            kept.append(each)
    return kept


def _joined(first: Found, second: Found) -> Found:
    """Return the union of two findings, with the description and the replacement of the longer one."""
    sure = [each for each in (first, second) if each.is_sure] or [first, second]
    secret = [each for each in sure if each.what != HOME_PATH] or sure
    widest = max(secret, key=lambda each: each.end - each.start)
    if not widest.is_sure or len(sure) == 1:  # a possible secret that overlaps a certain one is dropped
        first = second = widest
    start, end = min(first.start, second.start), max(first.end, second.end)
    return widest._replace(start=start, end=end, begin=min(first.begin, second.begin))


def _cut_of(block: bytes, found: list[Found]) -> int:
    """Return where to cut a block that continues: after a line if possible, and not inside a secret or a key."""
    cut = block.rfind(b"\n") + 1 or max(0, len(block) - _KEPT_BACK)
    begun = block.rfind(b"-----BEGIN ", 0, cut)
    if begun >= 0 and block.find(b"-----END ", begun, cut) < 0 and cut - begun < 1 << 16:
        cut = begun
    for each in reversed(found):
        if each.begin < cut < each.end:
            cut = each.begin
    return cut if cut or len(block) < 2 * _WHOLE else len(block)
