"""The row of a run as callbacks get it: a dict, as in the earlier tools, that tells which treatments were read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, SupportsIndex

from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.core.events.context import RobotRunnerContext

if TYPE_CHECKING:
    from _collections_abc import dict_items, dict_values


#: Robot Runner had no repetitions: a factor counted them, which nobody has to read.
_COUNTS_RUNS = re.compile(r"(?i)(.*_)?(rep|repeat|repetition|replication|run|iter|iteration|trial|round)s?(_.*)?")


class WatchedRow(dict[Any, Any]):
    """A row of the run table that reads a treatment of the run's combination whenever a callback looks at it.

    What takes all of it (a copy, `**row`, what prints it) reads all treatments. Copies are plain dicts.

    Args:
        row: what is in it.
        factors: the name of each factor in the combination, by its column.
        combination: of the run; it tells what was read.

    Attributes:
        combination: the one that is told from now on.
    """

    def __init__(self, row: Mapping[Any, Any], factors: Mapping[Any, str], combination: Mapping[str, Any]) -> None:
        super().__init__(row)
        self._factors = factors
        self.combination = combination
        self._read(*(column for column in factors if _COUNTS_RUNS.fullmatch(str(column))))

    def __getitem__(self, column: Any) -> Any:
        self._read(column)
        return super().__getitem__(column)

    def __iter__(self) -> Iterator[Any]:
        # Whatever copies a dict looks at its items one by one where it has an iterator of its own.
        return super().__iter__()

    def __repr__(self) -> str:
        self._read(*self)
        return super().__repr__()

    def __or__(self, other: Any) -> Any:
        return self.copy() | other

    def __ror__(self, other: Any) -> Any:
        return other | self.copy()

    def __reduce_ex__(self, protocol: SupportsIndex) -> tuple[type[dict[Any, Any]], tuple[dict[Any, Any]]]:
        """Have what another process gets be a plain dict."""
        return dict, (self.copy(),)

    def get(self, column: Any, default: Any = None) -> Any:
        """Return a cell; as of any dict."""
        self._read(column)
        return super().get(column, default)

    def pop(self, column: Any, *default: Any) -> Any:
        """Take a cell out; as of any dict."""
        self._read(column)
        return super().pop(column, *default)

    def setdefault(self, column: Any, default: Any = None) -> Any:
        """Return a cell, or set it; as of any dict."""
        self._read(column)
        return super().setdefault(column, default)

    def items(self) -> dict_items[Any, Any]:
        """Return all cells with their columns; as of any dict."""
        self._read(*self)
        return super().items()

    def values(self) -> dict_values[Any, Any]:
        """Return all cells; as of any dict."""
        self._read(*self)
        return super().values()

    def copy(self) -> dict[Any, Any]:
        """Return a plain dict."""
        self._read(*self)
        return unwatched(self)

    def _read(self, *columns: Any) -> None:
        for column in columns:
            if column in self._factors:
                self.combination[self._factors[column]]


def unwatched(row: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return the cells of a row as they are, of which nothing is told."""
    return dict(dict.items(row)) if isinstance(row, WatchedRow) else dict(row)


def planned_of(context: RobotRunnerContext) -> Mapping[str, Any]:
    """Return the treatments of a run, without having read them."""
    combination = context.combination
    return combination.unwatched if isinstance(combination, WatchedCombination) else combination
