"""Reading `run_table.csv`: written by us, edited in a spreadsheet, or made by hand from the start."""

from __future__ import annotations

import csv
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Protocol

from robot_runner.design.columns import REPETITION, RUN_ID, STATUS
from robot_runner.errors import StorageError
from robot_runner.storage.run_table_rows import RunTableRows
from robot_runner.storage.safe_write import storage_error
from robot_runner.storage.table_decoders import (
    FactorDecoder,
    MeasureDecoder,
    RepetitionDecoder,
    RowChunk,
    RunIdDecoder,
    StatusDecoder,
    TextDecoder,
)
from robot_runner.storage.table_findings import TableFindings
from robot_runner.storage.table_headings import delimiter_of, match_headings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import TextIO

    from robot_runner.storage.table_decoders import CellDecoder
    from robot_runner.storage.table_headings import Headings
    from robot_runner.storage.table_layout import TableLayout

__all__ = ["read_run_table"]

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
