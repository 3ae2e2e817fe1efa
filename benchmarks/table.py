"""How a benchmark says its figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["Judged", "Row", "print_table"]


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


class Judged(NamedTuple):
    """A share in percent, with the bounds that it is expected between.

    Attributes:
        lowest, highest: of several shares, or of one.
        why: the bounds are others than usual; empty otherwise.
        slack: what chance may add to either side.

    Example:
        >>> Judged("t-test, n 5", 4.2, 4.9, (3.5, 6.5)).holds
        True
    """

    figure: str
    lowest: float
    highest: float
    bounds: tuple[float, float]
    why: str = ""
    beside: str = ""
    slack: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether all shares lie between the bounds."""
        return self.bounds[0] - self.slack <= self.lowest and self.highest <= self.bounds[1] + self.slack

    @property
    def row(self) -> Row:
        """The line of a table."""
        value = f"{self.lowest:.1f}" + (f" to {self.highest:.1f}" if self.highest != self.lowest else "") + " %"
        bounds = f"{self.bounds[0]:g} to {self.bounds[1]:g} %" + (f": {self.why}" if self.why else "")
        return Row(self.figure, value, self.beside, "holds" if self.holds else "DOES NOT HOLD", bounds)


def print_table(title: str, rows: Iterable[Row]) -> None:
    """Print the rows, aligned, under their title."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("figure")
    for heading in ("value", "floor or alternative", "ratio", "bound"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(*row)
    Console(width=130, highlight=False, markup=False, soft_wrap=True).print(table)
