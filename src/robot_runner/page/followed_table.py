"""The journal followed as it grows, the run table updated by it, and its means so far."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.design.repeated_intervals import CONFIDENCE, half_width_of
from robot_runner.core.storage.cells import ENDS, RunStatus
from robot_runner.core.storage.declared_shapes import faults_of, parsed_json
from robot_runner.core.storage.guarded_files import LINE_LIMIT, MissingFileError, open_to_read
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.record_shapes import RECORDS, Record
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import shown_treatment

#: How much is read at once: some 4,000 records, which take 50 ms.
_AT_ONCE = 1_000_000
#: The identity of a removed file: a new one may get the same inode number.
_GONE = (-1, -1)


class JournalTail:
    """Reads what was appended to the journal since the last call.

    A journal that is another file than before, or shorter, is read from its beginning. A line that is not a record is
    counted and skipped, so that the page shows the rest; `robot-runner status` refuses it.

    Args:
        path: the journal, which need not exist yet.

    Attributes:
        damaged: how many lines were skipped.
        is_behind: whether there is more to read at once.
        has_begun_anew: whether the last call began from the beginning, so that earlier records are void.
    """

    def __init__(self, path: Path) -> None:
        self.damaged = 0
        self.is_behind = False
        self.has_begun_anew = False
        self._path = path
        self._file: tuple[int, int] | None = None
        self._offset = 0
        self._size = 0

    def read(self) -> list[dict[str, Any]]:
        """Return the records that came since, the oldest first; not all of them where `is_behind`.

        Raises:
            StorageError: the journal cannot be read.
        """
        self.has_begun_anew = False
        try:
            found = self._path.lstat()
        except OSError:  # missing, or not accessible, which opening reports
            if self._file is not None:
                self._file = _GONE
            return []
        if self._file == (found.st_dev, found.st_ino) and found.st_size == self._size and not self.is_behind:
            return []
        if self._file != (found.st_dev, found.st_ino) or found.st_size < self._offset:
            self.has_begun_anew = self._file is not None
            self._offset = self.damaged = 0
        self._file, self._size = (found.st_dev, found.st_ino), found.st_size
        return [record for line in self._lines() if (record := self._parsed(line)) is not None]

    @property
    def share(self) -> float:
        """How much of the journal was read, as a share, 0 to 1."""
        return self._offset / self._size if self._size else 0.0

    def _lines(self) -> list[bytes]:
        try:
            with storage_errors(self._path, "read"), open_to_read(self._path) as file:
                file.seek(self._offset)
                block = file.read(_AT_ONCE)
                if b"\n" not in block and len(block) == _AT_ONCE:
                    block += file.readline(LINE_LIMIT)
        except MissingFileError:
            return []
        end = block.rfind(b"\n") + 1
        if not end and len(block) > LINE_LIMIT:  # no line of ours: skip it
            end = len(block)
        self._offset += end
        self.is_behind = bool(end) and self._offset < self._size
        return block[:end].splitlines()

    def _parsed(self, line: bytes) -> dict[str, Any] | None:
        record: dict[str, Any] | None
        try:
            record = parsed_json(line.decode())
        except (ValueError, RecursionError):
            record = None
        kind = record.get("kind") if isinstance(record, dict) else None
        if not isinstance(kind, str) or faults_of(record, RECORDS.get(kind, Record)):
            self.damaged += 1
            return None
        return record


#: The words for statuses on the page.
_WORDS = {RunStatus.TODO: "to do", RunStatus.RUNNING: "running", RunStatus.DONE: "done", RunStatus.FAILED: "failed"}
#: A larger table (more than some 300,000 runs) is not shown, bytes.
_MOST_BYTES = 64_000_000
#: How many characters of a text in a cell are shown.
_LONGEST = 200


class FollowedTable:
    """The rows of a run table, updated by the journal's records. Places count its runs from 0.

    Attributes:
        run_ids: in the order of the table.
        statuses: of each run, by place.
        treatments: of each run in words, by place.
        values: the measures of each run, by place; None for a missing one.
        doubtful: the names of measures with doubtful values, by place.
        factors, measures, units: of the table's columns; units by measure.
        warm_ups: the places of runs that only warm up.
        changed: the places of rows that changed since it was emptied last.
    """

    def __init__(self) -> None:
        self.run_ids: list[str] = []
        self.statuses: list[RunStatus] = []
        self.treatments: list[tuple[str, ...]] = []
        self.values: list[tuple[Any, ...]] = []
        self.doubtful: dict[int, tuple[str, ...]] = {}
        self.factors: tuple[str, ...] = ()
        self.measures: tuple[str, ...] = ()
        self.units: dict[str, str] = {}
        self.warm_ups: frozenset[int] = frozenset()
        self.changed: set[int] = set()
        self._places: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self.run_ids)

    def place(self, run_id: str) -> int | None:
        """Return the place of a run; None for one that the table does not have."""
        return self._places.get(run_id)

    def combination(self, run_id: str) -> dict[str, str]:
        """Return the treatments of a run in words, by factor; empty for one that the table does not have."""
        place = self.place(run_id)
        return {} if place is None else dict(zip(self.factors, self.treatments[place], strict=True))

    def read(self, files: ExperimentFolder) -> RunTableRows | None:
        """Read the table from the disk; None where there is none yet, or it is too large to be shown.

        Raises:
            StorageError: it cannot be read.
        """
        if not (files.run_table.is_file() and files.schema.is_file()) or self.is_too_large(files):
            return None
        described = read_schema(files.schema)
        rows = read_run_table(files.run_table, TableLayout.of_schema(described))
        layout = rows.layout
        planned = list(rows.planned)
        self.units = {each.name: each.unit for each in described if each.name in layout.measures}
        self.factors = (*layout.factor_names, *(("Repetition",) if layout.has_repetition else ()))
        self.measures = layout.measures
        self.run_ids = [run.run_id for run in planned]
        self._places = {run_id: place for place, run_id in enumerate(self.run_ids)}
        self.warm_ups = frozenset(place for place, run in enumerate(planned) if run.is_warm_up)
        repetitions = ([(str(run.repetition),) for run in planned]) if layout.has_repetition else [()] * len(planned)
        self.treatments = [
            # An empty cell is the treatment "": a factor's cell is never missing.
            (
                *(shown_treatment("" if each is None else each)[:_LONGEST] for each in run.combination.treatments),
                *repetition,
            )
            for run, repetition in zip(planned, repetitions, strict=True)
        ]
        self.statuses = [rows.status(place) for place in range(len(rows))]
        columns = [map(_shown, rows.values(name)) for name in layout.measures]
        self.values = list(zip(*columns, strict=True)) if columns else [()] * len(rows)
        self.changed = set()
        return rows

    @staticmethod
    def is_too_large(files: ExperimentFolder) -> bool:
        """Return whether the table on disk is too large to be shown."""
        return files.run_table.is_file() and files.run_table.stat().st_size > _MOST_BYTES

    def begin(self, run_id: str) -> None:
        """Note that an attempt at a run has begun."""
        place = self._places.get(run_id)
        if place is not None:
            self.statuses[place] = RunStatus.RUNNING
            self.changed.add(place)

    def leave(self, run_id: str) -> None:
        """Note that a run that had begun is not executed any more."""
        place = self._places.get(run_id)
        if place is not None and self.statuses[place] is RunStatus.RUNNING:
            self.statuses[place] = RunStatus.TODO
            self.changed.add(place)

    def end(self, record: Mapping[str, Any]) -> None:
        """Note how an attempt ended, and its measures."""
        place = self._places.get(record["run"])
        if place is None:
            return
        self.statuses[place] = ENDS.get(record["status"], RunStatus.TODO)
        told = record["measures"]
        self.values[place] = tuple(_shown(told[name]["value"]) if name in told else None for name in self.measures)
        self.doubt(record)
        self.changed.add(place)

    def doubt(self, record: Mapping[str, Any]) -> None:
        """Note which values of an attempt that ended are doubtful."""
        place = self._places.get(record["run"])
        doubted = tuple(name for name in self.measures if record["measures"].get(name, {}).get("doubts"))
        if place is not None and (doubted or place in self.doubtful):
            self.doubtful[place] = doubted

    def row(self, place: int) -> list[Any]:
        """Return a row as plain data: place, id, status, treatments, values, and which of them are doubtful."""
        return [
            place,
            self.run_ids[place],
            _WORDS[self.statuses[place]],
            list(self.treatments[place]),
            list(self.values[place]),
            list(self.doubtful.get(place, ())),
        ]

    def found(self, status: str = "", text: str = "") -> Iterator[int]:
        """Yield the places of rows with this status, and this text in id or treatments; empty arguments match all."""
        wanted = text.casefold()
        for place, run_id in enumerate(self.run_ids):
            if status and _WORDS[self.statuses[place]] != status:
                continue
            if not wanted or wanted in run_id.casefold() or wanted in " ".join(self.treatments[place]).casefold():
                yield place


def _shown(value: Any) -> Any:
    """Return a value for the page: a number that is not finite is missing, a long text is cut."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value[:_LONGEST] if isinstance(value, str) else value


