"""Reading `run_table.csv`: written by us, edited in a spreadsheet, or made by hand from the start."""

from __future__ import annotations

import csv
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Protocol

from robot_runner.core.design.columns import REPETITION, RUN_ID, STATUS
from robot_runner.core.errors import Finding, Severity, StorageError, nearest
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.core.storage.table_decoders import (
    FactorDecoder,
    MeasureDecoder,
    RepetitionDecoder,
    RowChunk,
    RunIdDecoder,
    StatusDecoder,
    TextDecoder,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import TextIO

    from robot_runner.core.storage.table_columns import TableLayout
    from robot_runner.core.storage.table_decoders import CellDecoder

__all__ = ["Headings", "TableFindings", "delimiter_of", "match_headings", "read_run_table"]


# What is wrong with a run table's file: every problem, with its line and column, up to a sensible number.

#: Whoever saved a table wrongly gets one problem in each row: nobody reads a million.
_MOST = 50


class TableFindings:
    """Gathers what is wrong with one file. A fix that takes long to find is asked for only where it is listed.

    Example:
        >>> from pathlib import Path
        >>> findings = TableFindings(Path("run_table.csv"))
        >>> findings.warning("'vidoe' is no treatment", "Did you mean 'Video'?", line=4, column="Task")
        >>> print(*findings.warnings)
        run_table.csv, line 4, column 'Task': 'vidoe' is no treatment → Did you mean 'Video'?
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[Severity, list[Finding]] = {severity: [] for severity in Severity}
        self._unlisted = dict.fromkeys(Severity, 0)

    def error(
        self, problem: str, fix: str | Callable[[], str], *, line: int | None = None, column: str | None = None
    ) -> None:
        """Note what keeps the table from being used."""
        self._note(Severity.ERROR, problem, fix, line, column)

    def warning(
        self, problem: str, fix: str | Callable[[], str], *, line: int | None = None, column: str | None = None
    ) -> None:
        """Note what looks odd."""
        self._note(Severity.WARNING, problem, fix, line, column)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What looks odd, and how much more of it there is than is listed."""
        return self._listed(Severity.WARNING)

    def raise_errors(self) -> None:
        """Refuse the table if anything keeps it from being used.

        Raises:
            StorageError: it carries every error and every warning.
        """
        if self._found[Severity.ERROR]:
            raise StorageError.of_findings((*self._listed(Severity.ERROR), *self.warnings))

    def _note(
        self, severity: Severity, problem: str, fix: str | Callable[[], str], line: int | None, column: str | None
    ) -> None:
        if len(self._found[severity]) >= _MOST:
            self._unlisted[severity] += 1
            return
        where = str(self._path)
        if line is not None:
            where += f", line {line}"
        if column is not None:
            where += f", column {column!r}"
        self._found[severity].append(Finding(severity, where, problem, fix if isinstance(fix, str) else fix()))

    def _listed(self, severity: Severity) -> tuple[Finding, ...]:
        found = tuple(self._found[severity])
        if not self._unlisted[severity]:
            return found
        rest = Finding(severity, str(self._path), f"there are {self._unlisted[severity]:,} more of them", "")
        return (*found, rest)


# The first line of a run table's file: which heading belongs to which column, in any order.

_DELIMITERS = (",", ";", "\t")

# As in the paper's Fig. 3, as people write them, and as the earlier tools did.
_PROGRESS = {
    "run_id": RUN_ID,
    "run id": RUN_ID,
    "id": RUN_ID,
    "__run_id": RUN_ID,
    "status": STATUS,
    "__done": STATUS,
}
_EARLIER = frozenset({"__run_id", "__done"})


@dataclass(frozen=True, slots=True)
class Headings:
    """Where the columns of a layout stand in a file.

    Attributes:
        places: the place of each column that is there, counted from 0, by its name in the layout.
        extras: the columns that are a user's own, in the order of the file; they are in `places` as well.
        width: how many cells a row has.
    """

    places: Mapping[str, int]
    extras: tuple[str, ...]
    width: int


def delimiter_of(first_line: str, layout: TableLayout) -> str:
    """Return what stands between the cells: the delimiter that makes most of the layout's headings appear."""
    known = {layout.spelling.heading(name).casefold() for name in layout.columns} | set(_PROGRESS)

    def recognised(delimiter: str) -> int:
        cells = next(csv.reader([first_line], delimiter=delimiter), [])
        return sum(cell.strip().casefold() in known for cell in cells)

    return max(_DELIMITERS, key=recognised)


def match_headings(cells: Sequence[str], layout: TableLayout, findings: TableFindings, *, line: int) -> Headings:
    """Match the first line of a file with the columns of a layout.

    Args:
        cells: the first line that is not blank.
        layout: the columns that the table is to have.
        findings: takes headings that are missing, empty, or there twice.
        line: the number of the line.
    """
    trimmed = [cell.strip() for cell in cells]
    while trimmed and not trimmed[-1]:
        trimmed.pop()  # what a spreadsheet leaves behind a deleted column
    names = _names(trimmed, layout)
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        if not name:
            findings.error(f"heading {place + 1} is empty", "Name the column, or delete it.", line=line)
        elif name in places:
            findings.error(f"heading {name!r} is there twice", "Rename or delete one.", line=line, column=name)
        else:
            places[name] = place
    extras = tuple(name for name in places if name not in layout.columns or name in layout.extras)
    for name in layout.factor_names:
        if name not in places:
            near = nearest(name, extras)
            fix = f"Rename {near!r}." if near else f"Add a column {name!r}."
            findings.error(f"the column of factor {name!r} is missing", fix, line=line)
    return Headings(places, extras, len(names))


def _names(trimmed: Sequence[str], layout: TableLayout) -> list[str]:
    """Return the column that each heading means; factors and measures are taken as they are written."""
    named = [layout.spelling.name(heading) for heading in trimmed]
    # A user's own column `id` beside a `__run_id` is a column of its own.
    taken = {*named, *(_PROGRESS[name] for name in named if name in _EARLIER)}
    names = []
    for name in named:
        meant = _PROGRESS.get(" ".join(name.casefold().split()), name)
        is_meant = name in _EARLIER or meant not in taken
        names.append(meant if is_meant and name not in layout.columns else name)
    return names


_ROWS_AT_ONCE = 500  # what fits into a processor's cache; ten times as many take twice as long
_LONGEST_CELL = 1 << 27  # the module's own limit of 128 KiB is less than what we write


def read_run_table(path: Path, layout: TableLayout) -> RunTableRows:
    """Read a run table.

    Columns may stand in any order, under the layout's headings (or `ID` and `Status`, as in the paper's Fig. 3), with
    commas, semicolons or tabs between the cells. What is not there is filled in: runs are numbered, to do, and without
    time stamps and measures. Columns that the layout does not have are kept as `extras`.

    Args:
        path: the file.
        layout: the columns that the table is to have, and what their cells are read as.

    Returns:
        The rows; their `warnings` tell what looked odd.

    Raises:
        StorageError: it cannot be read, or is no run table of this layout; `findings` lists everything that is wrong.
    """
    findings = TableFindings(path)
    with _opened(path) as file:
        delimiter = delimiter_of(next((line for line in file if line.strip()), ""), layout)
        file.seek(0)
        return _Reading(layout, findings, decimal_comma=delimiter == ";").read(file, delimiter)


class _Lines(Protocol):
    """What `csv.reader` returns; its type has no name."""

    line_num: int

    def __iter__(self) -> Iterator[list[str]]: ...

    def __next__(self) -> list[str]: ...


class _Reading:
    """One file being read: a decoder for each column that the layout can have."""

    def __init__(self, layout: TableLayout, findings: TableFindings, *, decimal_comma: bool) -> None:
        types = layout.types
        self._layout = layout
        self._findings = findings
        self._run_ids = RunIdDecoder(findings)
        self._statuses = StatusDecoder(findings)
        self._repetitions = RepetitionDecoder(findings)
        self._factors = {
            each.name: FactorDecoder(each, types.get(each.name), findings, decimal_comma=decimal_comma)
            for each in layout.factors
        }
        self._measures = {
            name: MeasureDecoder(
                name,
                types.get(name),
                findings,
                decimal_comma=decimal_comma,
                blank_is_missing=layout.spelling.blank_is_missing,
            )
            for name in layout.measures
        }
        self._stamps = {name: TextDecoder(name, findings, is_stamp=True) for name in layout.stamps}
        self._extras: dict[str, TextDecoder] = {}

    def read(self, file: TextIO, delimiter: str) -> RunTableRows:
        """Read the whole file, then refuse it with everything that is wrong, or return its rows."""
        lines = csv.reader(file, delimiter=delimiter, strict=True)
        count = 0
        for headings, chunk in self._chunks(lines):
            decoders = self._decoders(headings)
            cells = list(zip(*chunk.rows, strict=True))
            for name, place in headings.places.items() if cells else ():
                decoders[name].take(cells[place], chunk)
            count += len(chunk.rows)
        self._run_ids.check()
        if not count:
            fix = "Add a line for each run, or delete the file: it is planned anew then."
            self._findings.error("there are no runs in it", fix)
        self._findings.raise_errors()
        return self._rows(count)

    def _chunks(self, lines: _Lines) -> Iterator[tuple[Headings, RowChunk]]:
        headings: Headings | None = None
        while True:
            first_line = lines.line_num + 1
            rows: list[list[str]] = []
            is_broken = self._take(lines, rows, first_line, most=1 if headings is None else _ROWS_AT_ONCE)
            chunk = RowChunk(rows, first_line).without_blank_rows()
            if headings is None and chunk.rows:
                headings = match_headings(chunk.rows[0], self._layout, self._findings, line=chunk.lines[0])
                chunk = chunk.only(range(1, len(chunk.rows)))
            if headings is not None:
                yield headings, self._fitting(chunk, headings.width)
            if is_broken or not rows:
                return

    def _take(self, lines: _Lines, rows: list[list[str]], first_line: int, *, most: int) -> bool:
        """Take some rows; return whether the file breaks off in a row that is no CSV."""
        try:
            rows.extend(islice(lines, most))  # what comes before an error is kept
        except csv.Error as error:
            line = RowChunk(rows, first_line).lines[-1]
            fix = "Put the cell between double quotes, and double those inside it."
            self._findings.error(f"a cell is not quoted rightly from here on ({error})", fix, line=line)
            return True
        return False

    def _fitting(self, chunk: RowChunk, width: int) -> RowChunk:
        """Return the rows that have a cell for each heading. None is ever shifted to fit."""
        if {*map(len, chunk.rows)} <= {width}:
            return chunk
        fitting = []
        for place, row in enumerate(chunk.rows):
            if not any(row[width:]):
                del row[width:]
            if len(row) == width:
                fitting.append(place)
            else:
                problem = f"the row has {len(row)} cells, the heading has {width}"
                fix = "Give it a cell under each heading; an empty one where there is no value."
                self._findings.error(problem, fix, line=chunk.lines[place])
        return chunk.only(fitting)

    def _decoders(self, headings: Headings) -> Mapping[str, CellDecoder]:
        for name in headings.extras:
            self._extras.setdefault(name, TextDecoder(name, self._findings, is_stamp=False))
        return {
            RUN_ID: self._run_ids,
            STATUS: self._statuses,
            **({REPETITION: self._repetitions} if self._layout.has_repetition else {}),
            **self._stamps,
            **self._factors,
            **self._measures,
            **self._extras,
        }

    def _rows(self, count: int) -> RunTableRows:
        factors = [factor.column() for factor in self._factors.values()]
        if self._layout.has_repetition:
            factors.append(self._repetitions.column(list(self._factors.values())))
        texts = self._stamps | self._extras
        return RunTableRows(
            replace(self._layout, extras=tuple(self._extras)),
            self._run_ids.column(count),
            self._statuses.column(count),
            factors,
            texts={name: decoder.texts for name, decoder in texts.items()},
            measures={name: decoder.values for name, decoder in self._measures.items()},
            warnings=self._findings.warnings,
        )


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            yield file
    except UnicodeDecodeError as error:
        fix = "Save it as CSV with the character set UTF-8."
        raise StorageError(f"it is not UTF-8: {error}", where=str(path), fix=fix) from error
    except OSError as error:
        raise storage_error(path, "read", error) from error
