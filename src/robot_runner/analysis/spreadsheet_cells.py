"""Tables as CSV in which no cell is a formula, for spreadsheets: a copy, on request.

A spreadsheet executes a cell that begins with `=`, `+`, `-` or `@`, whoever wrote it: a treatment, an operator's note,
a line that a robot printed (OWASP, CSV Injection). The tables themselves keep what was measured, byte for byte.
"""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING

from robot_runner.core.storage.guarded_files import open_to_write, read_text

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["harmless_cell", "write_for_spreadsheets"]

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

    Args:
        source: the file, in the experiment's folder `root`.
        target: the copy; an earlier one is replaced.
        root: the experiment's folder.

    Raises:
        StorageError: it cannot be read or written.
    """
    text = read_text(source, root)
    written = io.StringIO()
    rows = csv.writer(written, lineterminator="\r\n")
    rows.writerows([harmless_cell(cell) for cell in row] for row in csv.reader(io.StringIO(text, newline="")))
    with open_to_write(target) as file:
        file.write(written.getvalue().encode("utf-8-sig"))
