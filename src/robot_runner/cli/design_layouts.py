"""The layout of a design: its squares, sequences, whole plots or blocks, as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.cli.console import Column, aligned, width_of
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from robot_runner.cli.console import UserConsole

#: More tables than this, and more rows of one, are left to `--json`, where not all are asked for.
_MOST_TABLES = 4
_MOST_ROWS = 40


def print_layouts(console: UserConsole, facts: Mapping[str, Any], *, shows_all: bool = False) -> None:
    """Print the tables that a design has among its facts.

    Args:
        console: where.
        facts: of the design.
        shows_all: whether long ones are printed to their end.
    """
    layouts = facts.get("layout", ())
    shown = layouts if shows_all else layouts[:_MOST_TABLES]
    for layout in shown:
        console.print()
        console.print(layout["title"], style="bold", markup=False)
        _print_table(console, [layout["heading"], *layout["rows"]], shows_all=shows_all)
    if len(shown) < len(layouts):
        console.print(f"… {counted(len(layouts) - len(shown), 'table')} more: --all shows them …", style="dim")


def _print_table(console: UserConsole, rows: Sequence[Sequence[str]], *, shows_all: bool) -> None:
    """Print rows, the first of which is the heading."""
    columns = [Column(str(cells[0]), width_of(list(cells))) for cells in zip(*rows, strict=True)]
    shown = rows if shows_all else rows[: _MOST_ROWS + 1]
    for place, row in enumerate(shown):
        console.print(aligned(columns, row), style="dim" if not place else None, soft_wrap=True, markup=False)
    if len(shown) < len(rows):
        console.print(f"… {counted(len(rows) - len(shown), 'row')} more: --all shows them …", style="dim")