#: Factors with more treatments have no means on the page.
_MOST_TREATMENTS = 40
#: The largest number of measures with means on the page.
_MOST_MEASURES = 24
_COMBINATION = "Combination"


class MeansSoFar:
    """Means and intervals, computed again only for treatments with a changed run.

    The intervals hold for a single look at the end: with a look after each run, and stopping at will, they cover in
    less than 95 % of cases, as the page says.

    Args:
        table: its runs count that are done, not excluded, and no warm-up; doubtful values by the analysis plan.
    """

    def __init__(self, table: FollowedTable) -> None:
        self._table = table
        self._known: dict[tuple[int, ...], dict[tuple[str, ...], list[int]]] = {}
        self._cells: dict[tuple[tuple[int, ...], tuple[str, ...]], list[list[Any]]] = {}
        self._groupings: list[tuple[str, tuple[int, ...]]] = []
        self._leaves_out_doubtful = False

    def begin_anew(self, files: ExperimentFolder) -> None:
        """Group the runs again, after the table was read again."""
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
        """Drop the means of the treatments of these runs, so that they are computed again."""
        for run in places:
            for _, grouping in self._groupings:
                self._cells.pop((grouping, self._key(run, grouping)), None)

    def told(self, excluded: Collection[int]) -> list[dict[str, Any]]:
        """Return the means as plain data, a mapping for each factor, and for all of them together.

        Measures without numbers, such as booleans and texts, are left out.

        Args:
            excluded: the places of excluded runs.
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
        """Return the number of values, their mean, and half the width of its interval."""
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
        except (ArithmeticError, ValueError):  # no values, or absurdly large ones
            return [len(values), None, None]
        return [len(values), *(each if each is not None and math.isfinite(each) else None for each in (mean, width))]
