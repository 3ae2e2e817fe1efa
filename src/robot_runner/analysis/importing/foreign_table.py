"""Read a CSV file of another tool or a spreadsheet, or a run table of Robot Runner without its schema, as text."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import BinaryIO

from robot_runner.analysis.importing.units import MISSING, PlainCells, Unit, plain_cells, split_heading
from robot_runner.core.design.columns import BATCH, EXCLUDED, RUN_ID, STAMP_COLUMNS, STATUS, WARM_UP
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.cells import number_of
from robot_runner.core.storage.system_refusals import storage_error, storage_errors
from robot_runner.core.words import counted, listed

_DELIMITERS = {",": "", ";": "semicolons", "\t": "tabs", "|": "bars"}
#: The line by which Excel says what stands between the cells; it has none itself.
_SEPARATOR = re.compile(rf'"?sep=([{"".join(_DELIMITERS)}])"?\s*', re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"(?<![0-9])-?[0-9]+,[0-9]+(?![0-9,])")
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}\.\d{3}")
_MINUS = re.compile(r"^\N{MINUS SIGN}(?=[\d.,])")
#: The heading that pandas writes for a column without a name.
_WRITTEN_FOR_NONE = re.compile(r"Unnamed: \d+(_level_\d+)?")

#: How tables say yes and no, in small letters; spreadsheets write truth values in the language of their user.
ANSWERS = dict.fromkeys(("yes", "ja", "oui", "si", "sí", "wahr", "vrai"), True) | dict.fromkeys(
    ("no", "nein", "nee", "non", "falsch", "faux"), False
)

#: The part of a file that is examined to find its dialect, bytes.
_HEAD = 1 << 16
#: More rows are not an experiment: at a second a run they would take two days, and nobody could read the report.
_MOST_RUNS = 200_000
_LINES_LOOKED_AT = 50


@dataclass(frozen=True, slots=True)
class CsvDialect:
    """How a CSV file is written.

    Attributes:
        encoding: `utf-8-sig`, `utf-16` or `cp1252`.
        delimiter: the character between the cells.
        decimal_comma: whether numbers are written `0,5`.
        blank_lines: how many lines come before the heading: without any cell, or Excel's own (`sep=;`).
    """

    encoding: str
    delimiter: str
    decimal_comma: bool
    blank_lines: int

    @property
    def words(self) -> str:
        """The unusual parts of the dialect in words; empty without any."""
        blank = f"{counted(self.blank_lines, 'line')} before the heading" if self.blank_lines else ""
        decimal = "decimal commas" if self.decimal_comma else ""
        encoding = f"character set {self.encoding}" if self.encoding != "utf-8-sig" else ""
        return ", ".join(filter(None, (_DELIMITERS[self.delimiter], decimal, blank, encoding)))


@dataclass(frozen=True)
class ForeignTable:
    """A table of texts.

    Attributes:
        headings: the names of the columns, trimmed.
        rows: the cells of each row, trimmed; as many as there are headings.
        lines: the line of the file on which each row begins.
        unnamed: the columns without a heading, by the names that they were given.
        cell_units: the units behind the numbers in cells, by column.
        doubts: other possible readings of numbers such as `1,234`, by column.
        notes: what was changed in reading.
    """

    path: Path
    dialect: CsvDialect
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    unnamed: frozenset[str] = frozenset()
    cell_units: Mapping[str, Unit] = field(default_factory=dict)
    doubts: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def column(self, heading: str) -> tuple[str, ...]:
        """Return the cells of a column."""
        return self._columns[heading]

    def number(self, cell: str) -> int | float | None:
        """Return the number in a cell of the table, or None."""
        return self._numbers.get(cell)

    def is_numeric(self, heading: str) -> bool:
        """Return whether the column has only numbers and missing values."""
        return heading in self._numeric

    def is_boolean(self, heading: str) -> bool:
        """Return whether the column has only `true` and `false`, in any case."""
        return self._says_only(heading, {"true", "false"})

    def says_yes_or_no(self, heading: str) -> bool:
        """Return whether the column has only words of `ANSWERS`, in any case."""
        return self._says_only(heading, ANSWERS)

    def has_answers(self, heading: str) -> bool:
        """Return whether the column has only truth values, or only yes and no."""
        return self.is_boolean(heading) or self.says_yes_or_no(heading)

    def _says_only(self, heading: str, words: Collection[str]) -> bool:
        return heading in self._distinct and all(cell.casefold() in words for cell in self._distinct[heading])

    def unit(self, heading: str) -> Unit | None:
        """Return the unit behind each number of a column, or in its heading; None without either."""
        return self.cell_units.get(heading) or split_heading(heading)[1]

    # Each distinct text is examined once.

    @cached_property
    def _numbers(self) -> dict[str, int | float | None]:
        return {cell: number_of(cell) for cells in self._distinct.values() for cell in cells}

    @cached_property
    def _columns(self) -> dict[str, tuple[str, ...]]:
        return dict(zip(self.headings, zip(*self.rows, strict=True), strict=True)) if self.rows else {}

    @cached_property
    def _distinct(self) -> dict[str, set[str]]:
        """The distinct values of each column, without missing ones."""
        filled = {
            name: {cell for cell in set(cells) if cell.casefold() not in MISSING}
            for name, cells in self._columns.items()
        }
        return {name: cells for name, cells in filled.items() if cells}

    @cached_property
    def _numeric(self) -> frozenset[str]:
        distinct = self._distinct.items()
        return frozenset(name for name, cells in distinct if all(self.number(cell) is not None for cell in cells))


def read_foreign_table(path: Path, decimal: str | None = None) -> ForeignTable:
    """Read a table: with or without a byte-order mark, with commas, semicolons or tabs, with blank lines anywhere.

    The decimal sign of its numbers is guessed where it is None.

    Raises:
        StorageError: the file cannot be read.
        AnalysisError: the table has no heading, rows that do not fit the heading, or too many rows.
    """
    dialect = dialect_of(path)
    filled: list[tuple[int, list[str]]] = []
    before = 0
    try:
        with path.open(encoding=dialect.encoding, errors="replace", newline="") as file:
            lines = csv.reader(file, delimiter=dialect.delimiter)
            for row in lines:
                if before >= dialect.blank_lines and any(cells := list(map(_trimmed, row))):
                    filled.append((before + 1, cells))
                if len(filled) > _MOST_RUNS:
                    problem = f"the table has more than {_MOST_RUNS:,} rows: are they samples rather than runs?"
                    fix = "Name the table that has a row for each run: --table FILE."
                    raise AnalysisError(problem, where=str(path), fix=fix)
                before = lines.line_num
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except csv.Error as error:
        where = f"{path}:{before + 1}"
        raise AnalysisError(f"the file is not CSV: {error}", where=where, fix="Correct the quotes in it.") from error
    if not filled:
        raise AnalysisError("the table is empty", where=str(path), fix="Name the file that holds the runs.")
    return _table(path, dialect, filled, decimal)


def _trimmed(cell: str) -> str:
    """Return a cell without blanks around it, a number with a hyphen in the place of a document's minus sign."""
    return _MINUS.sub("-", cell.strip())


