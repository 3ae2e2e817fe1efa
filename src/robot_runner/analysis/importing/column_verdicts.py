"""What a column is by what its values and its heading show, how sure that is, and why: the first reason that holds."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from robot_runner.analysis.importing.column_evidence import (
    NUMBERING,
    TREATMENTS,
    ColumnEvidence,
    Confidence,
    Role,
    Verdict,
)

_MOMENT = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")
#: Numbers that were planned are few: more than these are seldom treatments, however evenly they come.
_MANY_TREATMENTS = 12
#: With no more, runs of a part of all combinations may look like repetitions of those without one factor.
_FEW_REPETITIONS = 2


class ColumnVerdicts(ColumnEvidence):
    """The verdicts on the columns of one table, by its evidence.

    Example:
        >>> ColumnVerdicts(table).verdict("speed", ["task"], "rep", is_first=True)  # doctest: +SKIP
        (<Role.FACTOR: 'factor'>, <Confidence.SURE: 'sure'>, '3 numbers, evenly repeated')
    """

    def is_treatment_text(self, name: str) -> bool:
        """Return whether a column has a few texts that repeat."""
        if name in self.table.unnamed or self.is_numeric(name) or not self.is_filled(name):
            return False
        return 1 < self.levels(name) <= max(2, self.count // 2) and self.is_even(name) and not self.varies(name)

    def is_surely_measured(self, name: str) -> bool:
        """Return whether treatments do not come after this column, in the tables of the earlier tools."""
        if NUMBERING.fullmatch(name) and self.differs_everywhere(name):
            return False
        if not self.is_measurable(name) or self.levels(name) == 1:
            return self.is_empty(name) and self.names_measure(name)
        if self.knows_combinations:
            return self.varies(name)
        differs = 2 * self.levels(name) > self.count and not self.are_epochs(name)
        return differs and (self.is_decimal(name) or self.names_measure(name)) and not self._is_planned(name)

    def _is_planned(self, name: str) -> bool:
        """Return whether a column is filled in runs that are still to do, as treatments are and measures are not."""
        if self.is_over or not self.is_filled(name) or self.is_decimal(name):
            return False
        return any(map(self.is_empty, self.table.headings))

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
        if name in self.table.unnamed:
            yield Role.TEXT, Confidence.SURE, "it has no heading"
        if self.is_empty(name):
            yield Role.MEASURE, Confidence.LIKELY, "it is empty so far"
        if self.levels(name) == 1 < self.count:
            yield self._constant(name, is_first=is_first)
        if self.has_answers(name):
            yield self._of_truth_values(name, others, repetition, is_first=is_first)
        if self.is_numeric(name):
            yield from self._numbers(name, others, repetition, is_first=is_first)
        differs = self.differs_between_repetitions(name, self.without_outcomes(name, others), repetition)
        if not is_first and differs and self.is_treatment_text(name):
            yield Role.TEXT, Confidence.UNSURE, "text after the measures that differs between repetitions: an outcome?"
        yield from self._texts(name, is_first=is_first)

    def _constant(self, name: str, *, is_first: bool) -> Verdict:
        if self.is_measurable(name) and (self.names_measure(name) or not is_first):
            return Role.MEASURE, Confidence.LIKELY, "the same value in all runs"
        return (Role.FACTOR if is_first else Role.TEXT), Confidence.LIKELY, "the same in all runs"

    def _of_truth_values(self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool) -> Verdict:
        """Return what a column of truth values is."""
        differs = self.differs_between_repetitions(name, self.without_outcomes(name, others), repetition)
        if differs and not is_first:
            return Role.MEASURE, Confidence.SURE, "it differs between the repetitions of a combination"
        if self.varies(name) or not self.is_filled(name) or (self.names_measure(name) and not is_first):
            return Role.MEASURE, Confidence.SURE, "truth values that runs brought"
        if is_first and differs and repetition is not None and self.levels(repetition) > _FEW_REPETITIONS:
            return Role.FACTOR, Confidence.UNSURE, "truth values that differ between repetitions: an outcome?"
        if is_first:
            return Role.FACTOR, Confidence.SURE, "truth values before the measures"
        if self.is_even(name):
            return Role.FACTOR, Confidence.UNSURE, "truth values after the measures, about equally often"
        return Role.MEASURE, Confidence.LIKELY, "truth values after the measures"

    def _texts(self, name: str, *, is_first: bool) -> Iterator[Verdict]:
        levels = self.levels(name)
        if self.count == 1:
            yield Role.FACTOR, Confidence.LIKELY, "a text, in the one run"
        if not self.is_filled(name):
            yield Role.TEXT, Confidence.LIKELY, "text that some runs lack"
        if all(map(_MOMENT.fullmatch, self.values(name))):
            yield Role.TEXT, Confidence.SURE, "moments"
        if self.varies(name):
            yield Role.TEXT, Confidence.SURE, "text that differs between the repetitions of a combination"
        if levels > max(2, self.count // 2):
            yield Role.TEXT, Confidence.LIKELY, "text that differs in most runs"
        words = f"{levels} texts, each {'about ' * (not self.is_equal(name))}equally often"
        if self.knows_combinations and is_first:
            yield Role.FACTOR, Confidence.SURE, f"{levels} texts, the same in all repetitions of a combination"
        if self.is_even(name):
            yield Role.FACTOR, (Confidence.SURE if is_first else Confidence.LIKELY), words
        if is_first:
            yield Role.FACTOR, Confidence.LIKELY, f"{levels} texts that repeat, though unevenly"
        if TREATMENTS.fullmatch(name):
            yield Role.FACTOR, Confidence.LIKELY, "its name, after the measures"
        yield Role.TEXT, Confidence.LIKELY, "text after the measures that repeats unevenly"

    def _numbers(
        self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool
    ) -> Iterator[Verdict]:
        levels, named = self.levels(name), self.names_measure(name)
        if self.differs_everywhere(name) and NUMBERING.fullmatch(name) and not self.is_decimal(name):
            yield Role.TEXT, Confidence.SURE, "it numbers the rows"
        if self.are_epochs(name):
            yield Role.TEXT, Confidence.SURE, "moments, counted since 1970"
        if self.count == 1:
            yield Role.MEASURE, Confidence.LIKELY, "a number, in the one run"
        if self.varies(name) or self.differs_between_repetitions(name, others, repetition):
            yield Role.MEASURE, Confidence.SURE, "it differs between the repetitions of a combination"
        if not self.is_filled(name):
            yield Role.MEASURE, (Confidence.SURE if named else Confidence.LIKELY), "numbers that some runs lack"
        if is_first and self.knows_combinations:
            doubt = Confidence.LIKELY if named else Confidence.SURE
            kind = "numbers" if self.table.is_numeric(name) else "values"
            yield Role.FACTOR, doubt, f"{levels} {kind}, the same in all repetitions of a combination"
        if is_first and self._is_planned(name):
            yield Role.FACTOR, Confidence.LIKELY, "it is filled in runs that are still to do"
        if 2 * levels > self.count:
            sure = named or self.is_decimal(name)
            yield Role.MEASURE, (Confidence.SURE if sure else Confidence.LIKELY), "numbers that differ in most runs"
        yield self._few_numbers(name, levels, is_first=is_first, named=named)

    def _few_numbers(self, name: str, levels: int, *, is_first: bool, named: bool) -> Verdict:
        """Return what a column of numbers is that repeat, where nothing tells which runs have one combination."""
        even = self.is_even(name)
        are_names = NUMBERING.fullmatch(name) or levels > _MANY_TREATMENTS
        if even and are_names and not named and not self.is_decimal(name):
            return (
                Role.FACTOR,
                Confidence.UNSURE,
                f"{levels} numbers, evenly repeated: do they count or name something?",
            )
        if is_first and even and levels <= _MANY_TREATMENTS:
            return Role.FACTOR, (Confidence.LIKELY if named else Confidence.SURE), f"{levels} numbers, evenly repeated"
        if not is_first or named or levels > _MANY_TREATMENTS:
            doubt = Confidence.SURE if named else Confidence.LIKELY
            if even and not named and levels <= _MANY_TREATMENTS:
                return Role.FACTOR, Confidence.UNSURE, f"{levels} numbers after the measures, evenly repeated"
            return Role.MEASURE, doubt, f"{levels} numbers, {'evenly' if even else 'unevenly'} repeated"
        role = Role.MEASURE if self.is_decimal(name) else Role.FACTOR
        return role, Confidence.UNSURE, f"{levels} numbers before the measures, unevenly repeated"
