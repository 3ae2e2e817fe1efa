"""Logs of meters as the earlier tools read them: a mapping from column to a mapping from row to value."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Table", "read_table"]

Table = dict[str, dict[int, Any]]


def read_table(path: Path | str, names: Sequence[str] | None = None) -> Table:
    """Read a CSV file.

    Args:
        path: the file.
        names: the columns' names; None takes them from the first line.

    Returns:
        The values of each column by row, from 0: numbers where a cell is one, None where it is empty.

    Raises:
        OSError: it cannot be read.
    """
    with Path(path).open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if row]
    if names is None:
        names, rows = (rows[0], rows[1:]) if rows else ([], [])
    return {
        name.strip(): {place: _value(row[column]) if column < len(row) else None for place, row in enumerate(rows)}
        for column, name in enumerate(names)
    }


def _value(text: str) -> Any:
    text = text.strip()
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text or None
