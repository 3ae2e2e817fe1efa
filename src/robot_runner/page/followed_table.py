"""The run table as a page shows it: its rows as they are on disk, and what the journal told since."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import shown_treatment

#: How the page names what the run table has a sign for.
_WORDS = {RunStatus.TODO: "to do", RunStatus.RUNNING: "running", RunStatus.DONE: "done", RunStatus.FAILED: "failed"}
#: A larger file (more than some 300,000 runs) is not held by a page that only shows it, bytes.
_MOST_BYTES = 64_000_000
#: Of a text in a cell, so many characters are shown.
_LONGEST = 200
_ENDS = {"done": RunStatus.DONE, "failed": RunStatus.FAILED}


class FollowedTable:
    """The rows of a run table, brought up to date by the journal's records.

    Attributes:
        run_ids: in the order of the table.
        statuses: of each run, by place.
        treatments: the factors' treatments of each run in words, by place.
        values: the measures of each run, by place; None for one that is missing.
        doubtful: the names of measures whose values are doubted, by place.
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
        """Return where a run stands, counted from 0; None for one that the table does not have."""
        return self._places.get(run_id)

    def read(self, files: ExperimentFolder) -> RunTableRows | None:
        """Read the table from the disk anew; None where there is none yet, or it is too large to be shown.

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
            (*(shown_treatment(each)[:_LONGEST] for each in run.combination.treatments), *repetition)
            for run, repetition in zip(planned, repetitions, strict=True)
        ]
        self.statuses = [rows.status(place) for place in range(len(rows))]
        columns = [map(_shown, rows.values(name)) for name in layout.measures]
        self.values = list(zip(*columns, strict=True)) if columns else [()] * len(rows)
        self.changed = set()
        return rows

    @staticmethod
    def is_too_large(files: ExperimentFolder) -> bool:
        """Return whether the table on disk is larger than what is shown."""
        return files.run_table.is_file() and files.run_table.stat().st_size > _MOST_BYTES

    def begin(self, run_id: str) -> None:
        """Take down that an attempt at a run has begun."""
        place = self._places.get(run_id)
        if place is not None:
            self.statuses[place] = RunStatus.RUNNING
            self.changed.add(place)

    def leave(self, run_id: str) -> None:
        """Take down that nobody executes a run any longer that had begun."""
        place = self._places.get(run_id)
        if place is not None and self.statuses[place] is RunStatus.RUNNING:
            self.statuses[place] = RunStatus.TODO
            self.changed.add(place)

    def end(self, record: Mapping[str, Any]) -> None:
        """Take down how an attempt ended, and what it measured."""
        place = self._places.get(record["run"])
        if place is None:
            return
        self.statuses[place] = _ENDS.get(record["status"], RunStatus.TODO)
        told = record["measures"]
        self.values[place] = tuple(_shown(told[name]["value"]) if name in told else None for name in self.measures)
        self.doubt(record)
        self.changed.add(place)

    def doubt(self, record: Mapping[str, Any]) -> None:
        """Take down which values of an attempt that ended are doubtful."""
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
        """Yield the places of rows that have a status and a text in their id or treatments; nothing given means all."""
        wanted = text.casefold()
        for place, run_id in enumerate(self.run_ids):
            if status and _WORDS[self.statuses[place]] != status:
                continue
            if not wanted or wanted in run_id.casefold() or wanted in " ".join(self.treatments[place]).casefold():
                yield place


def _shown(value: Any) -> Any:
    """Return a value as the page takes it: a number that is not finite is missing, a long text is cut."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value[:_LONGEST] if isinstance(value, str) else value