def dialect_of(path: Path) -> CsvDialect:
    """Return the dialect of a CSV file, from its first lines.

    Raises:
        StorageError: the file cannot be read.
        AnalysisError: the file is not text.
    """
    with storage_errors(path, "read"), path.open("rb") as file:
        head = file.read(_HEAD)
        encoding = _encoding(head, file)
    text = head.decode(encoding, "replace")
    if "\0" in text:
        fix = "Name the CSV file that holds the runs: --table FILE."
        raise AnalysisError("the file is not text: it holds zero bytes", where=str(path), fix=fix)
    lines = text.splitlines()
    blank = next((place for place, line in enumerate(lines) if line.strip(" ,;\t|")), len(lines))
    told = _SEPARATOR.fullmatch(lines[blank]) if blank < len(lines) else None
    if told is not None:
        blank += 1
    heading, *body = lines[blank : blank + _LINES_LOOKED_AT] or [""]
    # The line below tells where the heading does not: it is a title then, which the cells do not fit.
    cells = {
        each: [len(next(csv.reader([line], delimiter=each), [])) for line in (heading, *body[:1])]
        for each in _DELIMITERS
    }
    delimiter = max(_DELIMITERS, key=cells.__getitem__) if told is None else told[1]
    return CsvDialect(encoding, delimiter, delimiter != "," and bool(_DECIMAL_COMMA.search("\n".join(body))), blank)


