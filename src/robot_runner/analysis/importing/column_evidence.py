"""What the values and the heading of a column say about its role: whether values repeat, cross, count or differ."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from robot_runner.analysis.importing.cell_numbers import MISSING
from robot_runner.analysis.importing.role_guesses import Confidence, Role, Verdict
from robot_runner.core.storage.cells import number_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.importing.foreign_table import ForeignTable

    Codes = NDArray[np.int64]

__all__ = ["IN_RUN_ID", "ColumnEvidence", "repetition_number"]

#: Run ids that end in a repetition, as the earlier tools and people write them: `run_3_repetition_1`, `slow_rep2`.
IN_RUN_ID = re.compile(r"(.*?)[_-](?:repetition|rep|trial)[_-]?(\d+)$", re.IGNORECASE)
#: Repetitions that are numbered in words, as in `r3`, `rep_3` or `repeat3.csv`.
_LAST_NUMBER = re.compile(r"(?:\w*[A-Za-z_ -])?(\d+)(?:\.[A-Za-z]+)?")
_LIKE_A_NUMBER = re.compile(r"[+-]?[0-9.,eE+-]+")
_OF_MOMENTS = re.compile(r"start|begin|end|stop|finish|stamp|date|time|at$")
_THIS_CENTURY = 978_307_200  # s since 1970; counted in ms or ns it is more
_MOMENT = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")

# Words that stand in the headings of what is measured.
_MEASURED = re.compile(
    r"energy|power|joules?|watts?|time|duration|latency|delay|elapsed|cpu|gpu|mem(ory)?|v?ram|swap|usage|util\w*|"
    r"accuracy|precision|recall|f1|score|errors?|r?mse|mae|throughput|temp(erature)?|emissions?|consum\w+|average|avg|"
    r"mean|median|std|sd|min|max|total|sum|misses|voltage|current|packets?|loss|fps|distance|collisions?|success|"
    r"failures?|battery|dram|exit|rate|ratio|count|freq\w*"
)
_WORDS = re.compile(r"[A-Z]?[a-z]+\d?|[A-Z]+")
_NUMBERING = re.compile(r"(.*[_ ])?(id|index|idx|no|nr|number|num|#)\.?|unnamed: ?\d+|n", re.IGNORECASE)

#: What treatments are tried on: where each of these has one treatment, they belong to it rather than it to them.
_UNITS = re.compile(r"subject|participant|person|website|device|robot|room|app|phone|host|machine")

#: Treatments are planned, so that they come about equally often: the rarest at least half as often as the commonest.
_EVENLY = 0.5
#: Numbers that were planned are few: more than these are seldom treatments, however evenly they come.
_MANY_TREATMENTS = 12
#: A repetition tells runs of a combination apart, but for some that were executed again.
_TELLING = 0.95


def repetition_number(cell: str) -> int | None:
    """Return the number of a repetition, written as a number or in words, or None."""
    worded = _LAST_NUMBER.fullmatch(cell)
    number = number_of(worded[1] if worded else cell)
    return int(number) if number is not None and number >= 0 and number == int(number) else None


class ColumnEvidence:
    """What a table's columns show; each is looked at once.

    Example:
        >>> ColumnEvidence(table).verdict("speed", ["task"], "repetition", is_first=True)  # doctest: +SKIP
        (<Role.FACTOR: 'factor'>, <Confidence.SURE: 'sure'>, '3 numbers, each equally often')
    """

    def __init__(self, table: ForeignTable) -> None:
        self._table = table
        self._count = len(table.rows)
        self._cache: dict[str, tuple[Codes, tuple[str, ...]]] = {}
        #: Which combination a run has, and which repetition of it, as far as run ids tell.
        self._combination: Codes | None = None
        self._repetition: Codes | None = None

    # Columns as codes: one number for each value.

    def _codes(self, name: str) -> Codes:
        if name not in self._cache:
            cells = self._table.column(name)
            if self._table.is_numeric(name):
                cells = tuple("" if cell.casefold() in MISSING else cell for cell in cells)
            codes, values = pd.factorize(np.array(cells, dtype=object))
            self._cache[name] = (codes, tuple(values))
        return self._cache[name][0]

    def values(self, name: str) -> tuple[str, ...]:
        """Return the different values of a column, in the order in which they come; an empty cell is one."""
        self._codes(name)
        return self._cache[name][1]

    def _levels(self, name: str) -> int:
        return len(self.values(name))

    def _combined(self, names: Sequence[str]) -> Codes:
        """Return one number for each combination of values."""
        codes = np.zeros(self._count, dtype=np.int64)
        for name in names:
            codes = np.unique(codes * self._levels(name) + self._codes(name), return_inverse=True)[1]
        return codes

    def _follows(self, codes: Codes, name: str) -> bool:
        """Return whether each code goes with one value of a column."""
        return _pairs(codes, self._codes(name)) == _distinct(codes)

    # Single columns.

    def is_filled(self, name: str) -> bool:
        """Return whether no cell is empty."""
        return "" not in self.values(name)

    def is_empty(self, name: str) -> bool:
        """Return whether all cells are empty."""
        return self.values(name) in {("",), ()}

    def differs_everywhere(self, name: str) -> bool:
        """Return whether no value is there twice, and none is missing."""
        return self._levels(name) == self._count and self.is_filled(name)

    def is_numeric(self, name: str) -> bool:
        """Return whether a column has mostly numbers."""
        if self._table.is_numeric(name):
            return True
        filled = [value for value in self.values(name) if value]
        return bool(filled) and 2 * sum(bool(_LIKE_A_NUMBER.fullmatch(value)) for value in filled) >= len(filled)

    def is_measurable(self, name: str) -> bool:
        """Return whether values of the column could be a measure's: numbers, truth values, or none so far."""
        if name in self._table.unnamed:
            return False
        return self.is_empty(name) or self._table.is_boolean(name) or self.is_numeric(name)

    def _is_decimal(self, name: str) -> bool:
        numbers = (self._table.number(value) for value in self.values(name))
        return any(number is not None and number != int(number) for number in numbers)

    def _are_epochs(self, name: str) -> bool:
        """Return whether numbers count the time since 1970, in a column whose heading speaks of moments."""
        if not _OF_MOMENTS.search(name.casefold()):
            return False
        numbers = [number for value in self.values(name) if (number := self._table.number(value)) is not None]
        return bool(numbers) and min(numbers) >= _THIS_CENTURY

    def _is_even(self, name: str) -> bool:
        counts = np.bincount(self._codes(name))
        return bool(counts.min() >= _EVENLY * counts.max())

    def _names_measure(self, name: str) -> bool:
        """Return whether the heading speaks of something measured, by a unit or by its words."""
        unit = self._table.unit(name)
        words = (word.casefold() for word in _WORDS.findall(name))
        return (unit is not None and unit.si != "1") or any(map(_MEASURED.fullmatch, words))

    # Run ids and repetitions.

    def read_run_ids(self, run_id: str | None) -> None:
        """Learn from run ids which runs have one combination, where they end in the number of the repetition."""
        found = [IN_RUN_ID.match(cell) for cell in self._table.column(run_id)] if run_id else []
        if not found or not all(found):
            return
        combination = pd.factorize(np.array([each[1] for each in found if each], dtype=object))[0]
        repetition = pd.factorize(np.array([each[2] for each in found if each], dtype=object))[0]
        if _distinct(repetition) > 1:
            self._combination, self._repetition = combination, repetition

    @property
    def repetition_in_run_id(self) -> bool:
        """Whether run ids count repetitions."""
        return self._repetition is not None

    def may_count_repetitions(self, name: str) -> bool:
        """Return whether a column could count the runs of each combination."""
        if not self.is_filled(name) or None in map(repetition_number, self.values(name)):
            return False
        if self._combination is not None and self._follows(self._combination, name):
            return False
        if self.differs_everywhere(name):  # it numbers all runs, unless all have one combination
            return not any(
                1 < self._levels(other) <= self._count // 2
                for other in self._table.headings
                if other != name and self.is_filled(other) and not self._names_measure(other)
            )
        return self._levels(name) > 1

    def counts(self, name: str) -> bool:
        """Return whether a column has texts that are numbered from 0 or 1 on, as `set_1` and `set_2`."""
        numbers = sorted(number for each in self.values(name) if (number := repetition_number(each)) is not None)
        is_counted = numbers in [list(range(first, first + self._levels(name))) for first in (0, 1)]
        return is_counted and not self.is_numeric(name)

    def tells_runs_apart(self, name: str, factors: Sequence[str]) -> bool:
        """Return whether the runs of each combination have values of their own in a column."""
        return _pairs(self._combined(factors), self._codes(name)) >= _TELLING * self._count

    # Verdicts.

    def is_treatment_text(self, name: str) -> bool:
        """Return whether a column has a few texts that repeat."""
        if name in self._table.unnamed or self.is_numeric(name) or not self.is_filled(name):
            return False
        return 1 < self._levels(name) <= max(2, self._count // 2) and self._is_even(name) and not self._varies(name)

    def is_part_of(self, name: str, texts: Sequence[str]) -> bool:
        """Return whether a column has a few texts, each of which goes with some of another column's."""
        if self.is_numeric(name) or not self.is_filled(name) or not 1 < self._levels(name) <= self._count // 2:
            return False
        return any(self._follows(self._codes(text), name) for text in texts if self._levels(text) > self._levels(name))

    def follow(self, factors: Sequence[str], name: str) -> bool:
        """Return whether all runs of a combination have one value of a column, and combinations have several runs."""
        combined = self._combined(factors)
        return 2 * _distinct(combined) <= self._count and self._follows(combined, name)

    def _varies(self, name: str) -> bool:
        """Return whether values differ between repetitions of a combination that run ids tell."""
        return self._combination is not None and not self._follows(self._combination, name)

    def is_surely_measured(self, name: str) -> bool:
        """Return whether treatments do not come after this column, in the tables of the earlier tools."""
        if not self.is_measurable(name) or self._levels(name) == 1:
            return self.is_empty(name) and self._names_measure(name)
        if self._combination is not None:
            return self._varies(name)
        differs = 2 * self._levels(name) > self._count and not self._are_epochs(name)
        return differs and (self._is_decimal(name) or self._names_measure(name)) and not self._is_planned(name)

    def _is_planned(self, name: str) -> bool:
        """Return whether a column is filled in runs that are still to do, as treatments are and measures are not."""
        return self.is_filled(name) and not self._is_decimal(name) and any(map(self.is_empty, self._table.headings))

    def verdict(self, name: str, factors: Sequence[str], repetition: str | None, *, is_first: bool) -> Verdict:
        """Return what a column is.

        Args:
            name: the column.
            factors: those that are taken for factors already, and the texts that will be.
            repetition: the column that counts repetitions, or None.
            is_first: whether no column before it is surely measured.
        """
        others = [each for each in factors if each != name]
        return next(self._verdicts(name, others, repetition, is_first=is_first))

    # Of the verdicts below the first one counts.

    def _verdicts(
        self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool
    ) -> Iterator[Verdict]:
        if name in self._table.unnamed:
            yield Role.TEXT, Confidence.SURE, "it has no heading"
        if self.is_empty(name):
            yield Role.MEASURE, Confidence.LIKELY, "it is empty so far"
        if self._levels(name) == 1 < self._count:
            yield self._constant(name, is_first=is_first)
        if self._table.is_boolean(name):
            yield self._of_truth_values(name, is_first=is_first)
        if self.is_numeric(name):
            yield from self._numbers(name, others, repetition, is_first=is_first)
        yield from self._texts(name, is_first=is_first)

    def _constant(self, name: str, *, is_first: bool) -> Verdict:
        if self.is_measurable(name) and (self._names_measure(name) or not is_first):
            return Role.MEASURE, Confidence.LIKELY, "the same value in all runs"
        return (Role.FACTOR if is_first else Role.TEXT), Confidence.LIKELY, "the same in all runs"

    def _of_truth_values(self, name: str, *, is_first: bool) -> Verdict:
        """Return what a column of truth values is."""
        if self._varies(name) or not self.is_filled(name) or (self._names_measure(name) and not is_first):
            return Role.MEASURE, Confidence.SURE, "truth values that runs brought"
        if is_first:
            return Role.FACTOR, Confidence.SURE, "truth values before the measures"
        even = self._is_even(name)
        return (Role.FACTOR if even else Role.MEASURE), Confidence.LIKELY, "truth values after the measures"

    def _texts(self, name: str, *, is_first: bool) -> Iterator[Verdict]:
        levels = self._levels(name)
        if self._count == 1:
            yield Role.FACTOR, Confidence.LIKELY, "a text, in the one run"
        if not self.is_filled(name):
            yield Role.TEXT, Confidence.LIKELY, "text that some runs lack"
        if all(map(_MOMENT.fullmatch, self.values(name))):
            yield Role.TEXT, Confidence.SURE, "moments"
        if self._varies(name):
            yield Role.TEXT, Confidence.SURE, "text that differs between the repetitions of a combination"
        if levels > max(2, self._count // 2):
            yield Role.TEXT, Confidence.LIKELY, "text that differs in most runs"
        words = f"{levels} texts, each {'about ' * (not self._is_equal(name))}equally often"
        if self._combination is not None and is_first:
            yield Role.FACTOR, Confidence.SURE, f"{levels} texts, the same in all repetitions of a combination"
        if self._is_even(name):
            yield Role.FACTOR, (Confidence.SURE if is_first else Confidence.LIKELY), words
        if is_first:
            yield Role.FACTOR, Confidence.LIKELY, f"{levels} texts that repeat, though unevenly"
        yield Role.TEXT, Confidence.LIKELY, "text after the measures that repeats unevenly"

    def _is_equal(self, name: str) -> bool:
        return len(set(np.bincount(self._codes(name)).tolist())) == 1

    def _numbers(
        self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool
    ) -> Iterator[Verdict]:
        levels, named = self._levels(name), self._names_measure(name)
        if self.differs_everywhere(name) and _NUMBERING.fullmatch(name) and not self._is_decimal(name):
            yield Role.TEXT, Confidence.SURE, "it numbers the rows"
        if self._are_epochs(name):
            yield Role.TEXT, Confidence.SURE, "moments, counted since 1970"
        if self._count == 1:
            yield Role.MEASURE, Confidence.LIKELY, "a number, in the one run"
        if self._varies(name) or self._differs_between_repetitions(name, others, repetition):
            yield Role.MEASURE, Confidence.SURE, "it differs between the repetitions of a combination"
        if not self.is_filled(name):
            yield Role.MEASURE, (Confidence.SURE if named else Confidence.LIKELY), "numbers that some runs lack"
        if is_first and self._combination is not None:
            doubt = Confidence.LIKELY if named else Confidence.SURE
            yield Role.FACTOR, doubt, f"{levels} numbers, the same in all repetitions of a combination"
        if is_first and self._is_planned(name):
            yield Role.FACTOR, Confidence.LIKELY, "it is filled in runs that are still to do"
        if 2 * levels > self._count:
            sure = named or self._is_decimal(name)
            yield Role.MEASURE, (Confidence.SURE if sure else Confidence.LIKELY), "numbers that differ in most runs"
        yield self._few_numbers(name, levels, is_first=is_first, named=named)

    def _few_numbers(self, name: str, levels: int, *, is_first: bool, named: bool) -> Verdict:
        """Return what a column of numbers is that repeat, where nothing tells which runs have one combination."""
        even = self._is_even(name)
        if is_first and even and levels <= _MANY_TREATMENTS:
            return Role.FACTOR, (Confidence.LIKELY if named else Confidence.SURE), f"{levels} numbers, evenly repeated"
        if not is_first or named or levels > _MANY_TREATMENTS:
            doubt = Confidence.SURE if named else Confidence.LIKELY
            if even and not named and levels <= _MANY_TREATMENTS:
                return Role.FACTOR, Confidence.UNSURE, f"{levels} numbers after the measures, evenly repeated"
            return Role.MEASURE, doubt, f"{levels} numbers, {'evenly' if even else 'unevenly'} repeated"
        role = Role.MEASURE if self._is_decimal(name) else Role.FACTOR
        return role, Confidence.UNSURE, f"{levels} numbers before the measures, unevenly repeated"

    def _differs_between_repetitions(self, name: str, others: Sequence[str], repetition: str | None) -> bool:
        """Return whether a column differs between repetitions of a combination that is known without it.

        Then it is measured. Measured numbers repeat, too, where they are few or round.
        """
        which = self._repetition if repetition is None else self._codes(repetition)
        if which is None:
            return False
        combined = self._combined(others)
        return _pairs(combined, which) == self._count and not self._follows(combined, name)

    # Factors among each other.

    def could_be_only_factor(self, name: str) -> bool:
        """Return whether texts that differ in all runs can be the treatments of the one factor."""
        return name not in self._table.unnamed and self.is_filled(name) and not self.is_numeric(name)

    def crosses(self, name: str, others: Sequence[str]) -> bool:
        """Return whether each value of a column has every combination of the others."""
        combined = self._combined(others)
        return _pairs(combined, self._codes(name)) == _distinct(combined) * self._levels(name)

    def aliases(
        self, factors: Sequence[str], free: Sequence[str], late: Collection[str]
    ) -> Iterator[tuple[str, Confidence, str]]:
        """Yield each factor that says nothing of its own, how sure that is, and why.

        Args:
            factors: all factors.
            free: those that may go.
            late: those that come after measures.
        """
        left = [name for name in factors if self._levels(name) > 1]
        for name in [each for each in left if each in free]:
            parts = [each for each in left if each != name and self._follows(self._codes(name), each)]
            parts = [each for each in parts if self._levels(each) < self._levels(name)]
            if len(parts) > 1 and self._follows(self._combined(parts), name):
                left.remove(name)
                yield name, Confidence.LIKELY, f"it names the combination of {' and '.join(parts)}"
        for name in sorted(
            (each for each in left if each in free), key=lambda each: (not _is_id(each), -left.index(each))
        ):
            for other in left:
                repeats = 2 * self._levels(other) <= self._count
                if other == name or name not in left or not repeats or not self._follows(self._codes(other), name):
                    continue
                is_unit = other in free and name not in late and _UNITS.search(other.casefold())
                if is_unit and self._levels(other) > self._levels(name):
                    left.remove(other)
                    yield other, Confidence.UNSURE, f"each {other} has one {name}: which of the two is the factor?"
                else:
                    left.remove(name)
                    yield name, Confidence.LIKELY, f"each {other} has one {name}"
                break


def _is_id(name: str) -> bool:
    return bool(_NUMBERING.fullmatch(name))


def _distinct(codes: Codes) -> int:
    return len(np.unique(codes))


def _pairs(first: Codes, second: Codes) -> int:
    """Return how many pairs of codes there are."""
    return _distinct(first * (int(second.max(initial=0)) + 1) + second)
