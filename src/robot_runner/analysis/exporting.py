"""An experiment's results for other tools: Parquet files, and a data package that describes them.

The data package follows https://specs.frictionlessdata.io/data-package/; the run table in it is the CSV file with its
Table Schema, which every tool can read and validate, and the rest are Parquet files.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from robot_runner.analysis.sample_files import SampleFile, split_unit
from robot_runner.analysis.samples import read_samples
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.storage.guarded_files import make_folder, open_to_read, open_to_write, read_text, replace
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.storage.table_schema import data_package, file_resource, table_resource

if TYPE_CHECKING:
    from robot_runner.analysis.raw_data import RawData
    from robot_runner.analysis.run_frame import ExperimentFacts

_RUNS_AT_ONCE = 50  # so that an export takes no more memory than the samples of so many runs
_UNIT = b"unit"


def export_results(
    results: ExperimentFacts,
    tables: Mapping[str, pd.DataFrame],
    raw: RawData,
    folder: Path | None = None,
    *,
    for_spreadsheets: bool = False,
) -> tuple[Path, ...]:
    """Write everything into `folder` (None: `export/` in the experiment's folder), replacing an earlier export.

    Args:
        results: the experiment.
        tables: of all its runs, by the names of their files.
        raw: its raw samples.
        folder: where to.
        for_spreadsheets: whether the run table, and the report's tables where there is one, are written into
            `spreadsheets/`, too, without cells that a spreadsheet would execute.

    Returns:
        The files: the run table as CSV with its schema and as Parquet, phases and events, a file for each kind of raw
        samples, and `datapackage.json`.

    Raises:
        StorageError: a file cannot be written.
    """
    target = results.folder / "export" if folder is None else folder.expanduser()
    with storage_errors(target, "made"):
        if folder is not None:
            target.mkdir(parents=True, exist_ok=True)
    make_folder(target / "samples", results.folder if folder is None else target)
    written = list(_copied_table(results, target))
    for table, frame in tables.items():
        name = f"{table}.parquet"
        _write_parquet(target / name, [arrow_table(frame, _units(results, frame))])
        written.append(target / name)
    for kind in raw.sample_files:
        path = target / "samples" / f"{kind.plugin}.{kind.name.removesuffix('.csv')}.parquet"
        try:
            _write_parquet(path, _sample_tables(results, raw, kind))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # a column is of one type in some runs, and not in all
            types = _types_of_all(_sample_tables(results, raw, kind))
            _write_parquet(path, (_with_types(table, types) for table in _sample_tables(results, raw, kind)))
        written.append(path)
    copies = tuple(_copies_for_spreadsheets(results.folder, target)) if for_spreadsheets else ()
    package = target / "datapackage.json"
    listed = [_resource(target, path) for path in written if path.name != "run_table.schema.json"]
    replace(package, json.dumps(data_package(results.name, listed), indent=2, ensure_ascii=False) + "\n")
    return (*written, *copies, package)


def arrow_table(frame: pd.DataFrame, units: Mapping[str, str]) -> pa.Table:
    """Return a data frame as an Arrow table; treatments that are text as ordered dictionaries (factors, in R)."""
    plain = frame.copy(deep=False)
    for name in plain.columns:
        if isinstance(plain[name].dtype, pd.CategoricalDtype):
            categories = plain[name].cat.categories
            if not all(isinstance(each, str) for each in categories):  # numbers are more use as numbers
                plain[name] = plain[name].astype(categories.dtype if plain[name].notna().all() else "object")
        elif plain[name].dtype == object:
            plain[name] = plain[name].map(lambda value: None if value is None else str(value))
    table = pa.Table.from_pandas(plain, preserve_index=False)
    fields = [_field(field, units.get(field.name, "")) for field in table.schema]
    return table.cast(pa.schema(fields, metadata=table.schema.metadata))


def _field(field: pa.Field, unit: str) -> pa.Field:
    kind = field.type
    if pa.types.is_dictionary(kind):  # of one width, so that tables of several runs fit together
        kind = pa.dictionary(pa.int32(), pa.string(), kind.ordered)
    described = field.with_type(kind)
    return described.with_metadata({_UNIT: unit.encode()}) if unit else described


def _copied_table(results: ExperimentFacts, target: Path) -> Iterator[Path]:
    for name in ("run_table.csv", "run_table.schema.json"):
        source = results.folder / name
        if source.exists():
            with open_to_read(source) as table, open_to_write(target / name) as copied:
                shutil.copyfileobj(table, copied)
            yield target / name


def _copies_for_spreadsheets(folder: Path, target: Path) -> Iterator[Path]:
    into = target / "spreadsheets"
    with storage_errors(into, "made"):
        into.mkdir(exist_ok=True)
    for source in (folder / "run_table.csv", *sorted((folder / "report" / "tables").glob("*.csv"))):
        write_for_spreadsheets(source, into / source.name, folder)
        yield into / source.name


def _units(results: ExperimentFacts, frame: pd.DataFrame) -> dict[str, str]:
    return {name: results.unit(name) or split_unit(name)[1] for name in frame.columns}


def _sample_tables(results: ExperimentFacts, raw: RawData, kind: SampleFile) -> Iterator[pa.Table]:
    for start in range(0, len(kind.run_ids), _RUNS_AT_ONCE):
        frame = read_samples(raw.request(kind, kind.run_ids[start : start + _RUNS_AT_ONCE], None))
        yield arrow_table(frame, _units(results, frame))


def _types_of_all(tables: Iterator[pa.Table]) -> dict[str, pa.DataType]:
    """Return the type that holds all values of each column: numbers where all are numbers, else texts."""
    found: dict[str, set[pa.DataType]] = {}
    for table in tables:
        for name, column in zip(table.column_names, table.columns, strict=True):
            found.setdefault(name, set()).update({column.type} if column.null_count < len(column) else ())
    texts, numbers = pa.dictionary(pa.int32(), pa.string()), {pa.int64(), pa.float64()}
    joint = {name: pa.float64() if types <= numbers else texts for name, types in found.items() if types}
    return joint | {name: next(iter(types)) for name, types in found.items() if len(types) == 1}


def _with_types(table: pa.Table, types: Mapping[str, pa.DataType]) -> pa.Table:
    for place, field in enumerate(table.schema):
        column, kind = table.column(place), types.get(field.name, field.type)
        if field.type == kind:
            continue
        if column.null_count == len(column):
            column = pa.chunked_array([pa.nulls(len(column), kind)])
        elif pa.types.is_dictionary(kind):
            column = column.cast(pa.string()).dictionary_encode()
        # Whole numbers beyond 2^53 are rounded, as in `Results.samples`.
        table = table.set_column(place, field.with_type(kind), column.cast(kind, safe=False))
    return table


def _write_parquet(path: Path, tables: Iterable[pa.Table]) -> None:
    with open_to_write(path) as file:
        writer: parquet.ParquetWriter | None = None
        try:
            for table in tables:
                if writer is None:
                    writer = parquet.ParquetWriter(file, table.schema, compression="zstd")
                writer.write_table(table.cast(writer.schema) if table.schema != writer.schema else table)
        finally:
            if writer is not None:
                writer.close()


def _resource(target: Path, path: Path) -> dict[str, Any]:
    relative = path.relative_to(target).as_posix()
    with open_to_read(path) as file:
        size, sha256 = os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()
    if path.suffix == ".csv":
        has_schema = (target / "run_table.schema.json").exists()
        return table_resource(relative, size, sha256, schema="run_table.schema.json" if has_schema else None)
    described = {"type": "file", "mediatype": "application/vnd.apache.parquet", "robot_runner:key": RUN_ID}
    return file_resource(relative, size, sha256) | described


_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
#: What makes a formula where a cell begins: also the wide forms that some spreadsheets take for the plain ones, and
#: what is skipped in front of them. Where a spreadsheet splits at another sign than the comma, a cell begins there.
_BEGINS_FORMULA = re.compile(r"(^|[;,|\t\r\n])(?=[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20])")


def harmless_cell(text: str) -> str:
    """Return a cell that a spreadsheet shows and does not execute: with `'` in front of what would be a formula.

    Example:
        >>> harmless_cell("=1+1"), harmless_cell("-1.5"), harmless_cell("Video"), harmless_cell("a;@b")
        ("'=1+1", '-1.5', 'Video', "a;'@b")
    """
    return text if _NUMBER.fullmatch(text) else _BEGINS_FORMULA.sub(r"\1'", text)


def write_for_spreadsheets(source: Path, target: Path, root: Path) -> None:
    """Write a copy of a CSV file with harmless cells, with the mark of UTF-8 that spreadsheets ask for.

    Raises:
        StorageError: it cannot be read or written.
    """
    text = read_text(source, root)
    written = io.StringIO()
    rows = csv.writer(written, lineterminator="\r\n")
    rows.writerows([harmless_cell(cell) for cell in row] for row in csv.reader(io.StringIO(text, newline="")))
    with open_to_write(target) as file:
        file.write(written.getvalue().encode("utf-8-sig"))
