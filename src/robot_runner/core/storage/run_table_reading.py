"""Reading `run_table.csv`: written by us, edited in a spreadsheet, or made by hand from the start."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice, repeat
from operator import is_
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TextIO

from robot_runner.core.design.columns import BATCH, EXCLUDED, REPETITION, RUN_ID, STATUS, WARM_UP, numbered_run_id
from robot_runner.core.design.factor import Combination, factor_places
from robot_runner.core.design.planned_runs import PlannedRun, garbage_collection_paused
from robot_runner.core.errors import StorageError, nearest
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.guarded_files import MissingFileError, open_to_read
from robot_runner.core.storage.run_table_rows import RunRow, RunTableRows
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.storage.table_columns import MARKS, TableLayout, headings_in_r
from robot_runner.core.storage.table_decoders import (
    CellDecoder,
    FactorDecoder,
    MarkDecoder,
    MeasureDecoder,
    RepetitionDecoder,
    RowChunk,
    RunIdDecoder,
    StatusDecoder,
    TableFindings,
    TextDecoder,
)
from robot_runner.core.storage.table_schema import lost, read_schema

if TYPE_CHECKING:
    from _csv import Reader as CsvReader

    from robot_runner.core.storage.layout import ExperimentFolder


# The first line of a run table's file: the headings, in any order.

_DELIMITERS = (",", ";", "\t")
_HEADINGS_ENOUGH = 1 << 16  # characters from which the delimiter is found; below the `csv` module's limit for a cell

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
        places: the index of each column that the file has, by its name in the layout.
        extras: a user's own columns, in the order of the file; they are in `places`, too.
        width: how many cells a row has.
        cells: the headings as they stand in the file.
    """

    places: Mapping[str, int]
    extras: tuple[str, ...]
    width: int
    cells: Sequence[str]


def delimiter_of(first_line: str, layout: TableLayout) -> str:
    """Return the delimiter by which most of the layout's headings are found."""
    known = {layout.spelling.heading(name).casefold() for name in layout.columns} | set(_PROGRESS)

    def recognised(delimiter: str) -> int:
        cells = next(csv.reader([first_line[:_HEADINGS_ENOUGH]], delimiter=delimiter), [])
        return sum(cell.strip().casefold() in known for cell in cells)

    return max(_DELIMITERS, key=recognised)


def match_headings(cells: Sequence[str], layout: TableLayout, findings: TableFindings, *, line: int) -> Headings:
    """Match the first line of a file with the columns of a layout."""
    trimmed = [cell.strip() for cell in cells]
    while trimmed and not trimmed[-1]:
        trimmed.pop()  # a spreadsheet leaves empty headings of deleted columns
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
    for name in (column.name for column in layout.factors if not column.has_default):
        if name not in places:
            near = nearest(name, extras)
            fix = f"Rename {near!r}." if near else f"Add a column {name!r}."
            findings.error(f"the column of factor {name!r} is missing", fix, line=line)
    return Headings(places, extras, len(names), cells)


def _names(trimmed: Sequence[str], layout: TableLayout) -> list[str]:
    """Return the column of each heading; names of factors and measures must match exactly, or be spelt by R."""
    named = [layout.spelling.name(heading) for heading in trimmed]
    in_r = dict(zip(headings_in_r(layout.headings), layout.columns, strict=True))
    named = [name if name in layout.columns or in_r.get(name) in named else in_r.get(name, name) for name in named]
    # A user's column `id` beside a `__run_id` is not the run id.
    taken = {*named, *(_PROGRESS[name] for name in named if name in _EARLIER)}
    names = []
    for name in named:
        meant = _PROGRESS.get(" ".join(name.casefold().split()), name)
        is_meant = name in _EARLIER or meant not in taken
        names.append(meant if is_meant and name not in layout.columns else name)
    return names


_ROWS_AT_ONCE = 500  # they fit into a processor's cache; ten times as many take twice as long
_NO_DEFAULTS: Mapping[str, Any] = MappingProxyType({})
#: The largest file that is read, bytes: more than a million runs, within a gigabyte of memory.
LARGEST = 300_000_000
_LONGEST_CELL = 1 << 27  # the limit of the `csv` module, 128 KiB, is less than what we write


def read_run_table(path: Path, layout: TableLayout, planned: Sequence[PlannedRun] = ()) -> RunTableRows:
    """Read a run table.

    Columns may be in any order, under the layout's headings (or `ID` and `Status`, as in the paper's Fig. 3), separated
    by commas, semicolons or tabs. Missing columns get defaults: runs are numbered, to do, and without time stamps and
    measures. Columns that the layout does not have are kept as `extras`. Rows that are as `planned`, from which the
    table may have been made, refer to that. Oddities are `warnings` of the rows.

    Raises:
        StorageError: it cannot be read, or is not a run table of this layout; `findings` lists all problems.
    """
    with _opened(path) as file:
        return run_table_in(file, path, layout, planned)


