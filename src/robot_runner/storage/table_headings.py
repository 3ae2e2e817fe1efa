"""The first line of a run table's file: which heading belongs to which column, in any order."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.design.columns import RUN_ID, STATUS
from robot_runner.errors import nearest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.storage.table_findings import TableFindings
    from robot_runner.storage.table_layout import TableLayout

__all__ = ["Headings", "delimiter_of", "match_headings"]

_DELIMITERS = (",", ";", "\t")

# As in the paper's Fig. 3, as people write them, and as the earlier tools did.
_PROGRESS = {
    "run_id": RUN_ID,
    "run id": RUN_ID,
    "id": RUN_ID,
    "__run_id": RUN_ID,
    "status": STATUS,
    "__done": STATUS,
}
_EARLIER = frozenset({"__run_id", "__done"})


@dataclass(frozen=True, slots=True)
class Headings:
    """Where the columns of a layout stand in a file.

    Attributes:
        places: the place of each column that is there, counted from 0, by its name in the layout.
        extras: the columns that are a user's own, in the order of the file; they are in `places` as well.
        width: how many cells a row has.
    """

    places: Mapping[str, int]
    extras: tuple[str, ...]
    width: int


def delimiter_of(first_line: str, layout: TableLayout) -> str:
    """Return what stands between the cells: the delimiter that makes most of the layout's headings appear."""
    known = {layout.spelling.heading(name).casefold() for name in layout.columns} | set(_PROGRESS)

    def recognised(delimiter: str) -> int:
        cells = next(csv.reader([first_line], delimiter=delimiter), [])
        return sum(cell.strip().casefold() in known for cell in cells)

    return max(_DELIMITERS, key=recognised)


def match_headings(cells: Sequence[str], layout: TableLayout, findings: TableFindings, *, line: int) -> Headings:
    """Match the first line of a file with the columns of a layout.

    Args:
        cells: the first line that is not blank.
        layout: the columns that the table is to have.
        findings: takes headings that are missing, empty, or there twice.
        line: the number of the line.
    """
    trimmed = [cell.strip() for cell in cells]
    while trimmed and not trimmed[-1]:
        trimmed.pop()  # what a spreadsheet leaves behind a deleted column
    names = _names(trimmed, layout)
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        if not name:
            findings.error(f"heading {place + 1} is empty", "Name the column, or delete it.", line=line)
        elif name in places:
            findings.error(f"heading {name!r} is there twice", "Rename or delete one.", line=line, column=name)
        else:
            places[name] = place
    extras = tuple(name for name in places if name not in layout.columns or name in layout.extras)
    for name in layout.factor_names:
        if name not in places:
            near = nearest(name, extras)
            fix = f"Rename {near!r}." if near else f"Add a column {name!r}."
            findings.error(f"the column of factor {name!r} is missing", fix, line=line)
    return Headings(places, extras, len(names))


def _names(trimmed: Sequence[str], layout: TableLayout) -> list[str]:
    """Return the column that each heading means; factors and measures are taken as they are written."""
    named = [layout.spelling.name(heading) for heading in trimmed]
    # A user's own column `id` beside a `__run_id` is a column of its own.
    taken = {*named, *(_PROGRESS[name] for name in named if name in _EARLIER)}
    names = []
    for name in named:
        meant = _PROGRESS.get(" ".join(name.casefold().split()), name)
        is_meant = name in _EARLIER or meant not in taken
        names.append(meant if is_meant and name not in layout.columns else name)
    return names
