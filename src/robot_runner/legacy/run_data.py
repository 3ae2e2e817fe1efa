"""The row of a run that callbacks of the earlier tools get, and the values that `populate_run_data` returns.

Only measures are published, each under its own name, so that no value ends up in another column.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, SupportsIndex

from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.core.errors import MeasureError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import MeasureValue, Origin, as_measure_value
from robot_runner.legacy.run_tables import PROGRESS, EarlierDesign, is_blank, value_of

if TYPE_CHECKING:
    from _collections_abc import dict_items, dict_values


class WatchedRow(dict[Any, Any]):
    """A row of the run table that records in the run's combination which treatments a callback reads.

    Copying, unpacking (`**row`) and printing read all treatments. Copies are plain dicts.

    Args:
        row: its cells.
        factors: the name of each factor in the combination, by its column.
        combination: the run's; it records which treatments were read.
        counting: the columns of factors that count runs, whose treatments need not be read.

    Attributes:
        combination: the combination that records reads from now on.
    """

    def __init__(
        self,
        row: Mapping[Any, Any],
        factors: Mapping[Any, str],
        combination: Mapping[str, Any],
        counting: Iterable[Any] = (),
    ) -> None:
        super().__init__(row)
        self._factors = factors
        self.combination = combination
        self._read(*counting)

    def __getitem__(self, column: Any) -> Any:
        self._read(column)
        return super().__getitem__(column)

    def __iter__(self) -> Iterator[Any]:
        # Copying a dict reads its items one by one only if its class overrides the iterator.
        return super().__iter__()

    def __repr__(self) -> str:
        self._read(*self)
        return super().__repr__()

    def __or__(self, other: Any) -> Any:
        return self.copy() | other

    def __ror__(self, other: Any) -> Any:
        return other | self.copy()

    def __reduce_ex__(self, protocol: SupportsIndex) -> tuple[type[dict[Any, Any]], tuple[dict[Any, Any]]]:
        """Pickle as a plain dict."""
        return dict, (self.copy(),)

    def get(self, column: Any, default: Any = None) -> Any:
        """Return a cell, as in any dict."""
        self._read(column)
        return super().get(column, default)

    def pop(self, column: Any, *default: Any) -> Any:
        """Remove and return a cell, as in any dict."""
        self._read(column)
        return super().pop(column, *default)

    def setdefault(self, column: Any, default: Any = None) -> Any:
        """Return a cell, or set it, as in any dict."""
        self._read(column)
        return super().setdefault(column, default)

    def items(self) -> dict_items[Any, Any]:
        """Return all cells with their columns, as in any dict."""
        self._read(*self)
        return super().items()

    def values(self) -> dict_values[Any, Any]:
        """Return all cells, as in any dict."""
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
    """Return the cells of a row without recording reads."""
    return dict(dict.items(row)) if isinstance(row, WatchedRow) else dict(row)


def planned_of(context: RobotRunnerContext) -> Mapping[str, Any]:
    """Return the treatments of a run without recording reads."""
    combination = context.combination
    return combination.unwatched if isinstance(combination, WatchedCombination) else combination


#: Texts of NaN and missing values in Python, NumPy and pandas; many of these are not a `float`, such as `np.float32`.
_NO_VALUE = frozenset({"nan", "nat", "<na>", "--"})
_INFINITE = frozenset({"inf", "-inf", "infinity", "-infinity"})


def as_mapping(returned: Any) -> Mapping[Any, Any]:
    """Return a callback's returned value as a mapping; None and other false values (False, "") are empty.

    Raises:
        MeasureError: the value is not a mapping.
    """
    if isinstance(returned, Mapping):
        return returned
    if hasattr(returned, "keys"):  # a pandas Series, say
        return {name: returned[name] for name in returned.keys()}  # noqa: SIM118 - it may not be iterable
    if not returned:  # Experiment Runner's test
        return {}
    problem = f"populate_run_data returned {returned!r}, of type {type(returned).__name__}"
    raise MeasureError(problem, where="config", fix="Return a dict from data column to value, or nothing.")


def publish_row(
    context: RobotRunnerContext, design: EarlierDesign, row: Mapping[Any, Any], estimated: Container[Any]
) -> None:
    """Publish the measures of a row; values without a data column are kept in the run's folder, with a warning.

    The values of the `estimated` columns are estimates by a model.
    """
    for column, value in row.items():
        if column in PROGRESS:
            continue
        if column in design.factors:
            _warn_of_changed_treatment(context, design, column, value)
            continue
        if column in design.data_columns:
            _publish(context, column, design.names[column], value, Origin.ESTIMATED if column in estimated else None)
        elif not is_blank(value):
            _keep_aside(context, design, column, value)


def _publish(context: RobotRunnerContext, column: Any, name: str, value: Any, origin: Origin | None) -> None:
    if is_blank(value):
        return
    try:
        context.publish(name, _plain(context, column, name, value), origin=origin)
    except MeasureError as error:  # such as an infinity, or a text that cannot be encoded: kept with the run
        context.doubt(error.problem, fix=error.fix, measures=[name])


def _plain(context: RobotRunnerContext, column: Any, name: str, value: Any) -> MeasureValue:
    """Return a value for a cell: anything except numbers, bools and texts is converted to its text."""
    written = "" if isinstance(value, str) else str(value).casefold()
    if written in _NO_VALUE:
        problem = f"{column} is not a number ({value}): there is no value"
        context.doubt(problem, fix="Return None where there is no value.", measures=[name])
        return None
    if written in _INFINITE:
        return float(value)  # refused by the gate, with a reason
    try:
        return as_measure_value(str(column), value, where="config")
    except MeasureError:
        return str(value)


def _keep_aside(context: RobotRunnerContext, design: EarlierDesign, column: Any, value: Any) -> None:
    """Publish a value without a column, which is refused: it is kept in the run's folder, and the run goes on."""
    with suppress(MeasureError):
        context.publish(str(column), value)
    problem = f"{column!r} is not a data column: its value is kept in refused.jsonl; the earlier tool shifted the row"
    fix = f"{did_you_mean(str(column), map(str, design.data_columns))} Or add it to data_columns.".strip()
    context.warn(problem, fix=fix)


def _warn_of_changed_treatment(context: RobotRunnerContext, design: EarlierDesign, column: Any, value: Any) -> None:
    planned = value_of(planned_of(context)[design.names[column]])
    if value is not planned and str(value) != str(planned):
        problem = f"populate_run_data returned {value!r} for the factor {column!r}, which is {planned!r} in this run"
        context.warn(problem, fix="Return it under the name of a data column.")
