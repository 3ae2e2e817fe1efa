"""An experiment's results for other tools: Parquet files, and a data package that describes them.

The data package follows https://specs.frictionlessdata.io/data-package/; the run table in it is the CSV file with its
Table Schema, which every tool can read and validate, and the rest are Parquet files.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from robot_runner.analysis.sample_files import split_unit
from robot_runner.analysis.spreadsheet_cells import write_for_spreadsheets
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.storage.guarded_files import make_folder, open_to_read, open_to_write, replace
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.storage.table_schema import data_package, file_resource, table_resource

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from robot_runner.analysis.sample_files import SampleFile

__all__ = ["ExportContent", "arrow_table", "export_results"]

_RUNS_AT_ONCE = 50  # so that an export takes no more memory than the samples of so many runs
_UNIT = b"unit"


@dataclass(frozen=True, slots=True)
class ExportContent:
    """The content of an export.

    Attributes:
        name: the experiment's.
        folder: the experiment's, whose run table is copied with its schema.
        tables: data frames, by the name of the file that each becomes.
        sample_files: the kinds of raw samples.
        samples: reads the samples of one kind of some runs, given by their ids.
        unit: the unit of a column; empty where there is none or it is not known.
    """

    name: str
    folder: Path
    tables: Mapping[str, pd.DataFrame]
    sample_files: Sequence[SampleFile]
    samples: Callable[[SampleFile, Sequence[str]], pd.DataFrame]
    unit: Callable[[str], str]


def export_results(
    content: ExportContent, folder: Path | None = None, *, for_spreadsheets: bool = False
) -> tuple[Path, ...]:
    """Write everything into `folder` (None: `export/` in the experiment's folder), replacing an earlier export.

    Args:
        content: what to write.
        folder: where to.
        for_spreadsheets: whether the run table, and the report's tables where there is one, are written into
            `spreadsheets/`, too, without cells that a spreadsheet would execute.

    Returns:
        The files: the run table as CSV with its schema and as Parquet, phases and events, a file for each kind of raw
        samples, and `datapackage.json`.

    Raises:
        StorageError: a file cannot be written.
    """
    target = content.folder / "export" if folder is None else folder.expanduser()
    try:
        if folder is not None:
            target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(target, "made", error) from error
    make_folder(target / "samples", content.folder if folder is None else target)
    written = list(_copied_table(content, target))
    for name, frame in content.tables.items():
        _write_parquet(target / name, [arrow_table(frame, _units(content, frame))])
        written.append(target / name)
    for kind in content.sample_files:
        path = target / "samples" / f"{kind.plugin}.{kind.name.removesuffix('.csv')}.parquet"
        try:
            _write_parquet(path, _sample_tables(content, kind))
        except pa.ArrowInvalid:  # whole numbers in some runs, fractions or missing values in others
            _write_parquet(path, _sample_tables(content, kind, as_floats=True))
        written.append(path)
    copies = tuple(_copies_for_spreadsheets(content.folder, target)) if for_spreadsheets else ()
    package = target / "datapackage.json"
    text = json.dumps(_package(content, target, written), indent=2, ensure_ascii=False) + "\n"
    replace(package, text)
    return (*written, *copies, package)


def arrow_table(frame: pd.DataFrame, units: Mapping[str, str]) -> pa.Table:
    """Return a data frame as an Arrow table; treatments that are text as ordered dictionaries (factors, in R).

    Args:
        frame: the data frame.
        units: the units of its columns, kept as the fields' metadata.
    """
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


def _copied_table(content: ExportContent, target: Path) -> Iterator[Path]:
    for name in ("run_table.csv", "run_table.schema.json"):
        source = content.folder / name
        if source.exists():
            with open_to_read(source) as table, open_to_write(target / name) as copied:
                shutil.copyfileobj(table, copied)
            yield target / name


def _copies_for_spreadsheets(folder: Path, target: Path) -> Iterator[Path]:
    into = target / "spreadsheets"
    try:
        into.mkdir(exist_ok=True)
    except OSError as error:
        raise storage_error(into, "made", error) from error
    for source in (folder / "run_table.csv", *sorted((folder / "report" / "tables").glob("*.csv"))):
        write_for_spreadsheets(source, into / source.name, folder)
        yield into / source.name


def _units(content: ExportContent, frame: pd.DataFrame) -> dict[str, str]:
    return {name: content.unit(name) or split_unit(name)[1] for name in frame.columns}


def _sample_tables(content: ExportContent, kind: SampleFile, *, as_floats: bool = False) -> Iterator[pa.Table]:
    for start in range(0, len(kind.run_ids), _RUNS_AT_ONCE):
        runs = kind.run_ids[start : start + _RUNS_AT_ONCE]
        frame = content.samples(kind, runs)
        whole = frame[list(kind.columns)].select_dtypes("integer").columns
        frame = frame.astype(dict.fromkeys(whole, "float64")) if as_floats else frame
        yield arrow_table(frame, _units(content, frame))


def _write_parquet(path: Path, tables: Iterator[pa.Table] | Sequence[pa.Table]) -> None:
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


def _package(content: ExportContent, target: Path, files: Sequence[Path]) -> dict[str, Any]:
    listed = [_resource(target, path) for path in files if path.name != "run_table.schema.json"]
    return data_package(content.name, listed)


def _resource(target: Path, path: Path) -> dict[str, Any]:
    relative = path.relative_to(target).as_posix()
    with open_to_read(path) as file:
        size, sha256 = os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()
    if path.suffix == ".csv":
        has_schema = (target / "run_table.schema.json").exists()
        return table_resource(relative, size, sha256, schema="run_table.schema.json" if has_schema else None)
    described = {"type": "file", "mediatype": "application/vnd.apache.parquet", "robot_runner:key": RUN_ID}
    return file_resource(relative, size, sha256) | described
