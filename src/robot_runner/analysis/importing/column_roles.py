"""Which column of another tool's run table is what: as the user says, or as it looks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.units import split_heading
from robot_runner.core.errors import AnalysisError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.analysis.importing.description import ImportDescription
    from robot_runner.analysis.importing.foreign_table import ForeignTable

__all__ = ["ColumnRoles", "roles_of"]

# As the earlier tools, the paper's Fig. 3 and people write them; blanks, underscores and case are ignored.
_RUN_ID = ("runid", "id", "run", "runnumber", "runname")
_STATUS = ("done", "status", "progress", "state")
_REPETITION = ("repetition", "repetitions", "rep", "repeat", "trial", "iteration", "replication")

_NUMBERED = re.compile(r"(.*?)[_-]repetition[_-](\d+)$", re.IGNORECASE)
_LIKE_A_NUMBER = re.compile(r"[+-]?[0-9.,eE+-]+")


@dataclass(frozen=True, slots=True)
class ColumnRoles:
    """What the columns of a run table are.

    Attributes:
        run_id: None where runs are to be numbered.
        status: None where a run counts as done if it has any measure.
        repetition: a column, or None.
        repetition_in_run_id: whether run ids end in `_repetition_0` and the like.
        factors, measures: columns in the order of the table.
        extras: columns that are kept as they are.
        notes: how roles were found that the user did not give.
    """

    run_id: str | None
    status: str | None
    repetition: str | None
    repetition_in_run_id: bool
    factors: tuple[str, ...]
    measures: tuple[str, ...]
    extras: tuple[str, ...]
    notes: tuple[str, ...]

    def repetition_of(self, run_id: str) -> int | None:
        """Return the number in a run id such as `run_3_repetition_1`."""
        found = _NUMBERED.match(run_id)
        return int(found[2]) if found and self.repetition_in_run_id else None


def roles_of(table: ForeignTable, said: ImportDescription) -> ColumnRoles:
    """Find out what each column is.

    Columns after the run's id and status are factors as long as their values repeat; the first that does not begins
    the measures, as in the tables of the earlier tools. What the user said comes first.

    Raises:
        AnalysisError: the user named a column that does not exist.
    """
    # A measure that the table lacks may come from a recipe.
    for name in filter(None, (said.run_id, said.status, said.repetition, *(said.factors or ()), *said.ignore)):
        if name not in table.headings:
            fix = did_you_mean(name, table.headings)
            raise AnalysisError(f"there is no column {name!r}", where=table.path.name, fix=fix)
    left = [name for name in table.headings if name not in said.ignore]
    free = [name for name in left if name not in {*(said.factors or ()), *(said.measures or ())}]
    run_id = said.run_id or _named(free, _RUN_ID)
    status = said.status or _named([name for name in free if name != run_id], _STATUS)
    repetition = said.repetition or _named([name for name in free if name not in {run_id, status}], _REPETITION)
    rest = [name for name in left if name not in {run_id, status, repetition}]
    numbered = [_NUMBERED.match(each) for each in table.column(run_id)] if run_id and repetition is None else []
    in_run_id = bool(numbered) and all(numbered)
    if in_run_id:
        repeated: list[tuple[str | None, str]] = [(each[1], each[2]) for each in numbered if each]
    else:
        repeated = [(None, cell) for cell in table.column(repetition)] if repetition else []
    factors = said.factors if said.factors is not None else _guessed_factors(table, rest, said.measures, repeated)
    others = [name for name in rest if name not in factors]
    measures = tuple(name for name in others if _is_measure(table, name, said.measures))
    extras = tuple(name for name in others if name not in measures)
    is_guessed = said.factors is None and bool(factors)
    notes = ("factors were told from measures by their repeating values",) if is_guessed else ()
    return ColumnRoles(run_id, status, repetition, in_run_id, tuple(factors), measures, extras, notes)


def _named(headings: Sequence[str], known: Sequence[str]) -> str | None:
    folded = {re.sub(r"[\s_-]", "", name.casefold()): name for name in reversed(headings)}
    return next((folded[name] for name in known if name in folded), None)


def _guessed_factors(
    table: ForeignTable,
    rest: Sequence[str],
    measures: tuple[str, ...] | None,
    repeated: Sequence[tuple[str | None, str]],
) -> list[str]:
    """Return the columns that hold treatments.

    Args:
        table: the run table.
        rest: its columns, less the run's id and the like.
        measures: those that the user named, or None.
        repeated: for each run the name of its combination (None where it is not known), and which repetition it is.
    """
    factors: list[str] = []
    for name in rest:
        if name in table.unnamed or name in (measures or ()):
            continue
        cells = table.column(name)
        is_number = table.is_numeric(name)
        mostly_differs = len(set(cells)) * 2 > len(cells)
        has_unit = measures is None and split_heading(name)[1] is not None
        if not all(cells) or (mostly_differs and (has_unit or is_number or factors)):
            break
        if is_number and repeated and _differs_between_repetitions(table, name, factors, repeated):
            break
        factors.append(name)
    return factors


def _differs_between_repetitions(
    table: ForeignTable, name: str, factors: Sequence[str], repeated: Sequence[tuple[str | None, str]]
) -> bool:
    """Return whether a column differs between repetitions of a combination that is known without it: so it is measured.

    Measured numbers repeat, too, where they are few or round.
    """
    treatments = zip(*(table.column(factor) for factor in factors), strict=True) if factors else [()] * len(repeated)
    combinations = [(named,) if named else cells for cells, (named, _) in zip(treatments, repeated, strict=True)]
    is_known = len({*zip(combinations, (which for _, which in repeated), strict=True)}) == len(repeated)
    return is_known and len({*zip(combinations, table.column(name), strict=True)}) > len({*combinations})


def _is_measure(table: ForeignTable, name: str, measures: tuple[str, ...] | None) -> bool:
    """Return whether a column is a measure: as the user says, else one that is empty still, or has mostly numbers."""
    if measures is not None:
        return name in measures
    if name in table.unnamed:
        return False
    cells = [cell for cell in table.column(name) if cell]
    if not cells or table.is_numeric(name) or table.is_boolean(name):
        return True
    return 2 * len([cell for cell in cells if _LIKE_A_NUMBER.fullmatch(cell)]) >= len(cells)
