"""Decoding the cells of a run table's file: one decoder for each kind of column, and their findings."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from itertools import accumulate
from pathlib import Path
from typing import Any, Protocol

from robot_runner.core.design.columns import REPETITION, RUN_ID, RUN_IDS, STATUS, numbered_run_id
from robot_runner.core.errors import Finding, Severity, StorageError, did_you_mean
from robot_runner.core.storage.cells import (
    CellValue,
    RunStatus,
    are_stamps,
    as_stamp,
    number_of,
    status_of_word,
    treatment_position,
    typed_value,
    typed_values,
)
from robot_runner.core.storage.table_columns import ColumnDescription, FactorColumn

# The problems of a run table's file, each with its line and column.

#: Further problems are counted, not listed: a table that was saved wrongly has one in each row.
_MOST = 50


class TableFindings:
    """Gathers the problems of one file. A fix that is a function is called only if the problem is listed.

    Example:
        >>> from pathlib import Path
        >>> findings = TableFindings(Path("run_table.csv"))
        >>> findings.warning("'vidoe' is not a treatment", "Did you mean 'Video'?", line=4, column="Task")
        >>> print(*findings.warnings)
        run_table.csv, line 4, column 'Task': 'vidoe' is not a treatment → Did you mean 'Video'?
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[Severity, list[Finding]] = {severity: [] for severity in Severity}
        self._unlisted = dict.fromkeys(Severity, 0)

    def error(
        self, problem: str, fix: str | Callable[[], str], *, line: int | None = None, column: str | None = None
    ) -> None:
        """Add an error, which keeps the table from being used."""
        self._note(Severity.ERROR, problem, fix, line, column)

    def warning(self, problem: str, fix: str | Callable[[], str], *, line: int, column: str) -> None:
        """Add a warning."""
        self._note(Severity.WARNING, problem, fix, line, column)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """The warnings, and how many more there are than are listed."""
        return self._listed(Severity.WARNING)

    def raise_errors(self) -> None:
        """Raise a `StorageError` with all errors and warnings, if there is an error."""
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


_LINE_END = re.compile(r"\r\n|\r|\n")
_MOST_REPETITIONS = 1 << 32  # a larger number is a mistake
# Types that fit a column, too: integers among floats; `any`, as the schema may be older than the table after a kill.
_TYPES = {"number": (int, float), "integer": (int, float), "boolean": (bool,)}
#: As R, pandas and numpy write a missing value: among numbers, truth values and time stamps nothing else is meant.
MISSING = frozenset({"NA", "NaN", "nan"})
#: What the cells of a column hold, by its type in the schema.
TYPE_WORDS = {"number": "a number", "integer": "an integer", "boolean": "a boolean"}


def is_unfit(value: CellValue, kind: str | None) -> bool:
    """Return whether a value is of another type than those of a column; a missing one fits everywhere."""
    return value is not None and kind in _TYPES and type(value) not in _TYPES[kind]


class RowChunk:
    """Some rows of a file, with the lines on which they begin (computed only for findings)."""

    def __init__(self, rows: list[list[str]], first_line: int) -> None:
        self.rows = rows
        self._first_line = first_line

    @cached_property
    def lines(self) -> list[int]:
        """The line on which each row begins, counted from 1, and the line after the last."""
        heights = (1 + sum(len(_LINE_END.findall(cell)) for cell in row) for row in self.rows)
        return list(accumulate(heights, initial=self._first_line))

    def without_blank_rows(self) -> RowChunk:
        """Return the rows that have a cell with content."""
        if all(map(any, self.rows)):
            return self
        return self.only([place for place, row in enumerate(self.rows) if any(row)])

    def only(self, places: Sequence[int]) -> RowChunk:
        """Return the rows at these places, on the same lines."""
        chunk = RowChunk([self.rows[place] for place in places], self._first_line)
        chunk.lines = [*(self.lines[place] for place in places), self.lines[-1]]
        return chunk


class CellDecoder(Protocol):
    """Decodes the cells of one column in chunks, which is ten times faster than one by one."""

    def read(self, cells: Sequence[str], chunk: RowChunk) -> Sequence[Any]:
        """Return the value of each of the column's cells in the rows of `chunk`."""


