"""Which columns a run table has, in which order, and what their cells are read as."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.design.columns import REPETITION, RUN_ID, STAMP_COLUMNS, STATUS
from robot_runner.errors import DesignError, Finding
from robot_runner.storage.table_spelling import OWN_SPELLING, TableSpelling, spelling_of_headings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.design.factor import Factor
    from robot_runner.design.run_table_model import RunTableModel
    from robot_runner.storage.table_schema import ColumnDescription

__all__ = ["ColumnRole", "FactorColumn", "TableLayout"]


class ColumnRole(Enum):
    """What a column of the run table is for."""

    PROGRESS = "progress"
    TIMESTAMP = "timestamp"
    FACTOR = "factor"
    REPETITION = "repetition"
    MEASURE = "measure"
    EXTRA = "extra"


@dataclass(frozen=True, slots=True)
class FactorColumn:
    """The column of a factor.

    Attributes:
        name: the heading.
        factor: whose treatments the cells are matched with; None where they are not known (a folder read without its
            config), so that each cell goes by its looks.
    """

    name: str
    factor: Factor | None = None


@dataclass(frozen=True, slots=True)
class TableLayout:
    """The columns of a run table.

    They stand in the order of the paper's Fig. 3: progress, time stamps, factors, measures; a user's own columns come
    last. The first heading is `run_id` in lower case, not `ID`: spreadsheets take a file that begins with `ID` for a
    SYLK file and refuse it.

    Attributes:
        factors: the factors' columns.
        measures: the measures' columns.
        has_repetition: whether there is a column `Repetition` after the factors.
        stamps: the events' time-stamp columns.
        extras: columns that a user added; kept as text.
        types: the type of columns in the run table's schema, by name, for reading cells that could be several things.
        spelling: how the file spells headings and statuses.

    Raises:
        DesignError: two columns would have one heading.

    Example:
        >>> TableLayout((FactorColumn("Task"),), ("Energy",), stamps=()).columns
        ('run_id', 'status', 'Task', 'Energy')
    """

    factors: tuple[FactorColumn, ...]
    measures: tuple[str, ...] = ()
    has_repetition: bool = False
    stamps: tuple[str, ...] = STAMP_COLUMNS
    extras: tuple[str, ...] = ()
    types: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    spelling: TableSpelling = OWN_SPELLING

    def __post_init__(self) -> None:
        counts = Counter(self.columns)
        clashes = [name for name, count in counts.items() if count > 1]
        if clashes:
            fix = "Rename the factor, or choose other measures with data_columns."
            findings = [Finding.error("run table", f"two columns are called {name!r}", fix) for name in clashes]
            raise DesignError.of_findings(findings)

    @classmethod
    def of_model(
        cls,
        model: RunTableModel,
        measures: Iterable[str],
        types: Mapping[str, str] | None = None,
        spelling: TableSpelling = OWN_SPELLING,
    ) -> TableLayout:
        """Return the layout of a design's run table.

        Args:
            model: the design.
            measures: the names of the measures' columns, in order.
            types: the types in the run table's schema, where there is one already.
            spelling: how the file spells headings and statuses.

        Raises:
            DesignError: a measure is called like a factor.
        """
        return cls(
            tuple(FactorColumn(factor.name, factor) for factor in model.factors),
            tuple(measures),
            has_repetition=model.repetitions > 1,
            stamps=STAMP_COLUMNS if spelling.has_stamps else (),
            types=types or MappingProxyType({}),
            spelling=spelling,
        )

    @classmethod
    def of_schema(cls, schema: Sequence[ColumnDescription]) -> TableLayout:
        """Return the layout of a run table whose config is not at hand: treatments go by their looks and types."""
        named = {role: tuple(each.name for each in schema if each.role is role) for role in ColumnRole}
        return cls(
            tuple(map(FactorColumn, named[ColumnRole.FACTOR])),
            named[ColumnRole.MEASURE],
            has_repetition=bool(named[ColumnRole.REPETITION]),
            stamps=named[ColumnRole.TIMESTAMP],
            extras=named[ColumnRole.EXTRA],
            types={column.name: column.type for column in schema},
            spelling=spelling_of_headings({column.name: column.heading for column in schema if column.heading}),
        )

    @property
    def factor_names(self) -> tuple[str, ...]:
        """The headings of the factors, in order."""
        return tuple(column.name for column in self.factors)

    @property
    def repetition(self) -> tuple[str, ...]:
        """The heading of the repetitions, where the table has them."""
        return (REPETITION,) if self.has_repetition else ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All headings, in order."""
        return (RUN_ID, STATUS, *self.stamps, *self.factor_names, *self.repetition, *self.measures, *self.extras)
