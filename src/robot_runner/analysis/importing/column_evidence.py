"""Evidence for a column's role in its values and its heading: whether values repeat, cross, count or differ."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from robot_runner.analysis.importing.units import MISSING
from robot_runner.core.storage.cells import RunStatus, number_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.importing.foreign_table import ForeignTable

    Codes = NDArray[np.int64]


class Role(Enum):
    """The role of a column."""

    RUN_ID = "run id"
    STATUS = "status"
    REPETITION = "repetition"
    BLOCK = "block"
    FACTOR = "factor"
    MEASURE = "measure"
    TEXT = "kept as text"


class Confidence(Enum):
    """The confidence in a role: for LIKELY there is some evidence and little against it, UNSURE needs an answer."""

    SURE = "sure"
    LIKELY = "likely"
    UNSURE = "unsure"


#: A role, the confidence in it, and the reason in words.
Verdict = tuple[Role, Confidence, str]


@dataclass(frozen=True, slots=True)
class RoleGuess:
    """The guessed role of a column, the confidence in it, and the reason.

    Example:
        >>> guess = RoleGuess("level", Role.FACTOR, Confidence.UNSURE, "few numbers, which repeat unevenly")
        >>> guess.question
        "column 'level' is taken for a factor: few numbers, which repeat unevenly"
    """

    column: str
    role: Role
    confidence: Confidence
    reason: str

    @property
    def question(self) -> str:
        """The doubtful guess in words."""
        taken = self.role.value if self.role is Role.TEXT else f"taken for a {self.role.value}"
        return f"column {self.column!r} is {taken}: {self.reason}"


#: Run ids that end in a repetition, as earlier tools and people write them: `run_3_repetition_1`, `slow_rep2`.
IN_RUN_ID = re.compile(r"(.*?)[_-](?:repetition|rep|trial)[_-]?(\d+)$", re.IGNORECASE)
#: Repetitions written as a word with a number, as in `r3`, `rep_3` or `repeat3.csv`.
_LAST_NUMBER = re.compile(r"(?:\w*[A-Za-z_ -])?(\d+)(?:\.[A-Za-z]+)?")
_LIKE_A_NUMBER = re.compile(r"[+-]?[0-9.,eE+-]+")
_OF_MOMENTS = re.compile(r"start|begin|end|stop|finish|stamp|date|time|at$")
#: Its beginning and its end, s since 1970; in ms or ns the numbers are larger.
THIS_CENTURY = (978_307_200, 4_102_444_800)

_WORDS = {
    RunStatus.DONE: "done true yes 1 finished completed complete ok success x",
    RunStatus.TODO: "- – — todo to_do false no 0 pending running planned",  # noqa: RUF001 - spreadsheets write dashes
    RunStatus.FAILED: "failed error aborted crashed fail",
}
#: The words for a run's status, in lower case.
STATUSES = {word: status for status, words in _WORDS.items() for word in words.split()} | dict.fromkeys(
    ("", "to do", "not done"), RunStatus.TODO
)

# Words in the headings of measures.
_MEASURED = re.compile(
    r"energy|power|joules?|watts?|time|duration|latency|delay|elapsed|cpu|gpu|mem(ory)?|v?ram|swap|usage|util\w*|"
    r"accuracy|precision|recall|f1|score|errors?|r?mse|mae|throughput|temp(erature)?|emissions?|consum\w+|average|avg|"
    r"mean|median|std|sd|min|max|total|sum|misses|voltage|current|packets?|loss|fps|distance|collisions?|success|"
    r"failures?|battery|dram|exit|rate|ratio|count|freq\w*"
)
#: Words in the headings of what a run brought about, as yes or no.
_OUTCOME = re.compile(r"success\w*|succeeded|fail\w*|reached|collisions?|collided|crash\w*|solved|timeout")
_WORDS_OF_HEADING = re.compile(r"[A-Z]?[a-z]+\d?|[A-Z]+")
#: Headings of columns that number rows.
NUMBERING = re.compile(r"(.*[_ ])?(id|index|idx|no|nr|number|num|#)\.?|unnamed: ?\d+|n", re.IGNORECASE)

#: Headings of treatments, whatever the unit of study: where each plant has one treatment, the treatment is the factor.
TREATMENTS = re.compile(r"treatments?|types?|conditions?|groups?|arms?", re.IGNORECASE)

#: Treatments are planned, so that their frequencies are similar: the rarest has at least half of the most frequent.
_EVENLY = 0.5
#: Fewer rows than these may be counted by chance.
_FEWEST_ROWS = 5
#: Repetition numbers are unique within a combination, except for a few runs that were executed again.
_TELLING = 0.95


def are_even(counts: Codes) -> bool:
    """Return whether counts are about equal, as those of what was planned are."""
    return bool(counts.min() >= _EVENLY * counts.max())


def repetition_number(cell: str) -> int | None:
    """Return the number of a repetition, from a plain number or a word with one, or None."""
    worded = _LAST_NUMBER.fullmatch(cell)
    number = number_of(worded[1] if worded else cell)
    return int(number) if number is not None and number >= 0 and number == int(number) else None


class ColumnEvidence:
    """Evidence for the roles of a table's columns; each column is examined once.

    Attributes:
        count: the number of rows.
        places: the place of each column.
        is_over: whether all runs of the table are done, by its status column.
    """

    def __init__(self, table: ForeignTable) -> None:
        self.table = table
        self.count = len(table.rows)
        self.places = {name: place for place, name in enumerate(table.headings)}
        self._cache: dict[str, tuple[Codes, tuple[str, ...]]] = {}
        #: The combination of each run, and its repetition, as far as run ids tell.
        self._combination: Codes | None = None
        self._repetition: Codes | None = None
        self.is_over = False

    # Columns as codes: one number for each value.

    def _codes(self, name: str) -> Codes:
        if name not in self._cache:
            cells = self.table.column(name)
            if self.table.is_numeric(name):
                cells = tuple("" if cell.casefold() in MISSING else cell for cell in cells)
            codes, values = pd.factorize(np.array(cells, dtype=object))
            self._cache[name] = (codes, tuple(values))
        return self._cache[name][0]

    def values(self, name: str) -> tuple[str, ...]:
        """Return the distinct values of a column, in the order of their first cells; an empty cell is a value."""
        self._codes(name)
        return self._cache[name][1]

    def levels(self, name: str) -> int:
        """Return the number of distinct values of a column."""
        return len(self.values(name))

    def _combined(self, names: Sequence[str]) -> Codes:
        """Return a code for each combination of values."""
        codes = np.zeros(self.count, dtype=np.int64)
        for name in names:
            codes = np.unique(codes * self.levels(name) + self._codes(name), return_inverse=True)[1]
        return codes

    def _follows(self, codes: Codes, name: str) -> bool:
        """Return whether each code occurs with only one value of a column."""
        return _pairs(codes, self._codes(name)) == _distinct(codes)

    # Single columns.

    def is_filled(self, name: str) -> bool:
        """Return whether no cell is empty."""
        return "" not in self.values(name)

    def is_empty(self, name: str) -> bool:
        """Return whether all cells are empty."""
        return self.values(name) in {("",), ()}

    def differs_everywhere(self, name: str) -> bool:
        """Return whether all values are distinct, and none is missing."""
        return self.levels(name) == self.count and self.is_filled(name)

    def counts_rows(self, name: str) -> bool:
        """Return whether a column counts the rows from 0 or 1 on, one by one."""
        if self.count < _FEWEST_ROWS or self.names_measure(name):
            return False
        return self.values(name) in [tuple(map(str, range(first, first + self.count))) for first in (0, 1)]

    def is_numeric(self, name: str) -> bool:
        """Return whether a column has mostly numbers."""
        if self.table.is_numeric(name):
            return True
        filled = [value for value in self.values(name) if value]
        return bool(filled) and 2 * sum(bool(_LIKE_A_NUMBER.fullmatch(value)) for value in filled) >= len(filled)

    def is_measurable(self, name: str) -> bool:
        """Return whether the column could be a measure: numbers, truth values, or no values so far."""
        if name in self.table.unnamed:
            return False
        return self.is_empty(name) or self.table.is_boolean(name) or self.is_numeric(name)

    def without_outcomes(self, name: str, others: Sequence[str]) -> list[str]:
        """Return columns without answers and texts that come after a column: they, like itself, may be outcomes."""
        place = self.places[name]
        return [each for each in others if self.places[each] < place or (self.is_numeric(each) and each != name)]

    def is_decimal(self, name: str) -> bool:
        """Return whether a column has fractional numbers."""
        return any((number := self.table.number(value)) is not None and number % 1 for value in self.values(name))

    def are_epochs(self, name: str) -> bool:
        """Return whether numbers are times since 1970, in a column whose heading names times."""
        if not _OF_MOMENTS.search(name.casefold()):
            return False
        found = map(self.table.number, self.values(name))
        return min((each for each in found if each is not None), default=0) >= THIS_CENTURY[0]

    def is_even(self, name: str) -> bool:
        """Return whether all values occur about equally often."""
        return are_even(np.bincount(self._codes(name)))

    def is_equal(self, name: str) -> bool:
        """Return whether all values occur equally often."""
        return len(set(np.bincount(self._codes(name)).tolist())) == 1

    def names_measure(self, name: str) -> bool:
        """Return whether the heading names a measure, by a unit or by its words."""
        return self.has_unit(name) or self.is_called_measured(name)

    def is_called_measured(self, name: str) -> bool:
        """Return whether the heading has a word for what is measured."""
        return any(_MEASURED.fullmatch(word.casefold()) for word in _WORDS_OF_HEADING.findall(name))

    def has_unit(self, name: str) -> bool:
        """Return whether the heading has a unit, other than that of shares and counts."""
        unit = self.table.unit(name)
        return unit is not None and unit.si != "1"

    def names_outcome(self, name: str) -> bool:
        """Return whether the heading names what comes of a run, such as success."""
        return any(_OUTCOME.fullmatch(word.casefold()) for word in _WORDS_OF_HEADING.findall(name))

    # Run ids and repetitions.

    def read_run_ids(self, run_id: str | None) -> None:
        """Find the combinations of runs from run ids that end in the number of the repetition."""
        found = [IN_RUN_ID.match(cell) for cell in self.table.column(run_id)] if run_id else []
        if not found or not all(found):
            return
        combination = pd.factorize(np.array([each[1] for each in found if each], dtype=object))[0]
        repetition = pd.factorize(np.array([each[2] for each in found if each], dtype=object))[0]
        if _distinct(repetition) > 1:
            self._combination, self._repetition = combination, repetition

    def read_status(self, status: str | None) -> None:
        """Find out whether all runs are done: then none is still planned, and an empty cell was not measured."""
        words = self.values(status) if status is not None else ()
        self.is_over = bool(words) and {STATUSES.get(word.casefold()) for word in words} == {RunStatus.DONE}

    @property
    def knows_combinations(self) -> bool:
        """Whether run ids tell the combinations of runs."""
        return self._combination is not None

    @property
    def repetition_in_run_id(self) -> bool:
        """Whether run ids count repetitions."""
        return self._repetition is not None

    def tells_status(self, name: str) -> bool:
        """Return whether the values of a column are words for a run's status."""
        words = {value.casefold() for value in self.values(name)}
        return words <= STATUSES.keys() and not words <= {"0", "1"}

    def may_count_repetitions(self, name: str) -> bool:
        """Return whether a column could count the runs of each combination."""
        if not self.is_filled(name) or None in map(repetition_number, self.values(name)):
            return False
        if self._combination is not None and self._follows(self._combination, name):
            return False
        if self.differs_everywhere(name):  # the column numbers all runs, unless they have one combination
            return not any(
                1 < self.levels(other) <= self.count // 2
                for other in self.table.headings
                if other != name and self.is_filled(other) and self.is_even(other) and not self.names_measure(other)
            )
        return self.levels(name) > 1

    def counts(self, name: str) -> bool:
        """Return whether a column counts from 0 or 1, in numbers or in numbered texts such as `set_1` and `set_2`."""
        numbers = sorted(number for each in self.values(name) if (number := repetition_number(each)) is not None)
        return numbers in [list(range(first, first + self.levels(name))) for first in (0, 1)]

    def tells_runs_apart(self, name: str, factors: Sequence[str]) -> bool:
        """Return whether the runs of each combination have different values in a column."""
        return _pairs(self._combined(factors), self._codes(name)) >= _TELLING * self.count

    def sums_up(self, name: str, factors: Sequence[str]) -> bool:
        """Return whether a column counts the runs that a row summarises: one row a combination, and no count is a 1."""
        numbers = [repetition_number(each) for each in self.values(name)]
        return _distinct(self._combined(factors)) == self.count and min(each or 0 for each in numbers) > 1

    def is_part_of(self, name: str, texts: Sequence[str]) -> bool:
        """Return whether a column has a few texts, each of which groups some of another column's."""
        if self.is_numeric(name) or not self.is_filled(name) or not 1 < self.levels(name) <= self.count // 2:
            return False
        return any(self._follows(self._codes(text), name) for text in texts if self.levels(text) > self.levels(name))

    def follow(self, factors: Sequence[str], name: str) -> bool:
        """Return whether all runs of a combination have the same value, and combinations have several runs."""
        combined = self._combined(factors)
        return 2 * _distinct(combined) <= self.count and self._follows(combined, name)

    def unit_of(self, name: str, factors: Sequence[str]) -> str | None:
        """Return the factor of which each number of a column has one treatment, as numbered animals of a litter do.

        Numbers of units are whole, and their rows are adjacent; measured numbers that repeat are scattered.
        """
        codes = self._codes(name)
        stand_together = 1 + np.count_nonzero(np.diff(codes)) == self.levels(name) <= self.count // 2
        if not stand_together or not self.is_numeric(name) or self.is_decimal(name) or self.names_measure(name):
            return None
        fewer = [each for each in factors if 1 < self.levels(each) < self.levels(name)]
        return next((each for each in fewer if self._follows(codes, each)), None)

    def varies(self, name: str) -> bool:
        """Return whether values differ between repetitions of a combination that run ids tell."""
        return self._combination is not None and not self._follows(self._combination, name)

    def differs_between_repetitions(self, name: str, others: Sequence[str], repetition: str | None) -> bool:
        """Return whether a column differs between repetitions of a combination of other columns.

        If so, it is measured. Measured numbers repeat, too, where they are few or round.
        """
        which = self._repetition if repetition is None else self._codes(repetition)
        if which is None:
            return False
        combined = self._combined(others)
        return _pairs(combined, which) == self.count and not self._follows(combined, name)

    # Relations between factors.

    def is_balanced(self, name: str, others: Sequence[str]) -> bool:
        """Return whether each value of a column occurs equally often with every combination of the others."""
        return self.crosses(name, others) and len(set(np.bincount(self._combined([*others, name])).tolist())) == 1

    def crosses(self, name: str, others: Sequence[str]) -> bool:
        """Return whether each value of a column occurs with every combination of the others."""
        combined = self._combined(others)
        return _pairs(combined, self._codes(name)) == _distinct(combined) * self.levels(name)


def _distinct(codes: Codes) -> int:
    return len(np.unique(codes))


def _pairs(first: Codes, second: Codes) -> int:
    """Return the number of distinct pairs of codes."""
    return _distinct(first * (int(second.max(initial=0)) + 1) + second)
