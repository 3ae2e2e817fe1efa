"""Reads the raw data of other plugins: columns of numbers, and the rows of a table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.guarded_files import MissingFileError, open_text


def heading_of(path: Path) -> list[str]:
    """Return the names of a file's columns.

    Raises:
        AnalysisError: the file is missing.
    """
    try:
        with open_text(path) as file:
            return next(csv.reader(file), [])
    except MissingFileError as error:
        raise _not_there(path) from error


def read_numbers(path: Path, columns: Sequence[str]) -> list[list[float]]:
    """Return these columns of a file of samples, without rows in which one of them is empty.

    Raises:
        AnalysisError: the file or one of the columns is missing, or a cell is not a number.
    """
    values: list[list[float]] = [[] for _ in columns]
    for row in rows_of(path, columns):
        if not all(row[column] for column in columns):
            continue
        for column, cells in zip(columns, values, strict=True):
            cells.append(number_of(path, row[column]))
    return values


def rows_of(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the rows of a file with these columns.

    Raises:
        AnalysisError: the file or one of the columns is missing.
    """
    try:
        with open_text(path) as file:
            reader = csv.DictReader(file)
            missing = [column for column in columns if column not in (reader.fieldnames or ())]
            rows = list(reader)
    except MissingFileError as error:
        raise _not_there(path) from error
    if missing:
        fix = "Name a plugin whose raw data hold it."
        raise AnalysisError(f"the file has no column {missing[0]!r}", where=str(path), fix=fix)
    return rows


def number_of(path: Path, cell: str | None) -> float:
    """Return a cell as a number.

    Raises:
        AnalysisError: the cell is not a number.
    """
    try:
        return float(cell or "")
    except ValueError as error:
        fix = "Leave this run out: its raw data are damaged."
        raise AnalysisError(f"{cell!r} is not a number", where=str(path), fix=fix) from error


def _not_there(path: Path) -> AnalysisError:
    fix = "Have the experiment's plugins measure it, or name the plugin that does."
    return AnalysisError("there is no such file", where=str(path), fix=fix)
