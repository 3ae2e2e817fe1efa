"""`run_table.csv`: the run table for people, R and pandas, readable without Robot Runner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.design.columns import REPETITION, RUN_ID
from robot_runner.core.design.factor import Combination
from robot_runner.core.errors import MeasureError, StorageError, did_you_mean
from robot_runner.core.storage.cells import RunStatus, checked_measure, quoted
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.table_columns import CodedColumn, MeasureColumn, RunIdColumn, StatusColumn, TextColumn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from robot_runner.core.design.run_table import RunTable
    from robot_runner.core.errors import Finding
    from robot_runner.core.storage.cells import CellValue
    from robot_runner.core.storage.table_columns import TableColumn, TableLayout

__all__ = ["RunTableRows", "table_text", "write_run_table"]


# The run table in memory: what is planned, how far it has come, and what was measured. One writer.


class RunTableRows:
    """All rows of a run table, held in columns. Rows are counted from 0, in the order of execution.

    Attributes:
        layout: which columns there are.
        run_ids: the column of the runs' ids.
        statuses: the column of the runs' statuses.
        stamps: the events' time stamps, by heading.
        factors: the factors' columns (and that of the repetitions), by heading.
        measures: the measures' columns, by heading.
        extras: the columns that a user added, by heading.
        warnings: what looked odd when the table was read.

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
        self,
        layout: TableLayout,
        run_ids: RunIdColumn,
        statuses: StatusColumn,
        factors: Sequence[CodedColumn],
        *,
        texts: Mapping[str, list[str | None]] | None = None,
        measures: Mapping[str, list[CellValue]] | None = None,
        warnings: Sequence[Finding] = (),
    ) -> None:
        """Put the columns together.

        Args:
            layout: which columns there are.
            run_ids: the ids of the runs.
            statuses: the statuses of the runs.
            factors: the columns of the layout's factors and, where it has them, of the repetitions.
            texts: time stamps and extras by heading; what is not there is empty.
            measures: measures by heading; what is not there is empty.
            warnings: what looked odd when the table was read.
        """
        count = len(run_ids)
        texts, measures = texts or {}, measures or {}
        self.layout = layout
        self.run_ids = run_ids
        self.statuses = statuses
        statuses.spell(layout.spelling.status_words)
        self.stamps = {name: TextColumn(name, texts.get(name) or [None] * count) for name in layout.stamps}
        self.factors = {column.name: column for column in factors}
        self.measures = {name: MeasureColumn(name, measures.get(name) or [None] * count) for name in layout.measures}
        self.extras = {name: TextColumn(name, texts.get(name) or [None] * count) for name in layout.extras}
        self.warnings = tuple(warnings)
        self._places = {name: place for place, name in enumerate(layout.factor_names)}

    @classmethod
    def of_plan(cls, plan: RunTable, layout: TableLayout) -> RunTableRows:
        """Return the rows of a planned run table, all of them still to be executed."""
        factors = [
            CodedColumn(factor.name, factor.treatments, factor.texts, plan.treatment_places(factor.name))
            for factor in plan.model.factors
        ]
        if layout.has_repetition:
            values = range(plan.model.repetitions + 1)
            factors.append(CodedColumn(REPETITION, values, [*map(str, values)], plan.repetition_numbers()))
        run_ids = RunIdColumn.numbered(len(plan)) if plan.run_ids is None else RunIdColumn(plan.run_ids, len(plan))
        return cls(layout, run_ids, StatusColumn(len(plan)), factors)

    def __len__(self) -> int:
        return len(self.run_ids)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return map(self.row, range(len(self)))

    @property
    def columns(self) -> tuple[TableColumn, ...]:
        """All columns, in the order of the file."""
        parts = (self.stamps, self.factors, self.measures, self.extras)
        return (self.run_ids, self.statuses, *(column for part in parts for column in part.values()))

    def row(self, place: int) -> dict[str, Any]:
        """Return the row at `place`: the typed value of each column, by heading."""
        return {column.name: column.value(place) for column in self.columns}

    def run_id(self, place: int) -> str:
        """Return the id of the run at `place`."""
        return self.run_ids.value(place)

    def index_of(self, run_id: str) -> int:
        """Return the place of a run.

        Raises:
            StorageError: the run table has no such run.
        """
        place = self.run_ids.place_of(run_id)
        if place is None:
            fix = f"Name one from {self.run_id(0)!r} to {self.run_id(len(self) - 1)!r}."
            raise StorageError(f"there is no run {run_id!r}", where=RUN_ID, fix=fix)
        return place

    def status(self, place: int) -> RunStatus:
        """Return how far the run at `place` has come."""
        return self.statuses.value(place)

    def count(self, status: RunStatus) -> int:
        """Return how many runs have this status, at no cost that grows with the table."""
        return self.statuses.count(status)

    def combination(self, place: int) -> Combination:
        """Return the treatment of each factor in the run at `place`."""
        return Combination(self._places, tuple(self.factors[name].value(place) for name in self._places))

    def repetition(self, place: int) -> int:
        """Return which repetition of its combination the run at `place` is; 1 where the table has no such column."""
        return int(self.factors[REPETITION].value(place)) if self.layout.has_repetition else 1

    def record(
        self,
        run_id: str,
        *,
        status: RunStatus | None = None,
        stamps: Mapping[str, str | None] | None = None,
        measures: Mapping[str, CellValue] | None = None,
    ) -> None:
        """Change what is known of one run; all of it, or nothing where any of it cannot be.

        Args:
            run_id: the run.
            status: how far it has come, where that changed.
            stamps: when events were emitted (UTC, ISO 8601, as the journal's), by heading.
            measures: values by heading; None is a missing value.

        Raises:
            StorageError: there is no such run or time-stamp column.
            MeasureError: there is no such measure, or its value is none that the run table can hold.
        """
        place = self.index_of(run_id)
        stamps, measures = stamps or {}, measures or {}
        for name in stamps:
            if name not in self.stamps:
                problem = f"there is no time-stamp column {name!r}"
                raise StorageError(problem, where=f"run {run_id!r}", fix=did_you_mean(name, self.stamps))
        values = {name: self._checked(run_id, name, value) for name, value in measures.items()}
        for name, stamp in stamps.items():
            self.stamps[name].texts[place] = stamp
        for name, value in values.items():
            self.measures[name].values[place] = value
        if status is not None:
            self.statuses.change(place, status)

    def clear(self, run_id: str) -> None:
        """Forget what an attempt at a run left behind: it is to do again, without time stamps and measures.

        Raises:
            StorageError: there is no such run.
        """
        nothing = dict.fromkeys(self.measures)
        self.record(run_id, status=RunStatus.TODO, stamps=dict.fromkeys(self.stamps), measures=nothing)

    def _checked(self, run_id: str, name: str, value: object) -> CellValue:
        if name not in self.measures:
            problem = f"there is no measure column {name!r}"
            raise MeasureError(problem, where=f"run {run_id!r}", fix=did_you_mean(name, self.measures))
        return checked_measure(name, value)


_ROWS_AT_ONCE = 500  # what fits into a processor's cache


def write_run_table(path: Path, rows: RunTableRows) -> None:
    """Write the run table beside `path` and rename it; the old file is intact until the new one is on the disk.

    Raises:
        StorageError: it cannot be written.
    """
    write_beside_and_rename(path, lambda file: file.writelines(table_text(rows)))


def table_text(rows: RunTableRows) -> Iterator[str]:
    r"""Yield the run table as CSV in pieces: UTF-8, commas, lines that end in `\n`, an empty cell for what is missing.

    The columns stand in the order of the layout, see `TableLayout`.
    """
    columns = rows.columns
    yield ",".join(quoted(rows.layout.spelling.heading(column.name)) for column in columns) + "\n"
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, len(rows))
        cells = [column.cells(start, stop) for column in columns]
        yield "\n".join(map(",".join, zip(*cells, strict=True))) + "\n"
