"""`run_table.csv`: the run table for people, R and pandas, readable without Robot Runner."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.storage.cells import quoted
from robot_runner.storage.safe_write import write_beside_and_rename

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.storage.run_table_rows import RunTableRows

__all__ = ["table_text", "write_run_table"]

_ROWS_AT_ONCE = 500  # what fits into a processor's cache


def write_run_table(path: Path, rows: RunTableRows) -> None:
    """Write the run table beside `path` and rename it; the old file is intact until the new one is on the disk.

    Raises:
        StorageError: it cannot be written.
    """
    write_beside_and_rename(path, lambda file: file.writelines(table_text(rows)))


def table_text(rows: RunTableRows) -> Iterator[str]:
    r"""Yield the run table as CSV in pieces: UTF-8, commas, lines that end in `\n`, an empty cell for what is missing.

    The columns stand in the order of the layout, see `TableLayout`.
    """
    columns = rows.columns
    yield ",".join(quoted(rows.layout.spelling.heading(column.name)) for column in columns) + "\n"
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, len(rows))
        cells = [column.cells(start, stop) for column in columns]
        yield "\n".join(map(",".join, zip(*cells, strict=True))) + "\n"