def _encoding(head: bytes, rest: BinaryIO) -> str:
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:  # the whole file: the only letter that is not ASCII may be in the last row
        while head:
            decoder.decode(head)
            head = rest.read(_HEAD)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _table(
    path: Path, dialect: CsvDialect, filled: Sequence[tuple[int, list[str]]], decimal: str | None
) -> ForeignTable:
    (line, headings), *body = filled
    headings = ["" if _WRITTEN_FOR_NONE.fullmatch(name) else name for name in headings]
    for name, count in Counter(filter(None, headings)).items():
        if count > 1:
            problem = f"heading {name!r} is there twice"
            raise AnalysisError(problem, where=f"{path}:{line}", fix="Name each column, each differently.")
    if body and all(number_of(name) is not None for name in headings):
        problem = f"the first row has only numbers, such as {headings[0]!r}: the table has no heading"
        raise AnalysisError(problem, where=f"{path}:{line}", fix="Write the names of the columns above it.")
    width = len(headings)
    for number, row in body:
        if any(row[width:]):
            problem = f"the row has {len(row)} cells, the heading has {width}"
            title = ", or remove the lines above the heading" if width == 1 else ""
            raise AnalysisError(problem, where=f"{path}:{number}", fix=f"Give it a cell under each heading{title}.")
    columns = list(zip(*((*row[:width], *[""] * (width - len(row))) for _, row in body), strict=True))
    # A spreadsheet leaves an empty column where one was deleted.
    kept = [place for place, name in enumerate(headings) if name or (columns and any(columns[place]))]
    if len(kept) > 1 and not any(headings[place] for place in kept[1:]):
        problem = f"of {len(kept)} columns with values only the first has a heading, {headings[kept[0]]!r}"
        fix = "Remove the lines above the heading, or name each column."
        raise AnalysisError(problem, where=f"{path}:{line}", fix=fix)
    notes = []
    if kept and not headings[kept[0]] and columns and _numbers_rows(columns[kept[0]]):
        notes.append("the first column has no heading and numbers the rows: left out")
        kept = kept[1:]
    named = {place: headings[place] or free_heading(f"column_{place + 1}", headings) for place in kept}
    unnamed = [name for place, name in named.items() if not headings[place]]
    if unnamed:
        many = f"{len(unnamed)} columns have" if len(unnamed) > 1 else "a column has"
        notes.append(f"{many} no heading ({', '.join(unnamed)} here): values may stand under headings of others")
    commas = dialect.decimal_comma
    cells = {name: columns[place] for place, name in named.items()} if columns else {}
    plain = {name: plain_cells(each, decimal=decimal, has_decimal_commas=commas) for name, each in cells.items()}
    if not commas and (any(each.has_decimal_commas for each in plain.values()) or _may_group(dialect, plain)):
        # One column helps to read the others: if it has `870,5`, a `1.000` in another may be a thousand.
        plain = {name: plain_cells(each, decimal=decimal, has_decimal_commas=True) for name, each in cells.items()}
    notes += [f"{name} is written with {each.words}" for name, each in plain.items() if each.words and not commas]
    return ForeignTable(
        path,
        dialect,
        tuple(named.values()),
        tuple(zip(*(each.cells for each in plain.values()), strict=True)),
        tuple(number for number, _ in body),
        frozenset(unnamed),
        {name: each.unit for name, each in plain.items() if each.unit},
        {name: each.doubt for name, each in plain.items() if each.doubt},
        tuple(notes),
    )


def _may_group(dialect: CsvDialect, plain: Mapping[str, PlainCells]) -> bool:
    """Return whether all points in numbers may be between thousands, as where decimal commas call for semicolons."""
    pointed = (cell for each in plain.values() for cell in each.cells if "." in cell and number_of(cell) is not None)
    return dialect.delimiter == ";" and all(_GROUPED.fullmatch(cell) for cell in pointed)


def _numbers_rows(cells: Sequence[str]) -> bool:
    """Return whether cells are the numbers of a data frame's rows, from 0 in pandas, from 1 in R."""
    return any(all(map(str.__eq__, cells, map(str, range(first, first + len(cells))))) for first in (0, 1))


def free_heading(heading: str, taken: Collection[str]) -> str:
    """Return a heading, with underscores at its end if it is taken."""
    while heading in taken:
        heading += "_"
    return heading


# A run table that Robot Runner wrote, without its schema and journal.

#: The headings of runs and their status, in tables of ours and in those that go on from an earlier tool's.
_RUNS = ((RUN_ID, STATUS), ("__run_id", "__done"))
_WARMED_UP = "warm-up"
_NOT_SO = MISSING | {"false"}
_BATCHES = f"runs of several batches are compared as one: what changed between them may pass for an effect ({BATCH})"


def without_unanalysed(table: ForeignTable, named: Collection[str | None]) -> ForeignTable:
    """Return a table without the warm-up and the excluded runs of Robot Runner; notes tell which, and why.

    The columns that tell of them are left out as well, and so are the batch and those of events that no run had.
    Another table is returned as it is, and so are columns that the user has `named`, and the runs of which these tell.

    Example:
        >>> without_unanalysed(table, ()).notes  # doctest: +SKIP
        ('2 runs left out that Robot Runner does not analyse: w_1 (warm-up), r_2 (the robot fell)',)
    """
    ids = next((name for name, status in _RUNS if {name, status} <= {*table.headings}), None)
    if ids is None or not table.rows:
        return table
    runs, notes = table.column(ids), list(table.notes)
    why = dict.fromkeys(runs, "")
    headings = [name for name in table.headings if name not in named]
    told_by = [name for name in (WARM_UP, EXCLUDED) if name in headings and table.is_boolean(name) == (name == WARM_UP)]
    for name in told_by:
        for run, cell in zip(runs, table.column(name), strict=True):
            if cell.casefold() not in _NOT_SO:
                why[run] = why[run] or (_WARMED_UP if name == WARM_UP else cell)
    left_out = [f"{run} ({reason})" for run, reason in why.items() if reason]
    if left_out:
        notes.append(f"{counted(len(left_out), 'run')} left out that Robot Runner does not analyse: {listed(left_out)}")
    batch = [BATCH] if BATCH in headings else []
    notes += [_BATCHES] * len(batch)
    empty = [name for name in STAMP_COLUMNS if name in headings and not any(table.column(name))]
    has_column = [name not in (*empty, *told_by, *batch) for name in table.headings]
    is_kept = [not why[run] for run in runs]
    rows = tuple(tuple(compress(row, has_column)) for row in compress(table.rows, is_kept))
    kept, lines = tuple(compress(table.headings, has_column)), tuple(compress(table.lines, is_kept))
    return replace(table, headings=kept, rows=rows, lines=lines, notes=tuple(notes))