class RunIdDecoder:
    """The runs' ids: unique, and valid as names of folders."""

    def __init__(self, findings: TableFindings) -> None:
        self._findings = findings
        self._count = 0
        self._is_numbered = True
        self._seen: set[str] = set()  # casefolded, as some file systems ignore case
        self._empty: list[int] = []

    def read(self, cells: Sequence[str], chunk: RowChunk) -> list[str]:
        """Return ids; those of a planned table (`r_1`, `r_2`, ...) need no check.

        Runs without an id are numbered, which is right if none has one; else `check` refuses them.
        """
        before, self._count = self._count, self._count + len(cells)
        numbered = list(map(numbered_run_id, range(before + 1, self._count + 1)))
        if self._is_numbered and list(cells) == numbered:
            return numbered
        if self._is_numbered:
            self._is_numbered = False
            self._seen.update(map(numbered_run_id, range(1, before + 1)))
        for place, cell in enumerate(cells):
            self._check_one(cell.strip(), chunk, place)
        return [cell.strip() or number for cell, number in zip(cells, numbered, strict=True)]

    def check(self) -> None:
        """Add an error for each run without an id, where others have one."""
        for line in self._empty if self._seen else ():
            fix = "Give it an id, or leave the whole column empty: runs are numbered then."
            self._findings.error("the run has no id", fix, line=line, column=RUN_ID)

    def _check_one(self, run_id: str, chunk: RowChunk, place: int) -> None:
        folded = run_id.casefold()
        if not run_id:
            self._empty.append(chunk.lines[place])
        elif not RUN_IDS.fullmatch(run_id):
            fix = "Use letters, digits, '_', '-' and '.' (60 at most)."
            self._findings.error(f"{run_id!r} cannot name a run's folder", fix, line=chunk.lines[place], column=RUN_ID)
        elif folded in self._seen:
            fix = "Give each run an id of its own."
            self._findings.error(f"run id {run_id!r} is there twice", fix, line=chunk.lines[place], column=RUN_ID)
        self._seen.update([folded] if folded else [])


class StatusDecoder:
    """How far each run has come."""

    def __init__(self, findings: TableFindings) -> None:
        self._findings = findings
        self._known: dict[str, RunStatus] = {}
        self._unknown: set[str] = set()

    def read(self, cells: Sequence[str], chunk: RowChunk) -> list[RunStatus]:
        """Return statuses; an unknown word is an error."""
        new = {word: status_of_word(word) for word in dict.fromkeys(cells) if word not in self._known}
        self._known |= {word: status or RunStatus.TODO for word, status in new.items()}
        self._unknown |= {word for word, status in new.items() if status is None}
        for place, word in () if self._unknown.isdisjoint(cells) else enumerate(cells):
            if word in self._unknown:
                fix = partial(did_you_mean, word, [status.value for status in RunStatus])
                self._findings.error(f"{word!r} is not a status", fix, line=chunk.lines[place], column=STATUS)
        return list(map(self._known.__getitem__, cells))


class FactorDecoder:
    """The treatments of one factor; an unknown value is kept, with a warning.

    Attributes:
        name: the heading.
        kept: texts that are kept as they were read, as their values would be written in another way.
    """

    def __init__(
        self,
        column: FactorColumn,
        kind: str | None,
        findings: TableFindings,
        *,
        decimal_comma: bool,
        empty_is_none: bool = False,
    ) -> None:
        self.name = column.name
        self.kept: set[str] = set()
        self._factor = column.factor
        self._findings = findings
        self._decimal_comma = decimal_comma
        known = column.factor.treatments if column.factor is not None else ()
        #: Spreadsheets, pandas and the earlier tools write a treatment None as an empty cell.
        self._empty_is_none = empty_is_none and any(treatment is None for treatment in known)
        self._kind = kind
        self._known: dict[str, Any] = {}

    def read(self, cells: Sequence[str], chunk: RowChunk) -> list[Any]:
        """Return treatments: the factor's own objects."""
        strange = [text for text in dict.fromkeys(cells) if text not in self._known and not self._is_treatment(text)]
        if strange and self._factor is not None:
            first = dict(zip(reversed(cells), range(len(cells) - 1, -1, -1), strict=True))
            for text in strange:
                problem = f"{text!r} is not a treatment of factor {self.name!r}" if text else "the cell is empty"
                fix = partial(self._factor.suggestion, text)
                self._findings.warning(problem, fix, line=chunk.lines[first[text]], column=self.name)
        return list(map(self._known.__getitem__, cells))

    def _is_treatment(self, text: str) -> bool:
        """Return whether `text` stands for a treatment; remember its value."""
        if self._factor is not None:
            place = treatment_position(self._factor, text, decimal_comma=self._decimal_comma)
            if place is not None:
                self._known[text] = self._factor.treatments[place]
                return True
            if not text and self._empty_is_none:
                self.kept.add(text)
                self._known[text] = None
                return True
        self._known[text] = value = typed_value(text, self._kind, decimal_comma=self._decimal_comma)
        if value is None or str(value) != text:
            self.kept.add(text)
        return False


