"""What `populate_run_data` returned: measures are published, the rest of the row is none, and nothing ever shifts."""

from __future__ import annotations

from collections.abc import Container, Mapping
from contextlib import suppress
from typing import Any

from robot_runner.core.errors import MeasureError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import MeasureValue, Origin, as_measure_value
from robot_runner.legacy.run_tables import PROGRESS, EarlierDesign, is_blank, value_of
from robot_runner.legacy.stand_ins.watched_row import planned_of

#: How Python, NumPy and pandas write NaN and missing values; many of these are not a `float`, such as `np.float32`.
_NO_VALUE = frozenset({"nan", "nat", "<na>", "--"})
_INFINITE = frozenset({"inf", "-inf", "infinity", "-infinity"})


def as_mapping(returned: Any) -> Mapping[Any, Any]:
    """Return what a callback returned as a mapping; nothing, and what is as good as nothing (False, ""), is empty.

    Raises:
        MeasureError: it is no mapping.
    """
    if isinstance(returned, Mapping):
        return returned
    if hasattr(returned, "keys"):  # a pandas Series, say
        return {name: returned[name] for name in returned.keys()}  # noqa: SIM118 - it need not be iterable otherwise
    if not returned:  # as Experiment Runner asked
        return {}
    raise MeasureError(
        f"populate_run_data returned {returned!r}, of type {type(returned).__name__}",
        where="config",
        fix="Return a dict from data column to value, or nothing.",
    )


def publish_row(
    context: RobotRunnerContext, design: EarlierDesign, row: Mapping[Any, Any], estimated: Container[Any]
) -> None:
    """Publish the measures of a row; what is no data column is kept aside, with a warning.

    The values of the `estimated` columns come from a model.
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
    except MeasureError as error:  # an infinity, a text that no file can hold: kept with the run
        context.doubt(error.problem, fix=error.fix, measures=[name])


def _plain(context: RobotRunnerContext, column: Any, name: str, value: Any) -> MeasureValue:
    """Return a value as a cell can hold it: what is no number, bool or text stands there as its text."""
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
    """Have the gate refuse a value that no column is for: it is kept in the run's folder, and the run goes on."""
    with suppress(MeasureError):
        context.publish(str(column), value)
    context.warn(
        f"{column!r} is no data column: its value is kept in refused.jsonl; the earlier tool shifted the row",
        fix=f"{did_you_mean(str(column), map(str, design.data_columns))} Or add it to data_columns.".strip(),
    )


def _warn_of_changed_treatment(context: RobotRunnerContext, design: EarlierDesign, column: Any, value: Any) -> None:
    planned = value_of(planned_of(context)[design.names[column]])
    if value is not planned and str(value) != str(planned):
        context.warn(
            f"populate_run_data returned {value!r} for the factor {column!r}, which is {planned!r} in this run",
            fix="Return it under the name of a data column.",
        )
