"""How a benchmark says its figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["Row", "print_table"]


class Row(NamedTuple):
    """One figure, as text with its unit; what does not apply is left empty.

    Example:
        >>> Row("robot-runner --help", "68 ms", "14 ms (interpreter's start)", "4.9", "7").bound
        '7'
    """

    figure: str
    value: str
    floor: str = ""
    ratio: str = ""
    bound: str = ""


def print_table(title: str, rows: Iterable[Row]) -> None:
    """Print the rows, aligned, under their title."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("figure")
    for heading in ("value", "floor or alternative", "ratio", "bound"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(*row)
    Console(width=130, highlight=False, markup=False, soft_wrap=True).print(table)
