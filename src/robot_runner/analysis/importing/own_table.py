"""A run table that Robot Runner wrote, without its schema and journal: which runs of it are not analysed."""

from __future__ import annotations

from dataclasses import replace
from itertools import compress
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.units import MISSING
from robot_runner.core.design.columns import BATCH, EXCLUDED, RUN_ID, STAMP_COLUMNS, STATUS, WARM_UP
from robot_runner.core.words import counted, listed

if TYPE_CHECKING:
    from collections.abc import Collection

    from robot_runner.analysis.importing.foreign_table import ForeignTable

#: The headings of runs and their status, in tables of ours and in those that go on from an earlier tool's.
_RUNS = ((RUN_ID, STATUS), ("__run_id", "__done"))
_WARMED_UP = "warm-up"
_NOT_SO = MISSING | {"false"}
_BATCHES = f"runs of several batches are compared as one: what changed between them may pass for an effect ({BATCH})"


def without_unanalysed(table: ForeignTable, named: Collection[str | None] = ()) -> ForeignTable:
    """Return a table without the warm-up and the excluded runs of Robot Runner; notes tell which, and why.

    The columns that tell of them are left out as well, and so are the batch and those of events that no run had.
    Another table is returned as it is, and so are columns that the user has `named`, and the runs of which these tell.

    Example:
        >>> without_unanalysed(table).notes  # doctest: +SKIP
        ('2 runs left out that Robot Runner does not analyse: w_1 (warm-up), r_2 (the robot fell)',)
    """
    ids = next((name for name, status in _RUNS if {name, status} <= {*table.headings}), None)
    if ids is None or not table.rows:
        return table
    runs, notes = table.column(ids), list(table.notes)
    why = dict.fromkeys(runs, "")
    headings = [name for name in table.headings if name not in named]
    told_by = [name for name in (WARM_UP, EXCLUDED) if name in headings and table.is_boolean(name) == (name == WARM_UP)]
    for name in told_by:
        for run, cell in zip(runs, table.column(name), strict=True):
            if cell.casefold() not in _NOT_SO:
                why[run] = why[run] or (_WARMED_UP if name == WARM_UP else cell)
    left_out = [f"{run} ({reason})" for run, reason in why.items() if reason]
    if left_out:
        notes.append(f"{counted(len(left_out), 'run')} left out that Robot Runner does not analyse: {listed(left_out)}")
    batch = [BATCH] if BATCH in headings else []
    notes += [_BATCHES] * len(batch)
    empty = [name for name in STAMP_COLUMNS if name in headings and not any(table.column(name))]
    has_column = [name not in (*empty, *told_by, *batch) for name in table.headings]
    is_kept = [not why[run] for run in runs]
    rows = tuple(tuple(compress(row, has_column)) for row in compress(table.rows, is_kept))
    kept, lines = tuple(compress(table.headings, has_column)), tuple(compress(table.lines, is_kept))
    return replace(table, headings=kept, rows=rows, lines=lines, notes=tuple(notes))