class RepetitionDecoder:
    """Which repetition of its combination each run is: from 1, and 0 where `least` allows it, for warm-up runs."""

    def __init__(self, findings: TableFindings, *, least: int = 1) -> None:
        self._findings = findings
        self._least = least
        self._known: dict[str, int] = {}
        self._seen: dict[tuple[int, ...], int] = {}

    def read(self, cells: Sequence[str], chunk: RowChunk) -> list[int]:
        """Return numbers of repetitions; another cell is an error."""
        for text in dict.fromkeys(cells):
            number = number_of(text)
            if number is not None and number == int(number) and self._least <= number < _MOST_REPETITIONS:
                self._known[text] = int(number)
        for place, text in () if self._known.keys() >= set(cells) else enumerate(cells):
            if text not in self._known:
                fix = f"Write which repetition it is: a whole number from {self._least}."
                problem = f"{text!r} is not the number of a repetition"
                self._findings.error(problem, fix, line=chunk.lines[place], column=REPETITION)
        return [self._known.get(text, 1) for text in cells]

    def counted(self, combinations: Sequence[tuple[Any, ...]]) -> list[int]:
        """Return the number of each run among those of its combination, where the file has no such column."""
        numbers = []
        for treatments in combinations:
            which = tuple(map(id, treatments))  # treatments need not be hashable; each is one object
            self._seen[which] = number = self._seen.get(which, 0) + 1
            numbers.append(number)
        return numbers


class MarkDecoder:
    """How each run was planned: in which batch, or whether it only warms up; an empty cell is the usual value."""

    def __init__(self, column: ColumnDescription, findings: TableFindings) -> None:
        self._column = column
        self._findings = findings
        self._kind: type = bool if column.type == "boolean" else int
        self._usual: Any = False if self._kind is bool else 1

    def read(self, cells: Sequence[str], chunk: RowChunk) -> list[Any]:
        """Return numbers or truth values; another cell is an error."""
        known = {text: typed_value(text, self._column.type) for text in dict.fromkeys(cells)}
        wrong = {text for text, value in known.items() if value is not None and type(value) is not self._kind}
        for place, text in enumerate(cells) if wrong else ():
            if text in wrong:
                problem = f"{text!r} is not {TYPE_WORDS[self._column.type]}"
                fix = f"Write {'True or False' if self._kind is bool else 'a whole number'}."
                self._findings.error(problem, fix, line=chunk.lines[place], column=self._column.name)
        return [self._usual if known[text] is None or text in wrong else known[text] for text in cells]


class MeasureDecoder:
    """The values of one measure."""

    def __init__(
        self, name: str, kind: str | None, findings: TableFindings, *, decimal_comma: bool, blank_is_missing: bool
    ) -> None:
        self._name = name
        self._kind = kind
        self._findings = findings
        self._blank_is_missing = blank_is_missing
        self._typed = partial(typed_values, kind=kind, decimal_comma=decimal_comma)

    def read(self, cells: Sequence[str], chunk: RowChunk) -> list[CellValue]:
        """Return values; one that is not of the column's type is a warning."""
        if self._blank_is_missing:
            cells = ["" if cell.isspace() else cell for cell in cells]
        fitting = _TYPES.get(self._kind or "")
        if fitting is not None and not MISSING.isdisjoint(cells):
            cells = ["" if cell in MISSING else cell for cell in cells]
        values = self._typed(cells)
        if fitting is None or {*map(type, values)} <= {*fitting, type(None)}:
            return values
        for place, value in enumerate(values):
            if is_unfit(value, self._kind):
                problem = f"{cells[place]!r} is not {TYPE_WORDS[str(self._kind)]}, as the column's other values"
                fix = "Correct the cell, or leave it empty where there is no value."
                self._findings.warning(problem, fix, line=chunk.lines[place], column=self._name)
        return values


class TextDecoder:
    """Texts that are kept unchanged: time stamps, and a user's own columns."""

    def __init__(self, name: str, findings: TableFindings, *, is_stamp: bool) -> None:
        self._name = name
        self._findings = findings
        self._is_stamp = is_stamp

    def read(self, cells: Sequence[str], chunk: RowChunk) -> Sequence[str | None]:
        """Return texts; in a column of time stamps, another text is a warning."""
        if self._is_stamp and not MISSING.isdisjoint(cells):
            cells = ["" if cell in MISSING else cell for cell in cells]
        if not any(cells):
            return [None] * len(cells)
        if has_odd := self._is_stamp and not are_stamps(list(filter(None, cells))):
            cells = [as_stamp(cell) or cell if cell and not are_stamps([cell]) else cell for cell in cells]
        for place, cell in enumerate(cells) if has_odd else ():
            if cell and not are_stamps([cell]):
                fix = "Write it as in 2026-01-31T12:00:00.250Z."
                self._findings.warning(f"{cell!r} is not a time stamp", fix, line=chunk.lines[place], column=self._name)
        return cells if all(cells) else [cell or None for cell in cells]
