"""The columns of an earlier tool's run table, and the names that they have in ours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.design.columns import reserved_names
from robot_runner.storage.table_spelling import EARLIER_SPELLING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.storage.table_spelling import TableSpelling

__all__ = ["PROGRESS", "ColumnNames", "named_columns"]

#: What headed the progress of a run.
PROGRESS = ("__run_id", "__done")


@dataclass(frozen=True, slots=True)
class ColumnNames:
    """Our name of each column, by the name that the config gives it."""

    by_column: Mapping[Any, str]

    def __getitem__(self, column: Any) -> str:
        return self.by_column[column]

    @property
    def spelling(self) -> TableSpelling:
        """How the run table's file spells its headings."""
        others = {name: str(column) for column, name in self.by_column.items() if name != str(column)}
        return replace(EARLIER_SPELLING, headings=MappingProxyType({**EARLIER_SPELLING.headings, **others}))


def named_columns(columns: Iterable[Any]) -> ColumnNames:
    """Give each column a name that our run table can have; a column `status` would clash with our own.

    Example:
        >>> dict(named_columns(["Task", "status"]).by_column)
        {'Task': 'Task', 'status': 'status_'}
    """
    listed = list(columns)
    taken = {name.casefold() for name in reserved_names(1)}
    names: dict[Any, str] = {}
    for column in listed:
        name = str(column).strip()
        while name.casefold() in taken:
            name += "_"
        names[column] = name
        if name != str(column):
            taken.add(name.casefold())
    return ColumnNames(MappingProxyType(names))
