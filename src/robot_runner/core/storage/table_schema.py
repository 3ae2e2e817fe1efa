"""`run_table.schema.json`: type, unit, meaning and owner of each column; and descriptions of a data package.

A Table Schema in a Data Package of Frictionless Data, https://specs.frictionlessdata.io/data-package/
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate, takewhile
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

from robot_runner.core.design.columns import EXCLUDED, RUN_ID, STATUS, WARM_UP
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.cells import RunStatus, are_stamps
from robot_runner.core.storage.declared_shapes import shape_findings, with_short_texts
from robot_runner.core.storage.file_shapes import Schema
from robot_runner.core.storage.guarded_files import JSON_LIMIT, DamagedFileError, MissingFileError, read_json
from robot_runner.core.storage.guarded_files import replace as replace_file
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import MARKS, ColumnDescription, ColumnRole, FactorColumn

_OWN = "robot_runner:"
_PROFILE = "https://specs.frictionlessdata.io/schemas/table-schema.json"
_SCHEMA_FIX = "Restore it from a backup, or delete it: it is written again."
_STAMP_FORMAT = "%Y-%m-%dT%H:%M:%S.%fZ"
#: Bytes for the findings and doubts of all columns, which many runs may have: readers take no larger file.
_ROOM = JSON_LIMIT // 2
#: Blanks, marks and the run's id around a text.
_AROUND = 100

Entry = TypeVar("Entry")


def write_schema(path: Path, fields: Sequence[ColumnDescription]) -> None:
    """Write the schema beside `path` and rename it; findings and doubts that readers have no room for are only counted.

    Raises:
        StorageError: it cannot be written.
    """
    room = _ROOM // max(1, 2 * sum(bool(field.findings or field.doubts) for field in fields))
    schema = {
        "$schema": _PROFILE,
        "fields": [_field(field, room) for field in fields],
        "missingValues": [""],
        "primaryKey": [next((field.heading or RUN_ID for field in fields if field.name == RUN_ID), RUN_ID)],
    }
    # The text of a callback's warning may contain a picture.
    replace_file(path, json.dumps(with_short_texts(schema), indent=2, ensure_ascii=False) + "\n")


def read_schema(path: Path) -> tuple[ColumnDescription, ...]:
    """Return the descriptions of the columns, in order.

    Raises:
        StorageError: there is none, or it is not a schema of a run table.
    """
    try:
        schema = read_json(path)
    except MissingFileError as error:
        raise lost(path) from error
    except DamagedFileError as error:
        raise _no_schema(path, error.problem) from error
    StorageError.refuse(shape_findings(str(path), "a schema of a run table", schema, Schema, _SCHEMA_FIX))
    columns = tuple(_description(path, place, each) for place, each in enumerate(schema["fields"]))
    twice = [name for name, count in Counter(column.name for column in columns).items() if count > 1]
    if twice:
        raise _no_schema(path, f"two fields are for {twice[0]!r}")
    return columns


def lost(path: Path) -> MissingFileError:
    """Return the error for a run table or its schema that is not there, and comes back from the journal."""
    fix = "Execute the experiment once more with its config (robot-runner run): it is rebuilt. Or restore a backup."
    return MissingFileError(f"{path.name} is missing", where=str(path.parent), fix=fix)


def _field(column: ColumnDescription, room: int) -> dict[str, Any]:
    findings = _fitting(column.findings, room)
    doubts = {run_id: list(reasons) for run_id, reasons in _fitting(list(column.doubts.items()), room)}
    field: dict[str, Any] = {"name": column.heading or column.name, "type": column.type}
    if column.type == "datetime":
        field["format"] = _STAMP_FORMAT
    field |= {key: text for key in ("title", "description", "unit") if (text := getattr(column, key))}
    field[f"{_OWN}role"] = column.role.value
    field[f"{_OWN}owner"] = column.owner
    field[f"{_OWN}origin"] = column.origin
    field[f"{_OWN}findings"] = findings
    if doubts:
        field[f"{_OWN}doubts"] = doubts
    if left_out := len(column.findings) + len(column.doubts) - len(findings) - len(doubts):
        field[f"{_OWN}left_out"] = left_out
    if column.heading:
        field[f"{_OWN}column"] = column.name
    return field


def _fitting(entries: Sequence[Entry], room: int) -> list[Entry]:
    """Return the first entries that have room in the file, bytes."""
    texts = (json.dumps(with_short_texts(entry), ensure_ascii=False) for entry in entries)
    sizes = accumulate(_AROUND + len(text.encode("utf-8", "backslashreplace")) for text in texts)
    return list(entries[: sum(1 for _ in takewhile(lambda size: size <= room, sizes))])


def _description(path: Path, place: int, field: Mapping[str, Any]) -> ColumnDescription:
    word = field.get(f"{_OWN}role", ColumnRole.EXTRA.value)
    role = next((role for role in ColumnRole if role.value == word), None)
    if role is None:
        raise _no_schema(path, f"fields[{place}] has the unknown role {word!r}")
    texts = {key: field.get(key, "") for key in ("title", "description", "unit")}
    name = field.get(f"{_OWN}column", field["name"])
    doubts = field.get(f"{_OWN}doubts") or {}
    return ColumnDescription(
        name=name,
        role=role,
        type=field.get("type", "any"),
        owner=field.get(f"{_OWN}owner", ""),
        origin=field.get(f"{_OWN}origin"),
        findings=tuple(field.get(f"{_OWN}findings") or ()),
        heading="" if name == field["name"] else field["name"],
        doubts={run_id: tuple(reasons) for run_id, reasons in doubts.items()},
        **texts,
    )


def _no_schema(path: Path, reason: str) -> StorageError:
    return StorageError(f"the file is not a schema of a run table: {reason}", where=str(path), fix=_SCHEMA_FIX)


# The description of columns: from the table itself, and from what is known of its measures.


#: The column of exclusions.
EXCLUSION = ColumnDescription(
    name=EXCLUDED,
    role=ColumnRole.PROGRESS,
    type="string",
    title="Excluded",
    description="Why the run is left out of the statistics; empty where it is not.",
)


def describe_columns(
    rows: RunTableRows, known: Mapping[str, ColumnDescription] | None = None
) -> tuple[ColumnDescription, ...]:
    """Describe each column of a run table for its schema; `known` has facts beyond its values, by heading."""
    recorded = rows.recorded()
    words = dict.fromkeys(map(rows.layout.spelling.status_words.__getitem__, RunStatus))
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
            description=f"How far the run has come: {', '.join(words)}.",
        ),
        *(EXCLUSION for _ in rows.layout.exclusion),
        *(_stamp(name, recorded[name]) for name in rows.layout.stamps),
        *(_factor(column, rows) for column in rows.layout.factors),
        *(_repetition(name, has_warm_ups=WARM_UP in rows.layout.marks) for name in rows.layout.repetition),
        *(MARKS[name] for name in rows.layout.marks),
        *(
            ColumnDescription(name=name, role=ColumnRole.MEASURE, type=type_of_values(recorded[name]), title=name)
            for name in rows.layout.measures
        ),
        *(
            ColumnDescription(name=name, role=ColumnRole.EXTRA, type="string", title=name)
            for name in rows.layout.extras
        ),
    ]
    spelled = (replace(column, heading=_other_heading(rows, column.name)) for column in described)
    return tuple(_merged(column, (known or {}).get(column.name)) for column in spelled)


def _other_heading(rows: RunTableRows, name: str) -> str:
    heading = rows.layout.spelling.heading(name)
    return "" if heading == name else heading


def type_of_values(values: Iterable[Any]) -> str:
    """Return the type of a column with these values; `any` where no single type fits, or there are none."""
    present = [value for value in values if value is not None]
    kinds = set(map(_plain_kind, set(map(type, present))))  # there are few types among many values
    if float in kinds and not all(math.isfinite(value) for value in present if isinstance(value, float)):
        return "any"
    return next((name for name, fitting in _FITTING if kinds and kinds <= fitting), "any")


_FITTING = (("boolean", {bool}), ("integer", {int}), ("number", {int, float}), ("string", {str}))


def _plain_kind(kind: type) -> type:
    for plain in (bool, float):
        if issubclass(kind, plain):
            return plain
    return int if issubclass(kind, Integral) else str  # an object is written as its text


def _stamp(name: str, texts: Iterable[str | None]) -> ColumnDescription:
    event = name.removesuffix("_at")
    return ColumnDescription(
        name=name,
        role=ColumnRole.TIMESTAMP,
        type="datetime" if are_stamps([text for text in texts if text]) else "string",
        title=event.replace("_", " "),
        description=f"When the event {event} was emitted, in UTC.",
    )


def _factor(column: FactorColumn, rows: RunTableRows) -> ColumnDescription:
    name = column.name
    known = column.factor.treatments if column.factor else ()
    own = set(map(id, known))
    treatments = [*known, *(value for value in rows.values(name) if id(value) not in own)]
    kind = type_of_values(["None" if treatment is None else treatment for treatment in treatments])
    unit, when = (column.factor.unit, column.factor.when) if column.factor else ("", {})
    conditions = " and ".join(f"{other} is {' or '.join(map(str, wanted))}" for other, wanted in when.items())
    text = f"A factor; inactive unless {conditions}." if conditions else "A factor."
    return ColumnDescription(name=name, role=ColumnRole.FACTOR, type=kind, title=name, description=text, unit=unit)


def _repetition(name: str, *, has_warm_ups: bool) -> ColumnDescription:
    return ColumnDescription(
        name=name,
        role=ColumnRole.REPETITION,
        type="integer",
        title=name,
        description="Which repetition of its combination the run is, from 1; 0 for a warm-up run."
        if has_warm_ups
        else "Which repetition of its combination the run is, from 1.",
    )


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


def data_package(experiment: str, resources: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the description of a data package with these resources."""
    return {
        "profile": "data-package",
        "name": _slug(experiment).strip("-") or "experiment",
        "title": experiment,
        "description": f"Results of the experiment {experiment}, as Robot Runner keeps them.",
        "resources": resources,
    }


def file_resource(path: str, size: int, sha256: str) -> dict[str, Any]:
    """Return the resource of a file: its path below the data package (with `/`), bytes, and SHA-256.

    Example:
        >>> file_resource("runs.csv", 3, "00")["hash"]
        'sha256:00'
    """
    return {
        "name": _slug(path),
        "path": path,
        "format": path.rpartition(".")[2],
        "bytes": size,
        "hash": f"sha256:{sha256}",
    }


def table_resource(path: str, size: int, sha256: str, *, schema: str | None) -> dict[str, Any]:
    """Return the resource of a table in CSV; `schema` is the path of its Table Schema."""
    tabular = {"profile": "tabular-data-resource", "mediatype": "text/csv", "encoding": "utf-8"}
    return file_resource(path, size, sha256) | tabular | ({"schema": schema} if schema else {})


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9._-]+", "-", text.casefold())
