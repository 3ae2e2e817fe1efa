"""From the cells of a run table's file to the values of its columns: one decoder a kind of column."""

from __future__ import annotations

import re
from array import array
from functools import cached_property, partial
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.core.design.columns import REPETITION, RUN_ID, STATUS, numbered_run_id
from robot_runner.core.errors import did_you_mean
from robot_runner.core.storage.cells import (
    RunStatus,
    are_stamps,
    number_of,
    status_of_word,
    treatment_position,
    typed_value,
    typed_values,
)
from robot_runner.core.storage.table_columns import CodedColumn, RunIdColumn, StatusColumn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.core.storage.cells import CellValue
    from robot_runner.core.storage.run_table_reading import TableFindings
    from robot_runner.core.storage.table_columns import FactorColumn

__all__ = [
    "CellDecoder",
    "FactorDecoder",
    "MeasureDecoder",
    "RepetitionDecoder",
    "RowChunk",
    "RunIdDecoder",
    "StatusDecoder",
    "TextDecoder",
]

_LINE_END = re.compile(r"\r\n|\r|\n")
_RUN_ID = re.compile(r"\w[\w.-]{0,59}")  # it names the run's folder
# A whole number among floats is no mistake, and the schema of an experiment that broke off may be older than the table.
_TYPES = {"number": (int, float), "integer": (int, float), "boolean": (bool,)}


class RowChunk:
    """Some rows of a file, with the lines on which they begin (worked out only where there is something to say)."""

    def __init__(self, rows: list[list[str]], first_line: int) -> None:
        self.rows = rows
        self._first_line = first_line

    @cached_property
    def lines(self) -> list[int]:
        """The line on which each row begins, counted from 1, and the line after the last."""
        heights = (1 + sum(len(_LINE_END.findall(cell)) for cell in row) for row in self.rows)
        return list(accumulate(heights, initial=self._first_line))

    def without_blank_rows(self) -> RowChunk:
        """Return the rows that have anything in them."""
        if all(map(any, self.rows)):
            return self
        return self.only([place for place, row in enumerate(self.rows) if any(row)])

    def only(self, places: Sequence[int]) -> RowChunk:
        """Return the rows at these places, on the same lines."""
        chunk = RowChunk([self.rows[place] for place in places], self._first_line)
        chunk.lines = [*(self.lines[place] for place in places), self.lines[-1]]
        return chunk


class CellDecoder(Protocol):
    """Takes the cells of one column, chunk by chunk."""

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take the column's cells in the rows of `chunk`."""
        ...


class RunIdDecoder:
    """The runs' ids: each one different, and fit to name a folder."""

    def __init__(self, findings: TableFindings) -> None:
        self._findings = findings
        self._run_ids: list[str] = []
        self._seen: set[str] = set()  # in one case of letters: some file systems know no other
        self._empty: list[int] = []

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take ids; those of a planned table (`r_1`, `r_2`, ...) need no further look."""
        count = len(self._run_ids)
        if not self._seen and not self._empty:
            expected = list(map(numbered_run_id, range(count + 1, count + len(cells) + 1)))
            if list(cells) == expected:
                self._run_ids += expected
                return
            self._seen.update(self._run_ids)
        for place, cell in enumerate(cells):
            self._take_one(cell.strip(), chunk, place)

    def column(self, count: int) -> RunIdColumn:
        """Return the column; runs are numbered where no row has an id."""
        return RunIdColumn(self._run_ids, count) if self._seen else RunIdColumn.numbered(count)

    def check(self) -> None:
        """Say which runs have no id where others have one."""
        for line in self._empty if self._seen else ():
            fix = "Give it an id, or leave the whole column empty: runs are numbered then."
            self._findings.error("the run has no id", fix, line=line, column=RUN_ID)

    def _take_one(self, run_id: str, chunk: RowChunk, place: int) -> None:
        self._run_ids.append(run_id)
        folded = run_id.casefold()
        if not run_id:
            self._empty.append(chunk.lines[place])
        elif not _RUN_ID.fullmatch(run_id):
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
        self._column = StatusColumn(0)

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take words for statuses."""
        for word in dict.fromkeys(cells):
            if word not in self._known:
                self._learn(word)
        self._column.extend(cells, self._known)
        for place, word in () if self._unknown.isdisjoint(cells) else enumerate(cells):
            if word in self._unknown:
                fix = partial(did_you_mean, word, [status.value for status in RunStatus])
                self._findings.error(f"{word!r} is no status", fix, line=chunk.lines[place], column=STATUS)

    def column(self, count: int) -> StatusColumn:
        """Return the column; where the file has none, all runs are to do."""
        return self._column if len(self._column) else StatusColumn(count)

    def _learn(self, word: str) -> None:
        status = status_of_word(word)
        self._known[word] = status or RunStatus.TODO
        if status is None:
            self._unknown.add(word)


