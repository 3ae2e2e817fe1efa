"""An experiment's results for other tools: Parquet files, and a data package that describes them.

The data package follows https://specs.frictionlessdata.io/data-package/. Its run table is the CSV file with its Table
Schema, which every tool can read and validate; the other resources are Parquet files.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import re
import shutil
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from robot_runner.analysis.sample_files import SampleFile, split_unit
from robot_runner.analysis.samples import read_samples
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import make_folder, open_to_read, open_to_write, read_text, replace
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.storage.table_schema import data_package, file_resource, table_resource

if TYPE_CHECKING:
    from robot_runner.analysis.raw_data import RawData
    from robot_runner.analysis.run_frame import ExperimentFacts

_RUNS_AT_ONCE = 50  # limits the memory to the samples of so many runs
_UNIT = b"unit"


def export_results(
    results: ExperimentFacts,
    tables: Mapping[str, pd.DataFrame],
    raw: RawData,
    folder: Path | None,
    *,
    for_spreadsheets: bool,
) -> tuple[Path, ...]:
    """Export everything into `folder` (None: `export/` in the experiment's folder), replacing an earlier export.

    `tables` are of all runs, by file name. For spreadsheets, the run table and the tables of a report are written into
    `spreadsheets/`, too, as workbooks.

    Returns:
        The files: the run table as CSV with its schema and as Parquet, phases and events, one file for each kind of raw
        samples, and `datapackage.json`.

    Raises:
        StorageError: a file cannot be written, or the folder has a run table that no export has written.
    """
    target = results.folder / "export" if folder is None else folder.expanduser()
    _keep_other_table(target)
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
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # a column's type differs between runs
            types = _types_of_all(_sample_tables(results, raw, kind))
            _write_parquet(path, (_with_types(table, types) for table in _sample_tables(results, raw, kind)))
        written.append(path)
    package = target / "datapackage.json"
    listed = [_resource(target, path) for path in written if path.name != "run_table.schema.json"]
    replace(package, json.dumps(data_package(results.name, listed), indent=2, ensure_ascii=False) + "\n")
    copies = tuple(_copies_for_spreadsheets(results, target)) if for_spreadsheets else ()
    return (*written, *copies, package)


def _keep_other_table(target: Path) -> None:
    """Refuse a folder with a run table that may be the only one: an experiment's, or what another tool has written."""
    is_export = (target / "datapackage.json").exists() and not ExperimentFolder(target).journal.exists()
    if (target / "run_table.csv").exists() and not is_export:
        problem = "the folder has a run_table.csv that no export has written"
        raise StorageError(problem, where=str(target), fix="Name another folder.")


def arrow_table(frame: pd.DataFrame, units: Mapping[str, str]) -> pa.Table:
    """Return a data frame as an Arrow table; text treatments become ordered dictionaries (factors in R)."""
    plain = frame.copy(deep=False)
    for name in plain.columns:
        if isinstance(plain[name].dtype, pd.CategoricalDtype):
            categories = plain[name].cat.categories
            if not all(isinstance(each, str) for each in categories):  # numbers stay numbers
                plain[name] = plain[name].astype(categories.dtype if plain[name].notna().all() else "object")
        elif plain[name].dtype == object:
            plain[name] = plain[name].map(lambda value: None if value is None else str(value))
    table = pa.Table.from_pandas(plain, preserve_index=False)
    fields = [_field(field, units.get(field.name, "")) for field in table.schema]
    return table.cast(pa.schema(fields, metadata=table.schema.metadata))


def _field(field: pa.Field, unit: str) -> pa.Field:
    kind = field.type
    if pa.types.is_dictionary(kind):  # one width, so that tables of several runs can be joined
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


def _copies_for_spreadsheets(results: ExperimentFacts, target: Path) -> Iterator[Path]:
    into = target / "spreadsheets"
    with storage_errors(into, "made"):
        into.mkdir(exist_ok=True)
    numeric = {name for name, column in results.columns.items() if column.type in {"number", "integer"}}
    for source in (results.folder / "run_table.csv", *sorted((results.folder / "report" / "tables").glob("*.csv"))):
        rows = csv.reader(io.StringIO(read_text(source, results.folder), newline=""))
        written = into / f"{source.stem}.xlsx"
        write_workbook(rows, written, numeric if source.name == "run_table.csv" else ())
        yield written


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


#: The limits of a sheet and of a cell in Excel ("Excel specifications and limits").
_MOST_ROWS, _MOST_COLUMNS, _LONGEST_TEXT = 1_048_576, 16_384, 32_767
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
#: What XML cannot hold, and what would be read as one of these, is written by its number.
_NO_XML = re.compile(r"[\x00-\x08\x0b-\x1f\ufffe\uffff]|_(?=x[0-9A-Fa-f]{4}_)")
_OFFICE = "http://schemas.openxmlformats.org"
#: The parts of a workbook of one sheet (ECMA-376), but for the sheet.
_WORKBOOK = {
    "[Content_Types].xml": f'<Types xmlns="{_OFFICE}/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Override PartName="/xl/workbook.xml" '
    'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/>'
    '<Override PartName="/xl/sheet.xml" '
    'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml"/></Types>',
    "_rels/.rels": f'<Relationships xmlns="{_OFFICE}/package/2006/relationships"><Relationship Id="r1" '
    f'Type="{_OFFICE}/officeDocument/2006/relationships/officeDocument" Target="xl/workbook.xml"/></Relationships>',
    "xl/workbook.xml": f'<workbook xmlns="{_OFFICE}/spreadsheetml/2006/main" '
    f'xmlns:r="{_OFFICE}/officeDocument/2006/relationships">'
    '<sheets><sheet name="Table" sheetId="1" r:id="r1"/></sheets></workbook>',
    "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{_OFFICE}/package/2006/relationships"><Relationship Id="r1" '
    f'Type="{_OFFICE}/officeDocument/2006/relationships/worksheet" Target="sheet.xml"/></Relationships>',
}


def write_workbook(rows: Iterable[Sequence[str]], target: Path, numeric: Collection[str] = ()) -> None:
    """Write the rows of a CSV file as a workbook, whose cells mean the same in every language of a spreadsheet.

    A text is a text, also one that would be a formula in a CSV file. A number is a cell that shows the same digits, and
    any number below a heading in `numeric`. The library XlsxWriter would round numbers to 16 digits, and openpyxl would
    write another file each time.

    Raises:
        StorageError: the workbook cannot be written, or the table has too many rows or columns.
    """
    table = list(rows)
    sizes = ((len(table), _MOST_ROWS, "rows"), (max(map(len, table), default=0), _MOST_COLUMNS, "columns"))
    for count, most, what in sizes:
        if count > most:
            problem = f"the table has {count:,} {what}, and a workbook holds {most:,}"
            raise StorageError(problem, where=str(target), fix="Export without --spreadsheets, and read the CSV file.")
    is_numeric = [name in numeric for name in table[0]] if table else []
    written = "".join(
        f"<row>{''.join(map(_workbook_cell, row, chain(is_numeric, repeat(object=False))))}</row>"
        if place
        else f"<row>{''.join(map(_text, row))}</row>"
        for place, row in enumerate(table)
    )
    sheet = f'<worksheet xmlns="{_OFFICE}/spreadsheetml/2006/main"><sheetData>{written}</sheetData></worksheet>'
    with open_to_write(target) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in {**_WORKBOOK, "xl/sheet.xml": sheet}.items():
            declared = f'<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n{text}'
            archive.writestr(zipfile.ZipInfo(name), declared, zipfile.ZIP_DEFLATED)  # of no day: the same bytes again


def _workbook_cell(text: str, is_numeric: bool) -> str:
    if not _NUMBER.fullmatch(text):
        return _text(text)
    number = float(text)
    is_as_shown = text in {repr(number), f"{number:.0f}"}  # 1.10 may be a version, and 2**53 + 1 would be rounded
    return f"<c><v>{text}</v></c>" if math.isfinite(number) and (is_numeric or is_as_shown) else _text(text)


def _text(text: str) -> str:
    if not text:
        return "<c/>"
    if len(text) > _LONGEST_TEXT:
        text = f"{text[: _LONGEST_TEXT - 1]}…"
    plain = escape(_NO_XML.sub(lambda found: f"_x{ord(found[0]):04X}_", text))
    return f'<c t="inlineStr"><is><t xml:space="preserve">{plain}</t></is></c>'
