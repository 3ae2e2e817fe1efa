"""The role of a column by its values and its heading, with confidence and reason: the first reason that applies."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from robot_runner.analysis.importing.column_evidence import (
    NUMBERING,
    THIS_CENTURY,
    TREATMENTS,
    ColumnEvidence,
    Confidence,
    Role,
    Verdict,
    are_even,
)

#: Units of study, to which treatments are applied: where each unit has one treatment, the treatment is the factor.
_UNITS = re.compile(r"subject|participant|person|website|device|robot|room|app|phone|host|machine")
#: Headings of what names a combination of treatments, also in numbers.
_COMBINATIONS = re.compile(
    rf"(.*[_ .-])?({TREATMENTS.pattern}|(setup|combination|variant|scenario|mission|experiment|design|case|cell)s?|"
    r"config\w*|code)",
    re.IGNORECASE,
)
#: A date of any order, with a time of day: `2025-10-21T19:04:27`, `12/22/2024 18:04`, `22 Dec 2024, 6:04 PM`.
_MOMENT = re.compile(
    r"(\d{4}([-/.])\d\d?\2\d\d?|\d\d?([-/.])\d\d?\3\d{2,4}|\d\d?[ -][a-z]{3,9}\.?[ -]\d{4})[t ,]+\d\d?:\d\d.*",
    re.IGNORECASE,
)
#: A day without a time of day: `2025-10-21`, `12/22/2024`, `1.5.2024`; `2024.1.0` is a version.
_DAY = re.compile(r"\d{4}([-/])\d\d?\1\d\d?|\d{4}\.\d\d\.\d\d|\d\d?([-/.])\d\d?\2\d{4}")
#: A duration in hours, minutes and seconds, and the headings that tell it from a time of day.
_CLOCKED = re.compile(r"(\d+:)?\d+:\d\d([.,]\d+)?")
_DURATION = re.compile(r"duration|elapsed|runtime|latency|makespan|dauer|durée|duración", re.IGNORECASE)
#: Units in which moments since 1970 are counted in so large numbers that few measures reach them, in seconds.
_EPOCHS = {"ms": 1e3, "us": 1e6, "ns": 1e9}
_FEWEST_MOMENTS = 5
#: Planned numbers are few: more than these are rarely treatments, however equal their frequencies.
_MANY_TREATMENTS = 12
#: In a table of fewer rows, measured numbers are easily as evenly distributed as planned ones.
_FEW_ROWS = 8
#: Planned numbers differ clearly: where the largest is less than so many times the smallest, they are rather measured.
_CLOSE = 1.1
#: Words of what is set as often as it is measured.
_SET = re.compile(r"volt|temp|freq|rate|distance|max|min", re.IGNORECASE)
#: The points of the scales of questionnaires, which count from 1 or 0.
_POINTS_OF_SCALES = frozenset({5, 7, 9, 10, 11})
#: With so few, an incomplete set of combinations may look like repetitions of combinations without one factor.
_FEW_REPETITIONS = 2


class ColumnVerdicts(ColumnEvidence):
    """The verdicts on the columns of one table.

    Example:
        >>> ColumnVerdicts(table).verdict("speed", ["task"], "rep", is_first=True)  # doctest: +SKIP
        (<Role.FACTOR: 'factor'>, <Confidence.SURE: 'sure'>, '3 numbers, evenly repeated')
    """

    def is_treatment_text(self, name: str) -> bool:
        """Return whether a column has a few texts that repeat."""
        if name in self.table.unnamed or self.is_numeric(name) or not self.is_filled(name):
            return False
        is_few = 1 < self.levels(name) <= max(2, self.count // 2) and self.is_even(name) and not self.varies(name)
        return is_few and not self._are_moments(name)

    def could_be_only_factor(self, name: str) -> bool:
        """Return whether texts that differ in most runs can be the treatments of the only factor."""
        if name in self.table.unnamed or self.is_numeric(name) or not self.is_filled(name) or self.levels(name) == 1:
            return False
        return not self._are_moments(name)

    def _are_moments(self, name: str) -> bool:
        return all(map(_MOMENT.fullmatch, self.values(name)))

    def is_surely_measured(self, name: str) -> bool:
        """Return whether no treatments come after this column, as in the tables of earlier tools."""
        if NUMBERING.fullmatch(name) and self.differs_everywhere(name):
            return False
        if not self.is_measurable(name) or self.levels(name) == 1:
            return self.is_empty(name) and self.names_measure(name)
        if self.knows_combinations:
            return self.varies(name)
        differs = 2 * self.levels(name) > self.count and not self.are_epochs(name)
        return differs and (self.is_decimal(name) or self.names_measure(name)) and not self._is_planned(name)

    def _is_planned(self, name: str) -> bool:
        """Return whether a column has values in runs that are still to do: treatments do, measures do not."""
        if self.is_over or not self.is_filled(name) or self.is_decimal(name):
            return False
        others = self.table.headings
        is_measured = any(self.is_decimal(each) and 2 * self.levels(each) > self.count for each in others)
        return not is_measured and any(map(self.is_empty, others))

    def _is_even_among(self, name: str, others: Sequence[str]) -> bool:
        """Return whether values of a column occur about equally often with each value of any other, as if planned.

        Combinations that were left out on purpose are missing altogether, and the others are about equally frequent.
        """
        own, levels = self._codes(name), self.levels(name)
        for other in others:
            theirs = self._codes(other)
            is_free = not self._follows(own, other) and not self._follows(theirs, name)
            counts = np.bincount(theirs * levels + own, minlength=self.levels(other) * levels)
            there = counts[counts > 0]
            is_planned = are_even(there) and (there.min() > 1 or there.max() == 1)
            if is_free and not are_even(counts) and not is_planned:
                return False
        return True

    def contradict_run_ids(self, run_id: str | None) -> bool:
        """Forget the combinations that run ids name where columns have as many of their own, and none agrees.

        A config of the earlier tools may apply treatments of its own in the place of those that the tool planned.

        Returns:
            Whether it is so.
        """
        names = [name for name in self.table.headings if name != run_id and name not in self.table.unnamed]
        names = [name for name in names if self.is_filled(name) and 1 < self.levels(name) <= self.count // 2]
        if self._combination is None or any(self._follows(self._combination, name) for name in names):
            return False
        planned = [name for name in names if self.is_even(name) and not self.names_measure(name)]
        planned = [
            name
            for name in planned
            if not self.is_numeric(name) or (not self.is_decimal(name) and self.levels(name) <= _MANY_TREATMENTS)
        ]
        count = len(set(self._combination.tolist()))
        if not planned or len(set(self._combined(planned).tolist())) != count:
            return False
        self._combination = self._repetition = None
        return True

    def _grow_like_moments(self, name: str) -> str | None:
        """Return why numbers that grow from row to row are rather moments since 1970, or None."""
        numbers = [self.table.number(cell) for cell in self.table.column(name)]
        found = [number for number in numbers if number is not None]
        if len(found) < _FEWEST_MOMENTS or not all(first < second for first, second in pairwise(found)):
            return None
        earliest, latest = THIS_CENTURY
        for unit, parts in _EPOCHS.items():
            if earliest * parts <= found[0] <= found[-1] <= latest * parts:
                first = datetime.fromtimestamp(found[0] / parts, UTC)
                return f"its numbers grow from row to row like moments in {unit} since 1970 (from {first:%Y-%m-%d})"
        return None

    def verdict(self, name: str, factors: Sequence[str], repetition: str | None, *, is_first: bool) -> Verdict:
        """Return the verdict on a column.

        Args:
            name: the column.
            factors: the columns that are already taken as factors, and the texts that will be.
            repetition: the column that counts repetitions, or None.
            is_first: whether no column before it is surely measured.
        """
        others = [each for each in factors if each != name]
        return next(self._verdicts(name, others, repetition, is_first=is_first))

    # The first of these verdicts counts.

    def _verdicts(
        self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool
    ) -> Iterator[Verdict]:
        if name in self.table.unnamed:
            yield Role.TEXT, Confidence.SURE, "it has no heading"
        if self.is_empty(name):
            yield Role.MEASURE, Confidence.LIKELY, "it is empty so far"
        if self.levels(name) == 1 < self.count:
            yield self._constant(name, is_first=is_first)
        yield from self._dates_and_durations(name, others, repetition)
        if self.table.has_answers(name):
            yield self._of_truth_values(name, others, repetition, is_first=is_first)
        if self.is_numeric(name):
            yield from self._numbers(name, others, repetition, is_first=is_first)
        differs = self.differs_between_repetitions(name, self.without_outcomes(name, others), repetition)
        if not is_first and differs and self.is_treatment_text(name):
            yield Role.TEXT, Confidence.UNSURE, "text after the measures that differs between repetitions: an outcome?"
        yield from self._texts(name, is_first=is_first)

    def _dates_and_durations(self, name: str, others: Sequence[str], repetition: str | None) -> Iterator[Verdict]:
        """Yield a verdict on days, unless they are blocks that have every combination, and on `00:12:34`."""
        filled = [value for value in self.values(name) if value]
        if all(map(_DAY.fullmatch, filled)):
            if not self.crosses(name, others) or self.differs_between_repetitions(name, others, repetition):
                yield Role.TEXT, Confidence.LIKELY, "dates"
        elif _DURATION.search(name) and all(map(_CLOCKED.fullmatch, filled)) and not self.is_treatment_text(name):
            reason = f"durations such as {filled[0]}, which are not read as numbers: write them in seconds?"
            yield Role.TEXT, Confidence.UNSURE, reason

    def _constant(self, name: str, *, is_first: bool) -> Verdict:
        if self.is_measurable(name) and (self.names_measure(name) or not is_first):
            return Role.MEASURE, Confidence.LIKELY, "the same value in all runs"
        return (Role.FACTOR if is_first else Role.TEXT), Confidence.LIKELY, "the same in all runs"

    def _of_truth_values(self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool) -> Verdict:
        """Return the verdict on a column of truth values."""
        differs = self.differs_between_repetitions(name, self.without_outcomes(name, others), repetition)
        if differs and not is_first:
            return Role.MEASURE, Confidence.SURE, "it differs between the repetitions of a combination"
        if self.varies(name) or not self.is_filled(name) or (self.names_measure(name) and not is_first):
            return Role.MEASURE, Confidence.SURE, "truth values that runs brought"
        if is_first and differs and repetition is not None and self.levels(repetition) > _FEW_REPETITIONS:
            return Role.FACTOR, Confidence.UNSURE, "truth values that differ between repetitions: an outcome?"
        if is_first:
            doubt = (Confidence.UNSURE, ": an outcome?") if self.names_outcome(name) else (Confidence.SURE, "")
            return Role.FACTOR, doubt[0], f"truth values before the measures{doubt[1]}"
        if self.is_even(name):
            return Role.FACTOR, Confidence.UNSURE, "truth values after the measures, about equally often"
        return Role.MEASURE, Confidence.LIKELY, "truth values after the measures"

    def _texts(self, name: str, *, is_first: bool) -> Iterator[Verdict]:
        levels = self.levels(name)
        if self.count == 1:
            yield Role.FACTOR, Confidence.LIKELY, "a text, in the one run"
        if not self.is_filled(name):
            yield self._of_gaps(name, is_first=is_first)
        if self._are_moments(name):
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

    def _of_gaps(self, name: str, *, is_first: bool) -> Verdict:
        """Return the verdict on a text that some runs lack."""
        if is_first and (rows := self._rows_of_merged_cells(name)):
            reason = f"text in the first of {rows} rows alone, as merged cells are saved: fill it down"
            return Role.TEXT, Confidence.UNSURE, reason
        is_few = self.levels(name) <= max(2, self.count // 2)
        if is_first and is_few and self.is_even(name) and not self.varies(name):
            return Role.FACTOR, Confidence.UNSURE, "text that as many runs lack: is an empty cell a treatment?"
        return Role.TEXT, Confidence.LIKELY, "text that some runs lack"

    def _rows_of_merged_cells(self, name: str) -> int:
        """Return how many rows each filled cell stands for, if all stand at equal distances; 0 otherwise."""
        filled = [place for place, cell in enumerate(self.table.column(name)) if cell]
        rows = filled[1] if len(filled) > 1 else 0
        return rows if rows > 1 and filled == list(range(0, self.count, rows)) else 0

    def _numbers(
        self, name: str, others: Sequence[str], repetition: str | None, *, is_first: bool
    ) -> Iterator[Verdict]:
        levels, named = self.levels(name), self.names_measure(name)
        yield from self._numbers_of_rows(name, others)
        if self.are_epochs(name):
            yield Role.TEXT, Confidence.SURE, "moments, counted since 1970"
        if (moments := self._grow_like_moments(name)) is not None:
            yield Role.MEASURE, Confidence.UNSURE, moments
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
        if repetition is None and is_first and levels <= _MANY_TREATMENTS and self.is_even(name):
            yield from self._unplanned(name, levels, others)
        yield self._few_numbers(name, levels, others, is_first=is_first, named=named)

    def _numbers_of_rows(self, name: str, others: Sequence[str]) -> Iterator[Verdict]:
        if self.differs_everywhere(name) and NUMBERING.fullmatch(name) and not self.is_decimal(name):
            yield Role.TEXT, Confidence.SURE, "it numbers the rows"
        is_before = any(self.places[name] <= self.places[each] for each in others)
        if is_before and self.knows_combinations and self.counts_rows(name):
            yield Role.TEXT, Confidence.UNSURE, "it counts the rows: numbers of runs, or measured?"

    def _unplanned(self, name: str, levels: int, others: Sequence[str]) -> Iterator[Verdict]:
        """Yield a doubt about numbers before the measures that may have come of the runs themselves."""
        told = f"{levels} numbers, evenly repeated"
        numbers = [number for value in self.values(name) if (number := self.table.number(value)) is not None]
        are_close = bool(numbers) and 0 < max(numbers) < _CLOSE * min(numbers)
        are_answers = levels in _POINTS_OF_SCALES and self.counts(name) and not self.has_unit(name)
        if (are_close or are_answers) and not self._is_even_among(name, others):
            yield Role.FACTOR, Confidence.UNSURE, f"{told}, but not with each value of other factors: measured?"
        # Where other factors tell all runs apart, the plan has no place for one more.
        is_odd = are_close or len(set(self._combined(others).tolist())) == self.count
        if is_odd and self.is_called_measured(name) and not _SET.search(name) and self.count < _FEW_ROWS:
            yield Role.FACTOR, Confidence.UNSURE, f"{told} in few rows: measured?"

    def _few_numbers(self, name: str, levels: int, others: Sequence[str], *, is_first: bool, named: bool) -> Verdict:
        """Return the verdict on numbers that repeat, where nothing tells the combinations of runs."""
        even = self.is_even(name)
        are_names = NUMBERING.fullmatch(name) or levels > _MANY_TREATMENTS
        # Numbers that other factors determine, as the length of each scenario's path, are as equally frequent as these.
        are_planned = levels > _MANY_TREATMENTS and self.is_equal(name) and not self.follow(others, name)
        if even and (are_planned or (are_names and not named and not self.is_decimal(name))):
            reason = f"{levels} numbers, evenly repeated: do they count or name something?"
            return Role.FACTOR, Confidence.UNSURE, reason
        if is_first and even and levels == 2 and self.names_outcome(name):  # noqa: PLR2004 - no and yes
            return Role.FACTOR, Confidence.UNSURE, f"{levels} numbers before the measures: an outcome?"
        if is_first and even and levels <= _MANY_TREATMENTS:
            return Role.FACTOR, (Confidence.LIKELY if named else Confidence.SURE), f"{levels} numbers, evenly repeated"
        if not is_first or named or levels > _MANY_TREATMENTS:
            doubt = Confidence.SURE if named else Confidence.LIKELY
            # Treatments may be in a unit; what came of runs, and counts, are equally frequent by chance.
            is_planned = others and self.has_unit(name) and self.is_balanced(name, others)
            is_planned = is_planned and not (self.is_called_measured(name) and self.count < _FEW_ROWS)
            if (even if not named else is_planned) and levels <= _MANY_TREATMENTS:
                return Role.FACTOR, Confidence.UNSURE, f"{levels} numbers after the measures, evenly repeated"
            return Role.MEASURE, doubt, f"{levels} numbers, {'evenly' if even else 'unevenly'} repeated"
        role = Role.MEASURE if self.is_decimal(name) else Role.FACTOR
        return role, Confidence.UNSURE, f"{levels} numbers before the measures, unevenly repeated"

    def aliases(
        self, factors: Sequence[str], free: Sequence[str], late: Collection[str]
    ) -> Iterator[tuple[str, Role, Confidence, str]]:
        """Yield each factor that follows from others, what it is, the confidence in that, and the reason."""
        left = [name for name in factors if self.levels(name) > 1]
        for name in [each for each in left if each in free]:
            parts = [each for each in left if each != name and self._follows(self._codes(name), each)]
            parts = [each for each in parts if self.levels(each) < self.levels(name)]
            if len(parts) > 1 and self._follows(self._combined(parts), name):
                left.remove(name)
                is_code = self.counts(name) or NUMBERING.fullmatch(name) or _COMBINATIONS.fullmatch(name)
                # A planner that uses no chance finds paths of the same length in all repetitions; what follows from
                # numbers alone, before the measures, is computed, as a total load.
                is_outcome = name in late or (self.names_measure(name) and not all(map(self.is_numeric, parts)))
                is_measured = self.is_numeric(name) and is_outcome and not is_code
                role, told = (Role.MEASURE, "numbers, one for each") if is_measured else (Role.TEXT, "it names the")
                yield name, role, Confidence.LIKELY, f"{told} combination of {' and '.join(parts)}"
        for name in sorted(
            (each for each in left if each in free), key=lambda each: (not NUMBERING.fullmatch(each), -left.index(each))
        ):
            for other in left:
                repeats = 2 * self.levels(other) <= self.count
                if other == name or name not in left or not repeats or not self._follows(self._codes(other), name):
                    continue
                is_named = _UNITS.search(other.casefold()) or TREATMENTS.fullmatch(name)
                is_unit = other in free and name not in late and is_named
                if is_unit and self.levels(other) > self.levels(name):
                    left.remove(other)
                    reason = f"each {other} has one {name}: which of the two is the factor?"
                    yield other, Role.TEXT, Confidence.UNSURE, reason
                else:
                    left.remove(name)
                    yield name, Role.TEXT, Confidence.LIKELY, f"each {other} has one {name}"
                break