class FactorDecoder:
    """The treatments of one factor; a value that is none of them is kept, with a warning."""

    def __init__(self, column: FactorColumn, kind: str | None, findings: TableFindings, *, decimal_comma: bool) -> None:
        self._name = column.name
        self._factor = column.factor
        self._findings = findings
        self._decimal_comma = decimal_comma
        self._kind = kind
        self._values: list[Any] = list(column.factor.treatments) if column.factor else []
        self._texts: list[str] = list(column.factor.texts) if column.factor else []
        self._known: dict[str, int] = {}
        self.places = array("I")

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take treatments."""
        strange = [text for text in dict.fromkeys(cells) if text not in self._known and not self._is_treatment(text)]
        self.places.extend(map(self._known.__getitem__, cells))
        if strange and self._factor is not None:
            first = dict(zip(reversed(cells), range(len(cells) - 1, -1, -1), strict=True))
            for text in strange:
                problem = f"{text!r} is no treatment of factor {self._name!r}" if text else "the cell is empty"
                fix = partial(self._factor.suggestion, text)
                self._findings.warning(problem, fix, line=chunk.lines[first[text]], column=self._name)

    def column(self) -> CodedColumn:
        """Return the column."""
        return CodedColumn(self._name, self._values, self._texts, self.places)

    def _is_treatment(self, text: str) -> bool:
        """Return whether `text` stands for a treatment; remember it as one or as what it is by its looks."""
        place = None
        if self._factor is not None:
            place = treatment_position(self._factor, text, decimal_comma=self._decimal_comma)
        if place is None:
            self._known[text] = len(self._values)
            self._values.append(typed_value(text, self._kind, decimal_comma=self._decimal_comma))
            self._texts.append(text)
            return False
        self._known[text] = place
        return True


class RepetitionDecoder:
    """Which repetition of its combination each run is."""

    def __init__(self, findings: TableFindings) -> None:
        self._findings = findings
        self._known: dict[str, int] = {}
        self._numbers = array("I")

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take numbers of repetitions."""
        for text in dict.fromkeys(cells):
            number = number_of(text)
            if number is not None and number == int(number) and 1 <= number < 1 << 32:
                self._known[text] = int(number)
        try:
            self._numbers.extend(map(self._known.__getitem__, cells))
        except KeyError:
            for place, text in enumerate(cells):
                if text not in self._known:
                    fix = "Write which repetition it is: a whole number from 1."
                    problem = f"{text!r} is no number of a repetition"
                    self._findings.error(problem, fix, line=chunk.lines[place], column=REPETITION)

    def column(self, factors: Sequence[FactorDecoder]) -> CodedColumn:
        """Return the column; where the file has none, the runs of each combination are counted."""
        numbers = self._numbers or _occurrences(factors)
        values = range(max(numbers, default=0) + 1)
        return CodedColumn(REPETITION, values, [*map(str, values)], numbers)


class MeasureDecoder:
    """The values of one measure."""

    def __init__(
        self,
        name: str,
        kind: str | None,
        findings: TableFindings,
        *,
        decimal_comma: bool,
        blank_is_missing: bool = False,
    ) -> None:
        self._name = name
        self._kind = kind
        self._findings = findings
        self._blank_is_missing = blank_is_missing
        self._typed = partial(typed_values, kind=kind, decimal_comma=decimal_comma)
        self.values: list[CellValue] = []

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take values, and say which are not of the column's type."""
        if self._blank_is_missing:
            cells = ["" if cell.isspace() else cell for cell in cells]
        values = self._typed(cells)
        self.values += values
        fitting = _TYPES.get(self._kind or "")
        if fitting is None or {*map(type, values)} <= {*fitting, type(None)}:
            return
        for place, value in enumerate(values):
            if value is not None and type(value) not in fitting:
                problem = f"{cells[place]!r} is no {self._kind}, as the column's other values"
                fix = "Mend the cell, or leave it empty where there is no value."
                self._findings.warning(problem, fix, line=chunk.lines[place], column=self._name)


class TextDecoder:
    """Text that is carried as it is: time stamps, and a user's own columns."""

    def __init__(self, name: str, findings: TableFindings, *, is_stamp: bool) -> None:
        self._name = name
        self._findings = findings
        self._is_stamp = is_stamp
        self.texts: list[str | None] = []

    def take(self, cells: Sequence[str], chunk: RowChunk) -> None:
        """Take text, and say which is no time stamp where all are to be."""
        is_empty = not any(cells)
        self.texts += [None] * len(cells) if is_empty else [cell or None for cell in cells]
        if is_empty or not self._is_stamp or are_stamps([cell for cell in cells if cell]):
            return
        for place, cell in enumerate(cells):
            if cell and not are_stamps([cell]):
                fix = "Write it as in 2026-01-31T12:00:00.250Z."
                problem = f"{cell!r} is no time stamp"
                self._findings.warning(problem, fix, line=chunk.lines[place], column=self._name)


def _occurrences(factors: Sequence[FactorDecoder]) -> array[int]:
    seen: dict[tuple[int, ...], int] = {}
    numbers = array("I")
    for combination in zip(*(factor.places for factor in factors), strict=True):
        seen[combination] = number = seen.get(combination, 0) + 1
        numbers.append(number)
    return numbers
