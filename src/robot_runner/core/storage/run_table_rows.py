"""The run table in memory, a row for each run, and writing it to `run_table.csv`."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, TextIO

from robot_runner.core.design.columns import BATCH, RUN_ID, STATUS, WARM_UP
from robot_runner.core.design.factor import Combination
from robot_runner.core.design.planned_runs import PlannedRun, garbage_collection_paused
from robot_runner.core.errors import Finding, MeasureError, StorageError, did_you_mean
from robot_runner.core.storage.cells import ENDS, CellValue, RunStatus, checked_measure, csv_text, measure_text
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.table_columns import FactorColumn, TableLayout

_ROWS_AT_ONCE = 500  # they fit into a processor's cache
#: The attribute of a row for each column of `MARKS`.
_MARKS = {BATCH: "run.batch", WARM_UP: "run.is_warm_up"}
_NUMBERED = re.compile(r"r_([1-9][0-9]{0,17})")


@dataclass(slots=True, eq=False)
class RunRow:
    """One row of the run table: a planned run, its status, and its measures.

    Attributes:
        stamps: when its events were emitted, in the order of the layout's `stamps`; None where that is not known.
        measures: its measures, in the order of the layout's `measures`; None where a value is missing.
        kept: texts that are written as they were read, by heading: a user's own columns, and cells of factors that
            would be written in another way; None where there are none.
        excluded: why the run is excluded; None where it is not.
    """

    run: PlannedRun
    status: RunStatus
    stamps: tuple[str | None, ...]
    measures: tuple[CellValue, ...]
    kept: Mapping[str, str] | None = None
    excluded: str | None = None


class RunTableRows:
    """All rows of a run table, in the order of execution; `place` counts them from 0.

    Attributes:
        layout: which columns there are.
        warnings: what looked odd when the table was read.
        has_file: whether the file from which it was read has the columns in the form in which we write them.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> from robot_runner.core.storage.table_columns import TableLayout
        >>> model = RunTableModel([Factor("Task", ["Video", "Network"])])
        >>> rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["Energy"]))
        >>> rows.record("r_2", status=RunStatus.DONE, measures={"Energy": 719.0})
        >>> rows.count(RunStatus.DONE), rows.row(1)["Energy"]
        (1, 719.0)
    """

    def __init__(
        self, layout: TableLayout, rows: Iterable[RunRow], warnings: Sequence[Finding] = (), *, has_file: bool = False
    ) -> None:
        """Make a table; `rows` have the stamps and measures of `layout`."""
        self.layout = layout
        self.warnings = tuple(warnings)
        self.has_file = has_file
        self._rows = list(rows)
        self._counts = Counter(row.status for row in self._rows)
        self._places: dict[str, int] | None = None
        self._sources = _sources(layout)

    @classmethod
    def of_plan(cls, plan: Sequence[PlannedRun], layout: TableLayout) -> RunTableRows:
        """Return the rows of a planned run table, all of them still to be executed."""
        with garbage_collection_paused():
            return cls(layout, map(RunRow, plan, *map(repeat, (RunStatus.TODO, *_nothing(layout)))))

    def with_plan(self, plan: Iterable[PlannedRun], layout: TableLayout) -> RunTableRows:
        """Return the rows of a plan that has grown: present runs stay as they are, new ones are to do."""
        known = {row.run.run_id: row for row in self._rows}
        rows = []
        for run in plan:
            row = known.get(run.run_id) or RunRow(run, RunStatus.TODO, *_nothing(layout))
            row.run = run
            rows.append(row)
        return RunTableRows(layout, rows, self.warnings)

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return map(self.row, range(len(self)))

    @property
    def planned(self) -> Iterator[PlannedRun]:
        """The runs as they are planned, in order."""
        return (row.run for row in self._rows)

    def row(self, place: int) -> dict[str, Any]:
        """Return the row at `place`: the typed value of each column, by heading."""
        row = (self._rows[place],)
        return {name: next(self._values(name, row)) for name in self._sources}

    def values(self, name: str) -> Iterator[Any]:
        """Return the value of a column in each row."""
        return self._values(name, self._rows)

    def recorded(self) -> dict[str, tuple[Any, ...]]:
        """Return the time stamps and the measures of the runs that have any, by heading."""
        no_stamps, no_measures = _nothing(self.layout)
        stamps = zip(*(row.stamps for row in self._rows if row.stamps != no_stamps), strict=True)
        measures = zip(*(row.measures for row in self._rows if row.measures != no_measures), strict=True)
        found: dict[str, tuple[Any, ...]] = dict.fromkeys((*self.layout.stamps, *self.layout.measures), ())
        found.update(zip(self.layout.stamps, stamps, strict=False))  # `stamps` is empty where no run has a value
        found.update(zip(self.layout.measures, measures, strict=False))
        return found

    def run_id(self, place: int) -> str:
        """Return the id of the run at `place`."""
        return self._rows[place].run.run_id

    @property
    def done_runs(self) -> list[str]:
        """The ids of the runs that are done, in the order of the table."""
        return [row.run.run_id for row in self._rows if row.status is RunStatus.DONE]

    def place_of(self, run_id: str) -> int | None:
        """Return the place of a run, or None where there is no such run."""
        numbered = _NUMBERED.fullmatch(run_id)
        if numbered and (place := int(numbered[1]) - 1) < len(self) and self.run_id(place) == run_id:
            return place  # as in every planned table, which needs no index then
        if self._places is None:
            self._places = {row.run.run_id: place for place, row in enumerate(self._rows)}
        return self._places.get(run_id)

    def index_of(self, run_id: str) -> int:
        """Return the place of a run; raise a `StorageError` if the run table has no such run."""
        place = self.place_of(run_id)
        if place is None:
            fix = f"Name one from {self.run_id(0)!r} to {self.run_id(len(self) - 1)!r}."
            raise StorageError(f"there is no run {run_id!r}", where=RUN_ID, fix=fix)
        return place

    def has_ended(self, run_id: str) -> bool:
        """Return whether a run is done or failed; False where there is no such run."""
        place = self.place_of(run_id)
        return place is not None and self.status(place) in ENDS.values()

    def status(self, place: int) -> RunStatus:
        """Return how far the run at `place` has come."""
        return self._rows[place].status

    def count(self, status: RunStatus) -> int:
        """Return how many runs have this status, at a cost that does not grow with the table."""
        return self._counts[status]

    def excluded(self, place: int) -> str | None:
        """Return why the run at `place` is excluded; None where it is not."""
        return self._rows[place].excluded

    def exclude(self, run_id: str, reason: str | None) -> None:
        """Exclude a run, or with None include it again; the layout must have the column for it.

        Raises:
            StorageError: there is no such run.
        """
        self._rows[self.index_of(run_id)].excluded = reason

    def to_do_again(self) -> RunTableRows:
        """Return the same runs, all to do, without a user's own columns, which may be about how they went."""
        for place, row in enumerate(self._rows):
            self.clear(self.run_id(place))
            row.excluded = None
        layout = replace(self.layout, has_exclusions=False, extras=(), former_measures=())
        return RunTableRows(layout, self._rows, self.warnings)

    def combination(self, place: int) -> Combination:
        """Return the treatment of each factor in the run at `place`."""
        return self._rows[place].run.combination

    def repetition(self, place: int) -> int:
        """Return which repetition of its combination the run is; 1 where there is no such column, 0 for a warm-up."""
        run = self._rows[place].run
        return run.repetition if self.layout.has_repetition or run.is_warm_up else 1

    def is_warm_up(self, place: int) -> bool:
        """Return whether the run at `place` only warms up."""
        return self._rows[place].run.is_warm_up

    def record(
        self,
        run_id: str,
        *,
        status: RunStatus | None = None,
        stamps: Mapping[str, str | None] | None = None,
        measures: Mapping[str, CellValue] | None = None,
    ) -> None:
        """Change the row of one run; nothing is changed where this raises.

        Without a `status`, that stays as it is. Stamps (UTC, ISO 8601, as the journal's) and measures are by heading;
        None is a missing value.

        Raises:
            StorageError: there is no such run or time-stamp column.
            MeasureError: there is no such measure, or the run table cannot hold its value.
        """
        row = self._rows[self.index_of(run_id)]
        stamps, measures = stamps or {}, measures or {}
        for name in stamps:
            if name not in self.layout.stamps:
                problem = f"there is no time-stamp column {name!r}"
                raise StorageError(problem, where=f"run {run_id!r}", fix=did_you_mean(name, self.layout.stamps))
        values = {name: self._checked(run_id, name, value) for name, value in measures.items()}
        if stamps:
            row.stamps = _replaced(self.layout.stamps, row.stamps, stamps)
        if values:
            row.measures = _replaced(self.layout.measures, row.measures, values)
        if status is not None:
            self._change(row, status)

    def take_end(self, record: Mapping[str, Any]) -> None:
        """Change the row of a run by the journal's record of an attempt's end; one that was interrupted is to do again.

        Raises:
            StorageError: there is no such run.
        """
        run_id = record["run"]
        if (status := ENDS.get(record["status"])) is None:
            self.clear(run_id)
            return
        stamps = {f"{event}_at": stamp for event, stamp in record["stamps"].items()}
        measures = {name: each["value"] for name, each in record["measures"].items()}
        self.take_former(run_id, measures)
        self.record(
            run_id,
            status=status,
            stamps={name: stamp for name, stamp in stamps.items() if name in self.layout.stamps},
            measures={name: value for name, value in measures.items() if name in self.layout.measures},
        )

    def clear(self, run_id: str) -> None:
        """Set a run back: it is to do again, without time stamps and measures.

        Raises:
            StorageError: there is no such run.
        """
        row = self._rows[self.index_of(run_id)]
        row.stamps, row.measures = _nothing(self.layout)
        self.take_former(run_id, {})
        self._change(row, RunStatus.TODO)

    def take_former(self, run_id: str, measures: Mapping[str, CellValue]) -> None:
        """Set the columns of former measures to the values of this attempt, or to nothing.

        Raises:
            StorageError: there is no such run.
        """
        row = self._rows[self.index_of(run_id)]
        if former := self.layout.former_measures:
            others = {name: text for name, text in (row.kept or {}).items() if name not in former}
            row.kept = others | {name: measure_text(measures[name]) for name in former if name in measures}

    def cells(self) -> Iterator[list[Sequence[Any]]]:
        """Yield the cells of the rows in chunks, in the order of the layout, for `csv_text`."""
        texts = {column.name: _texts_by_treatment(column) for column in self.layout.factors}
        for start in range(0, len(self), _ROWS_AT_ONCE):
            rows = self._rows[start : start + _ROWS_AT_ONCE]
            columns = (self._written(name, rows, texts) for name in self._sources)
            cells: list[Sequence[Any]] = list(zip(*columns, strict=True))
            kept = any(row.kept for row in rows)
            yield [self._with_kept(row, each) for row, each in zip(rows, cells, strict=True)] if kept else cells

    def _written(self, name: str, rows: Iterable[RunRow], texts: Mapping[str, Mapping[int, str]]) -> Iterable[Any]:
        values = self._values(name, rows)
        if name == STATUS:
            return map(self.layout.spelling.status_words.__getitem__, values)
        if name in texts:
            known = texts[name]
            return [known.get(id(treatment)) or str(treatment) for treatment in values]
        return values

    def _with_kept(self, row: RunRow, cells: Sequence[Any]) -> Sequence[Any]:
        kept = row.kept or {}
        return [kept.get(name, cell) for name, cell in zip(self._sources, cells, strict=True)]

    def _values(self, name: str, rows: Iterable[RunRow]) -> Iterator[Any]:
        attribute, key = self._sources[name]
        held = map(attrgetter(attribute), rows)
        if key is None:
            return held
        if attribute == "kept":
            return (texts.get(name) if texts else None for texts in held)
        return map(itemgetter(key), held)

    def _change(self, row: RunRow, status: RunStatus) -> None:
        self._counts[row.status] -= 1
        self._counts[status] += 1
        row.status = status

    def _checked(self, run_id: str, name: str, value: object) -> CellValue:
        if name not in self.layout.measures:
            problem = f"there is no measure column {name!r}"
            raise MeasureError(problem, where=f"run {run_id!r}", fix=did_you_mean(name, self.layout.measures))
        return checked_measure(name, value)


