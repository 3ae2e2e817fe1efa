"""Rows of cells beneath each other, printed as they come: the widths are known before the first row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.cells import cell_len, set_cell_size

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["Column", "aligned", "fitting", "width_of"]

_GAP = "  "
_WIDEST = 28


@dataclass(frozen=True, slots=True)
class Column:
    """One column of text.

    Attributes:
        width: in cells of a terminal.
        is_number: whether its cells stand to the right.

    Example:
        >>> aligned([Column("Task", 7), Column("Energy", 6, is_number=True)], ["Video", "877.1"])
        'Video     877.1'
    """

    heading: str
    width: int
    is_number: bool = False


def width_of(texts: Iterable[str]) -> int:
    """Return the width that a column needs for these texts, within reason."""
    return min(_WIDEST, max(map(cell_len, texts), default=0))


def fitting(columns: Sequence[Column], width: int) -> int:
    """Return how many of the first columns fit beside each other; one at least."""
    used = 0
    for place, column in enumerate(columns):
        used += column.width + (len(_GAP) if place else 0)
        if used > width:
            return max(1, place)
    return len(columns)


def aligned(columns: Sequence[Column], cells: Sequence[str]) -> str:
    """Return a row as one line; what is too long for its column ends in `…`."""
    parts = [_placed(column, cell) for column, cell in zip(columns, cells, strict=False)]
    return _GAP.join(parts).rstrip()


def _placed(column: Column, cell: str) -> str:
    length = cell_len(cell)
    if length > column.width:
        return set_cell_size(cell, column.width - 1) + "…"
    return f"{' ' * (column.width - length)}{cell}" if column.is_number else set_cell_size(cell, column.width)
