"""Means of the runs that are done so far, for each treatment of each factor, with Student's intervals."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.design.repeated_intervals import CONFIDENCE, half_width_of
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.manifest import read_manifest

if TYPE_CHECKING:
    from robot_runner.core.storage.layout import ExperimentFolder
    from robot_runner.page.followed_table import FollowedTable

#: More treatments than a reader compares; the repetitions of a long experiment are told by nobody.
_MOST_TREATMENTS = 40
#: More measures than a page has room for.
_MOST_MEASURES = 24
_COMBINATION = "Combination"


class MeansSoFar:
    """Means and intervals, computed anew only for treatments of which a run has changed.

    The intervals are those that one look at the end would give. Who looks after each run and stops when it pleases
    has less than 95 %, so the page says so.

    Args:
        table: whose runs are counted: those that are done, not left out, and no warm-up; of a doubtful value what the
            plan of the analysis says.
    """

    def __init__(self, table: FollowedTable) -> None:
        self._table = table
        self._known: dict[tuple[int, ...], dict[tuple[str, ...], list[int]]] = {}
        self._cells: dict[tuple[tuple[int, ...], tuple[str, ...]], list[list[Any]]] = {}
        self._groupings: list[tuple[str, tuple[int, ...]]] = []
        self._leaves_out_doubtful = False

    def begin_anew(self, files: ExperimentFolder) -> None:
        """Group the runs anew: the table was read again."""
        self._cells.clear()
        plan = read_manifest(files.manifest).get("analysis") if files.manifest.exists() else None
        self._leaves_out_doubtful = isinstance(plan, dict) and plan.get("doubtful") == Doubtful.LEAVE_OUT.value
        factors = [place for place, name in enumerate(self._table.factors) if name.casefold() != "repetition"]
        groupings: list[tuple[str, tuple[int, ...]]] = [(self._table.factors[place], (place,)) for place in factors]
        if len(factors) > 1:
            groupings.append((_COMBINATION, tuple(factors)))
        self._known = {places: {} for _, places in groupings}
        for run in range(len(self._table)):
            for places, groups in self._known.items():
                groups.setdefault(self._key(run, places), []).append(run)
        self._groupings = [each for each in groupings if 1 < len(self._known[each[1]]) <= _MOST_TREATMENTS]

    def forget(self, places: Iterable[int]) -> None:
        """Have the means of the treatments that these runs have be computed anew."""
        for run in places:
            for _, grouping in self._groupings:
                self._cells.pop((grouping, self._key(run, grouping)), None)

    def told(self, excluded: Collection[int]) -> list[dict[str, Any]]:
        """Return the means as plain data, a mapping for each factor, and for all of them together.

        A measure of which no run has a number is left out: what is yes or no, or text, has no mean.

        Args:
            excluded: the places of runs that are left out.
        """
        table = self._table
        numeric = [place for place, name in enumerate(table.measures) if not name.endswith(".quality")]
        numeric = numeric[:_MOST_MEASURES]
        told = []
        for name, grouping in self._groupings:
            rows = []
            for treatments, runs in self._known[grouping].items():
                key = (grouping, treatments)
                if key not in self._cells:
                    self._cells[key] = [self._cell(runs, measure, excluded) for measure in numeric]
                rows.append({"treatment": ", ".join(treatments), "cells": self._cells[key]})
            there = [place for place in range(len(numeric)) if any(row["cells"][place][0] for row in rows)]
            rows = [{**row, "cells": [row["cells"][place] for place in there]} for row in rows]
            names = [table.measures[numeric[place]] for place in there]
            measures = [{"name": each, "unit": table.units.get(each, "")} for each in names]
            told.append({"factor": name, "measures": measures, "rows": rows, "confidence": CONFIDENCE})
        return told

    def _key(self, run: int, places: tuple[int, ...]) -> tuple[str, ...]:
        treatments = self._table.treatments[run]
        return tuple(treatments[place] for place in places)

    def _cell(self, runs: list[int], measure: int, excluded: Collection[int]) -> list[Any]:
        """Return how many values there are, their mean, and half the width of its interval."""
        table, name = self._table, self._table.measures[measure]
        values = [
            value
            for run in runs
            if table.statuses[run] is RunStatus.DONE and run not in excluded and run not in table.warm_ups
            if not (self._leaves_out_doubtful and name in table.doubtful.get(run, ()))
            for value in (table.values[run][measure],)
            if isinstance(value, int | float) and not isinstance(value, bool)
        ]
        try:
            mean = math.fsum(values) / len(values)
            width = half_width_of(values, CONFIDENCE) if len(values) > 1 else None
        except (ArithmeticError, ValueError):  # no values, or of a size that no measure has
            return [len(values), None, None]
        return [len(values), *(each if each is not None and math.isfinite(each) else None for each in (mean, width))]