def read_described_table(folder: ExperimentFolder) -> RunTableRows:
    """Read the run table of an experiment, with the columns that its schema describes.

    Raises:
        StorageError: one of the two cannot be read.
    """
    return read_run_table(folder.run_table, TableLayout.of_schema(read_schema(folder.schema)))


def run_table_in(file: TextIO, path: Path, layout: TableLayout, planned: Sequence[PlannedRun] = ()) -> RunTableRows:
    """Read a run table from its text, as `read_run_table` does from the file at `path`."""
    csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))
    with garbage_collection_paused():
        starts = iter(partial(file.readline, _HEADINGS_ENOUGH), "")
        first = next((start for start in starts if start.strip()), "")
        if re.fullmatch(r'"?sep=.?"?[,;\t]*', first.strip(), re.IGNORECASE):
            problem = f"the line {first.strip()!r} above the headings is for Excel alone"
            raise StorageError(
                problem, where=str(path), fix="Delete this line: other programs read it as the headings."
            )
        delimiter = delimiter_of(first, layout)
        file.seek(0)
        return _Reading(layout, TableFindings(path), planned, decimal_comma=delimiter == ";").read(file, delimiter)


class _Reading:
    """One file being read: a decoder for each column that the layout can have."""

    def __init__(
        self, layout: TableLayout, findings: TableFindings, planned: Sequence[PlannedRun], *, decimal_comma: bool
    ) -> None:
        self._layout = layout
        self._planned = planned
        self._places = factor_places(layout.factor_names)
        self._findings = findings
        self._nameless: set[int] = set()
        self._run_ids = RunIdDecoder(findings)
        self._repetitions = RepetitionDecoder(findings, least=0 if WARM_UP in layout.marks else 1)
        self._factors = [
            FactorDecoder(
                each,
                layout.types.get(each.name),
                findings,
                decimal_comma=decimal_comma,
                empty_is_none=bool(planned) or layout.spelling.blank_is_missing,
            )
            for each in layout.factors
        ]
        blank_is_missing = layout.spelling.blank_is_missing
        self._decoders: dict[str, CellDecoder] = {
            RUN_ID: self._run_ids,
            STATUS: StatusDecoder(findings),
            **{name: TextDecoder(name, findings, is_stamp=False) for name in layout.exclusion},
            **({REPETITION: self._repetitions} if layout.has_repetition else {}),
            **{name: MarkDecoder(MARKS[name], findings) for name in layout.marks},
            **{name: TextDecoder(name, findings, is_stamp=True) for name in layout.stamps},
            **dict(zip(layout.factor_names, self._factors, strict=True)),
            **{
                name: MeasureDecoder(
                    name,
                    layout.types.get(name),
                    findings,
                    decimal_comma=decimal_comma,
                    blank_is_missing=blank_is_missing,
                )
                for name in layout.measures
            },
        }
        self._extras: tuple[str, ...] = ()

    def read(self, file: TextIO, delimiter: str) -> RunTableRows:
        """Read the whole file; return its rows, or raise with all problems."""
        lines = csv.reader(file, delimiter=delimiter, strict=True)
        rows: list[RunRow] = []
        first_cells: Sequence[str] = ()
        count = 0
        for headings, chunk in self._chunks(lines):
            if chunk.rows:
                rows += self._rows(headings, chunk, first=count + 1)
                count += len(chunk.rows)
            first_cells = first_cells or headings.cells
        self._run_ids.check()
        if not count:
            fix = "Add a line for each run, or delete the file: it is planned again then."
            self._findings.error("the run table has no runs", fix)
        self._findings.raise_errors()
        layout = replace(self._layout, extras=self._extras)
        has_file = delimiter == "," and list(first_cells) == layout.headings
        return RunTableRows(layout, rows, self._findings.warnings, has_file=has_file)

    def _rows(self, headings: Headings, chunk: RowChunk, *, first: int) -> Iterable[RunRow]:
        """Return the rows of a chunk; `first` is the number of its first run."""
        self._extras = headings.extras
        for name in headings.extras:
            self._decoders.setdefault(name, TextDecoder(name, self._findings, is_stamp=False))
        cells = list(zip(*chunk.rows, strict=True))
        count = len(chunk.rows)
        # In the order of the file, so that findings are, too.
        found = {name: self._decoders[name].read(cells[place], chunk) for name, place in headings.places.items()}

        def combined(names: Sequence[str], defaults: Mapping[str, Any] = _NO_DEFAULTS) -> list[tuple[Any, ...]]:
            columns = [found.get(name) or [defaults.get(name)] * count for name in names]
            return list(zip(*columns, strict=True)) if columns else [()] * count

        numbers = range(first, first + count)
        defaults = {column.name: column.default for column in self._layout.factors if column.has_default}
        treatments = combined(self._layout.factor_names, defaults)
        run_ids = found.get(RUN_ID) or list(map(numbered_run_id, numbers))
        repetitions: Sequence[int] = [1] * count
        if self._layout.has_repetition:  # else a column of that name is a factor, or a user's
            repetitions = found.get(REPETITION) or self._repetitions.counted(treatments)
        marks = {name: found[name] for name in self._layout.marks if name in found}
        batches = marks.get(BATCH) or [1] * count
        if WARM_UP in marks:
            pairs = zip(repetitions, marks[WARM_UP], strict=True)
            repetitions = [0 if is_warm_up else max(1, number) for number, is_warm_up in pairs]
        planned = self._planned[first - 1 : first - 1 + count]
        runs: Iterable[PlannedRun] = planned
        if not _are_as_planned(planned, run_ids, treatments, zip(repetitions, batches, strict=True)):
            combinations = map(Combination, repeat(self._places), treatments)
            runs = map(PlannedRun, run_ids, numbers, combinations, repetitions, repeat(None), batches)
        return map(
            RunRow,
            runs,
            found.get(STATUS) or repeat(RunStatus.TODO),
            _sharing_empty(combined(self._layout.stamps)),
            _sharing_empty(combined(self._layout.measures)),
            self._kept(headings, cells, count),
            found.get(EXCLUDED) or repeat(None),
        )

    def _kept(
        self, headings: Headings, cells: Sequence[Sequence[str]], count: int
    ) -> Iterable[Mapping[str, str] | None]:
        """Return the texts that each row keeps: a user's columns, and treatments that would be written differently."""
        odd = [factor for factor in self._factors if factor.kept]
        if not headings.extras and not odd:
            return repeat(None, count)
        texts: list[dict[str, str]] = [{} for _ in range(count)]
        for name in headings.extras:
            for row, text in zip(texts, cells[headings.places[name]], strict=True):
                if text:
                    row[name] = text
        for factor in odd:
            for row, text in zip(texts, cells[headings.places[factor.name]], strict=True):
                if text in factor.kept:
                    row[factor.name] = text
        return [row or None for row in texts]

    def _chunks(self, lines: CsvReader) -> Iterator[tuple[Headings, RowChunk]]:
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
                yield headings, self._fitting(chunk, headings)
            if is_broken or not rows:
                return

    def _take(self, lines: CsvReader, rows: list[list[str]], first_line: int, *, most: int) -> bool:
        """Take some rows; return whether the file breaks off in a row that is not CSV."""
        try:
            rows.extend(islice(lines, most))  # rows before an error are kept
        except csv.Error as error:
            line = RowChunk(rows, first_line).lines[-1]
            fix = "Put the cell between double quotes, and double those inside it."
            self._findings.error(f"a cell is not quoted rightly from here on ({error})", fix, line=line)
            return True
        return False

    def _fitting(self, chunk: RowChunk, headings: Headings) -> RowChunk:
        """Return the rows that have a cell for each heading; others are errors, as shifting cells would be a guess."""
        width, written = headings.width, len(headings.cells)
        if {*map(len, chunk.rows)} <= {width}:
            return chunk
        fitting = []
        for place, row in enumerate(chunk.rows):
            if width < len(row) <= written:  # an earlier tool wrote values that no column had been declared for
                nameless = {column for column, cell in enumerate(row[width:], width) if cell}
                for column in sorted(nameless - self._nameless):  # each is told once
                    problem = f"column {column + 1} has the value {row[column]!r}, and its heading is empty"
                    self._findings.error(problem, "Write a name for it into the first line.", line=chunk.lines[place])
                self._nameless |= nameless
                del row[width:]
            elif not any(row[width:]):
                del row[width:]
            if len(row) == width:
                fitting.append(place)
            else:
                problem = f"the row has {len(row)} cells, the heading has {written if len(row) > width else width}"
                fix = "Give it a cell under each heading; an empty one where there is no value."
                self._findings.error(problem, fix, line=chunk.lines[place])
        return chunk.only(fitting)


