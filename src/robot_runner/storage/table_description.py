"""What the run table's columns hold: from the table itself, and from what is known of its measures."""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Integral
from typing import TYPE_CHECKING, Any

from robot_runner.design.columns import RUN_ID, STATUS
from robot_runner.storage.cells import are_stamps
from robot_runner.storage.run_status import RunStatus
from robot_runner.storage.table_layout import ColumnRole
from robot_runner.storage.table_schema import ColumnDescription

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.storage.run_table_rows import RunTableRows

__all__ = ["describe_columns", "type_of_values"]


def describe_columns(
    rows: RunTableRows, known: Mapping[str, ColumnDescription] | None = None
) -> tuple[ColumnDescription, ...]:
    """Describe each column of a run table, for its schema.

    Args:
        rows: the run table; types are those of the values that it holds.
        known: what is known of columns beside their values (titles, units, owners, ...), by heading.
    """
    words = {status: rows.layout.spelling.status_words[status] for status in RunStatus}
    described = [
        ColumnDescription(
            name=RUN_ID,
            role=ColumnRole.PROGRESS,
            type="string",
            title="Run",
            description="Names the run, and its folder.",
        ),
        ColumnDescription(
            name=STATUS,
            role=ColumnRole.PROGRESS,
            type="string",
            title="Status",
            description=f"How far the run has come: {', '.join(dict.fromkeys(words.values()))}.",
        ),
        *(_stamp(name, column.texts) for name, column in rows.stamps.items()),
        *(_factor(name, column.values) for name, column in rows.factors.items() if name in rows.layout.factor_names),
        *(_repetition(name) for name in rows.layout.repetition),
        *(_measure(name, column.values) for name, column in rows.measures.items()),
        *(ColumnDescription(name=name, role=ColumnRole.EXTRA, type="string", title=name) for name in rows.extras),
    ]
    spelled = (replace(column, heading=_other_heading(rows, column.name)) for column in described)
    return tuple(_merged(column, (known or {}).get(column.name)) for column in spelled)


def _other_heading(rows: RunTableRows, name: str) -> str:
    heading = rows.layout.spelling.heading(name)
    return "" if heading == name else heading


def type_of_values(values: Iterable[Any]) -> str:
    """Return the type of a column that holds these values; `any` where no single one fits, or there are no values."""
    kinds = {bool if isinstance(value, bool) else _plain_kind(value) for value in values if value is not None}
    if not kinds:
        return "any"
    for name, fitting in _FITTING:
        if kinds <= fitting:
            return name
    return "any"


_FITTING = (
    ("boolean", {bool}),
    ("integer", {int}),
    ("number", {int, float}),
    ("string", {str}),
)


def _plain_kind(value: Any) -> type | None:
    if isinstance(value, float):
        return float if math.isfinite(value) else None
    return int if isinstance(value, Integral) else str  # an object stands in the table as its text


def _stamp(name: str, texts: list[str | None]) -> ColumnDescription:
    event = name.removesuffix("_at")
    return ColumnDescription(
        name=name,
        role=ColumnRole.TIMESTAMP,
        type="datetime" if are_stamps([text for text in texts if text]) else "string",
        title=event.replace("_", " "),
        description=f"When the event {event} was emitted, in UTC.",
    )


def _factor(name: str, treatments: Iterable[Any]) -> ColumnDescription:
    kind = type_of_values("None" if treatment is None else treatment for treatment in treatments)
    return ColumnDescription(name=name, role=ColumnRole.FACTOR, type=kind, title=name, description="A factor.")


def _repetition(name: str) -> ColumnDescription:
    return ColumnDescription(
        name=name,
        role=ColumnRole.REPETITION,
        type="integer",
        title=name,
        description="Which repetition of its combination the run is, from 1.",
    )


def _measure(name: str, values: Iterable[Any]) -> ColumnDescription:
    return ColumnDescription(name=name, role=ColumnRole.MEASURE, type=type_of_values(values), title=name)


def _merged(column: ColumnDescription, known: ColumnDescription | None) -> ColumnDescription:
    if known is None:
        return column
    return replace(
        known,
        name=column.name,
        role=column.role,
        heading=column.heading,
        type=known.type if column.type == "any" else column.type,
        title=known.title or column.title,
        description=known.description or column.description,
    )
