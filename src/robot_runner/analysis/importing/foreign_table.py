"""Reading a CSV file that somebody else wrote, or saved from a spreadsheet, as text."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.cells import number_of
from robot_runner.core.storage.safe_write import storage_error

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["CsvDialect", "ForeignTable", "dialect_of", "read_foreign_table"]

_DELIMITERS = (",", ";", "\t", "|")
_DECIMAL_COMMA = re.compile(r"(?<![0-9])-?[0-9]+,[0-9]+(?![0-9,])")
_TRUE = frozenset({"true", "false"})

#: As much of a file as is needed to see how it is written.
_HEAD = 1 << 16


@dataclass(frozen=True, slots=True)
class CsvDialect:
    """How a CSV file is written.

    Attributes:
        encoding: `utf-8-sig`, `utf-16` or `cp1252`.
        delimiter: what stands between the cells.
        decimal_comma: whether numbers are written `0,5`.
        blank_lines: how many lines without any cell come before the heading.
    """

    encoding: str
    delimiter: str
    decimal_comma: bool
    blank_lines: int

    @property
    def words(self) -> str:
        """What is unusual about it, in words; empty where nothing is."""
        names = {";": "semicolons", "\t": "tabs", "|": "bars"}
        parts = [names[self.delimiter]] if self.delimiter in names else []
        parts += ["decimal commas"] if self.decimal_comma else []
        parts += [f"{self.blank_lines} blank line{'s' * (self.blank_lines > 1)} first"] if self.blank_lines else []
        parts += [f"character set {self.encoding}"] if self.encoding != "utf-8-sig" else []
        return ", ".join(parts)


@dataclass(frozen=True)
class ForeignTable:
    """A table of texts.

    Attributes:
        headings: the names of the columns, trimmed.
        rows: the cells of each row, trimmed; as many as there are headings.
        lines: the line of the file on which each row begins.
        unnamed: the columns that had no heading, by the names that they have here.
        notes: what was done about those.
    """

    path: Path
    dialect: CsvDialect
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    unnamed: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()

    def column(self, heading: str) -> tuple[str, ...]:
        """Return the cells of a column."""
        return self._columns[heading]

    def is_numeric(self, heading: str) -> bool:
        """Return whether the column has numbers, and nothing else beside empty cells."""
        return heading in self._numeric

    def is_boolean(self, heading: str) -> bool:
        """Return whether the column has `true` and `false` in any case of letters, and nothing else."""
        return heading in self._boolean

    @cached_property
    def _columns(self) -> dict[str, tuple[str, ...]]:
        return dict(zip(self.headings, zip(*self.rows, strict=True), strict=True)) if self.rows else {}

    @cached_property
    def _distinct(self) -> dict[str, set[str]]:
        """The filled cells of each column that has any."""
        return {name: filled for name, cells in self._columns.items() if (filled := set(cells) - {""})}

    @cached_property
    def _numeric(self) -> frozenset[str]:
        comma = self.dialect.decimal_comma
        return frozenset(
            name
            for name, cells in self._distinct.items()
            if all(number_of(cell, decimal_comma=comma) is not None for cell in cells)
        )

    @cached_property
    def _boolean(self) -> frozenset[str]:
        return frozenset(name for name, cells in self._distinct.items() if {cell.casefold() for cell in cells} <= _TRUE)


def read_foreign_table(path: Path) -> ForeignTable:
    """Read a table: with or without a byte-order mark, with commas, semicolons or tabs, with blank lines anywhere.

    Raises:
        StorageError: it cannot be read.
        AnalysisError: it has no heading, or rows that do not fit it.
    """
    dialect = dialect_of(path)
    rows: list[tuple[int, list[str]]] = []
    try:
        with path.open(encoding=dialect.encoding, errors="replace", newline="") as file:
            lines = csv.reader(file, delimiter=dialect.delimiter)
            before = 0
            for row in lines:
                rows.append((before + 1, [cell.strip() for cell in row]))
                before = lines.line_num
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except csv.Error as error:
        fix = "Mend the quotes in it."
        raise AnalysisError(f"it is no CSV: {error}", where=f"{path}:{before + 1}", fix=fix) from error
    filled = [(line, row) for line, row in rows if any(row)]
    if not filled:
        raise AnalysisError("it is empty", where=str(path), fix="Name the file that holds the runs.")
    return _table(path, dialect, filled)


def dialect_of(path: Path) -> CsvDialect:
    """Return how a CSV file is written, by its first lines.

    Raises:
        StorageError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise storage_error(path, "read", error) from error
    encoding = _encoding(head)
    lines = head.decode(encoding, "replace").splitlines()
    blank = next((place for place, line in enumerate(lines) if line.strip(" ,;\t|")), len(lines))
    lines = lines[blank:]
    heading = lines[0] if lines else ""
    delimiter = max(_DELIMITERS, key=lambda each: len(next(csv.reader([heading], delimiter=each), [])))
    body = "\n".join(lines[1:50])
    return CsvDialect(encoding, delimiter, delimiter != "," and bool(_DECIMAL_COMMA.search(body)), blank)


def _encoding(head: bytes) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        head[: len(head) - 4].decode("utf-8-sig")  # a character may be cut off at the end
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _table(path: Path, dialect: CsvDialect, filled: Sequence[tuple[int, list[str]]]) -> ForeignTable:
    line, headings = filled[0]
    for name in filter(None, headings):
        if headings.count(name) > 1:
            problem = f"heading {name!r} is there twice"
            raise AnalysisError(problem, where=f"{path}:{line}", fix="Name each column, each differently.")
    width = len(headings)
    rows, lines = [], []
    for number, row in filled[1:]:
        if any(row[width:]):
            problem = f"the row has {len(row)} cells, the heading has {width}"
            raise AnalysisError(problem, where=f"{path}:{number}", fix="Give it a cell under each heading.")
        rows.append((*row[:width], *[""] * (width - len(row))))
        lines.append(number)
    # A spreadsheet leaves an empty column behind a deleted one.
    kept = [place for place, name in enumerate(headings) if name or any(row[place] for row in rows)]
    notes = []
    if kept and not headings[kept[0]] and [row[kept[0]] for row in rows] == [*map(str, range(len(rows)))]:
        notes.append("the first column has no heading and numbers the rows: left out")
        kept = kept[1:]
    named = {place: headings[place] or _free(f"column_{place + 1}", headings) for place in kept}
    unnamed = [name for place, name in named.items() if not headings[place]]
    if unnamed:
        many = f"{len(unnamed)} columns have" if len(unnamed) > 1 else "a column has"
        notes.append(f"{many} no heading ({', '.join(unnamed)} here): values may stand under headings of others")
    return ForeignTable(
        path,
        dialect,
        tuple(named.values()),
        tuple(tuple(row[place] for place in kept) for row in rows),
        tuple(lines),
        frozenset(unnamed),
        tuple(notes),
    )


def _free(name: str, taken: Sequence[str]) -> str:
    while name in taken:
        name += "_"
    return name