def _nothing(layout: TableLayout) -> tuple[tuple[None, ...], tuple[None, ...]]:
    """Return empty stamps and measures, which rows share."""
    return (None,) * len(layout.stamps), (None,) * len(layout.measures)


def _replaced(names: Sequence[str], values: tuple[Any, ...], changed: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(changed.get(name, value) for name, value in zip(names, values, strict=True))


def _sources(layout: TableLayout) -> dict[str, tuple[str, int | str | None]]:
    """Return where a row has the value of each column, by heading: an attribute, and an index or key in it, or None."""
    return {
        RUN_ID: ("run.run_id", None),
        STATUS: ("status", None),
        **dict.fromkeys(layout.exclusion, ("excluded", None)),
        **{name: ("stamps", place) for place, name in enumerate(layout.stamps)},
        **{name: ("run.combination.treatments", place) for place, name in enumerate(layout.factor_names)},
        **dict.fromkeys(layout.repetition, ("run.repetition", None)),
        **{name: (_MARKS[name], None) for name in layout.marks},
        **{name: ("measures", place) for place, name in enumerate(layout.measures)},
        **{name: ("kept", name) for name in layout.extras},
    }


def _texts_by_treatment(column: FactorColumn) -> dict[int, str]:
    """Return the text of each treatment by its `id`: rows hold the factor's own objects, which need not be hashable."""
    factor = column.factor
    return {} if factor is None else dict(zip(map(id, factor.treatments), factor.texts, strict=True))


def write_run_table(path: Path, rows: RunTableRows) -> str:
    """Write the run table beside `path` and rename it; the old file is intact until the new one is on the disk.

    Return its SHA-256, in hexadecimal digits.

    Raises:
        StorageError: it cannot be written.
    """
    digest = hashlib.sha256()

    def write(file: TextIO) -> None:
        for text in table_text(rows):
            file.write(text)
            digest.update(text.encode())

    write_beside_and_rename(path, write, path.parent)
    return digest.hexdigest()


def table_text(rows: RunTableRows) -> Iterator[str]:
    r"""Yield the run table as CSV in pieces: commas, lines that end in `\n`, empty cells for missing values.

    The columns are in the order of the layout, see `TableLayout`.
    """
    yield csv_text([rows.layout.headings])
    yield from map(csv_text, rows.cells())