def _are_as_planned(
    runs: Sequence[PlannedRun],
    run_ids: Sequence[str],
    treatments: Sequence[tuple[Any, ...]],
    marks: Iterable[tuple[int, int]],
) -> bool:
    """Return whether runs are as they were planned; `marks` are repetition and batch."""
    if [run.run_id for run in runs] != list(run_ids):
        return False
    if [(run.repetition, run.batch) for run in runs] != list(marks):
        return False
    # By identity, as rows hold the factors' own objects, which need not be comparable.
    planned = chain.from_iterable(run.combination.treatments for run in runs)
    return all(map(is_, planned, chain.from_iterable(treatments)))


def _sharing_empty(rows: list[tuple[Any, ...]]) -> Iterable[tuple[Any, ...]]:
    """Return the rows; those without values share one object, to save memory."""
    nothing = (None,) * len(rows[0])
    return [nothing if row == nothing else row for row in rows]


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    try:
        with io.TextIOWrapper(open_to_read(path, limit=LARGEST), encoding="utf-8-sig", newline="") as file:
            yield file
    except MissingFileError as error:
        raise lost(path) from error
    except UnicodeDecodeError as error:
        fix = "Save it as CSV with the character set UTF-8."
        raise StorageError(f"the file is not UTF-8: {error}", where=str(path), fix=fix) from error
    except OSError as error:
        raise storage_error(path, "read", error) from error
