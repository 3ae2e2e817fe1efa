"""`run_table.schema.json`: type, unit, meaning and owner of each column of the run table.

A Frictionless Table Schema (https://specs.frictionlessdata.io/table-schema/), so that other tools can read and
validate the run table. What it has no word for stands under keys that begin with `robot_runner:`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.design.columns import RUN_ID
from robot_runner.errors import StorageError
from robot_runner.storage.safe_write import storage_error, write_beside_and_rename
from robot_runner.storage.table_layout import ColumnRole

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["ColumnDescription", "read_schema", "write_schema"]

_OWN = "robot_runner:"
_PROFILE = "https://specs.frictionlessdata.io/schemas/table-schema.json"
_STAMP_FORMAT = "%Y-%m-%dT%H:%M:%S.%fZ"


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnDescription:
    """What one column of the run table holds.

    Attributes:
        name: the heading.
        role: what the column is for.
        type: `string`, `integer`, `number`, `boolean`, `datetime`, or `any` where it holds several or none yet.
        title: what it is, in a few words.
        description: what it is, in a sentence.
        unit: SI symbol, `%` for percentages, `1` for counts and ratios, empty where there is none.
        owner: the plugin that yields it, or `config`; empty for what Robot Runner itself fills.
        origin: `measured`, `simulated`, `estimated`, several of them with `, ` between, or None.
        findings: what is odd about its values.
        heading: what stands at its head in the file, where that is not its name.

    Example:
        >>> ColumnDescription(name="Energy", role=ColumnRole.MEASURE, type="number", unit="J").unit
        'J'
    """

    name: str
    role: ColumnRole
    type: str = "any"
    title: str = ""
    description: str = ""
    unit: str = ""
    owner: str = ""
    origin: str | None = None
    findings: tuple[str, ...] = ()
    heading: str = ""


def write_schema(path: Path, fields: Sequence[ColumnDescription]) -> None:
    """Write the schema beside `path` and rename it.

    Args:
        path: the file.
        fields: the run table's columns, in order.

    Raises:
        StorageError: it cannot be written.
    """
    schema = {
        "$schema": _PROFILE,
        "fields": list(map(_field, fields)),
        "missingValues": [""],
        "primaryKey": [next((field.heading or RUN_ID for field in fields if field.name == RUN_ID), RUN_ID)],
    }
    text = json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
    write_beside_and_rename(path, lambda file: file.write(text))


def read_schema(path: Path) -> tuple[ColumnDescription, ...]:
    """Return what the schema says of each column, in order.

    Raises:
        StorageError: there is none, or it is no schema of a run table.
    """
    try:
        schema = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except ValueError as error:  # not JSON, or not UTF-8
        raise _no_schema(path, str(error)) from error
    fields = schema.get("fields") if isinstance(schema, dict) else None
    if not isinstance(fields, list):
        raise _no_schema(path, "it has no list of fields")
    return tuple(_description(path, place, each) for place, each in enumerate(fields))


def _field(column: ColumnDescription) -> dict[str, Any]:
    field: dict[str, Any] = {"name": column.heading or column.name, "type": column.type}
    if column.type == "datetime":
        field["format"] = _STAMP_FORMAT
    field |= {key: text for key in ("title", "description", "unit") if (text := getattr(column, key))}
    field[f"{_OWN}role"] = column.role.value
    field[f"{_OWN}owner"] = column.owner
    field[f"{_OWN}origin"] = column.origin
    field[f"{_OWN}findings"] = list(column.findings)
    if column.heading:
        field[f"{_OWN}column"] = column.name
    return field


def _description(path: Path, place: int, field: object) -> ColumnDescription:
    if not isinstance(field, dict) or not isinstance(field.get("name"), str):
        raise _no_schema(path, f"fields[{place}] has no name")
    word = field.get(f"{_OWN}role", ColumnRole.EXTRA.value)
    role = next((role for role in ColumnRole if role.value == word), None)
    if role is None:
        raise _no_schema(path, f"fields[{place}] has the unknown role {word!r}")
    origin = field.get(f"{_OWN}origin")
    texts = {key: str(field.get(key, "")) for key in ("title", "description", "unit")}
    name = str(field.get(f"{_OWN}column", field["name"]))
    return ColumnDescription(
        name=name,
        role=role,
        type=str(field.get("type", "any")),
        owner=str(field.get(f"{_OWN}owner", "")),
        origin=None if origin is None else str(origin),
        findings=tuple(map(str, field.get(f"{_OWN}findings") or ())),
        heading="" if name == field["name"] else field["name"],
        **texts,
    )


def _no_schema(path: Path, reason: str) -> StorageError:
    problem = f"it is no schema of a run table: {reason}"
    return StorageError(problem, where=str(path), fix="Restore it from a backup, or delete it: it is written anew.")
