"""What was understood of results made elsewhere: shown before anything is written."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.foreign_runs import ForeignRun, read_runs
from robot_runner.analysis.importing.foreign_samples import ForeignSamples, understand_samples
from robot_runner.analysis.importing.foreign_table import ForeignTable, read_foreign_table
from robot_runner.analysis.importing.recomputation import check_recipes, guess_recipes
from robot_runner.analysis.importing.units import Unit, split_heading, unit_of
from robot_runner.core.design.columns import REPETITION, name_findings
from robot_runner.core.errors import AnalysisError, StorageError, did_you_mean
from robot_runner.core.storage.cells import number_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from robot_runner.analysis.importing.description import ImportDescription, Recipe
    from robot_runner.analysis.importing.foreign_table import ForeignTable

__all__ = ["ColumnRoles", "Understanding", "roles_of", "understand"]


# Which column of a foreign run table is what: as the user says, or as it looks.

# As the earlier tools, the paper's Fig. 3 and people write them; blanks, underscores and case aside.
_RUN_ID = ("runid", "id", "run", "runnumber", "runname")
_STATUS = ("done", "status", "progress", "state")
_REPETITION = ("repetition", "repetitions", "rep", "repeat", "trial", "iteration", "replication")

_NUMBERED = re.compile(r"(.*?)[_-]repetition[_-](\d+)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ColumnRoles:
    """What the columns of a foreign run table are.

    Attributes:
        run_id: None where runs are to be numbered.
        status: None where a run counts as done if it has any measure.
        repetition: a column, or None.
        repetition_in_run_id: whether run ids end in `_repetition_0` and the like.
        factors, measures: columns in the order of the table.
        extras: columns that are kept as they are.
        notes: how roles were found that nobody told.
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
    the measures. So the earlier tools write them. What the user said comes first.

    Raises:
        AnalysisError: the user named a column that is not there.
    """
    _check_names(table, said)
    left = [name for name in table.headings if name not in said.ignore]
    told = {*(said.factors or ()), *(said.measures or ())}
    free = [name for name in left if name not in told]
    run_id = said.run_id or _named(free, _RUN_ID)
    status = said.status or _named([name for name in free if name != run_id], _STATUS)
    repetition = said.repetition or _named([name for name in free if name not in {run_id, status}], _REPETITION)
    rest = [name for name in left if name not in {run_id, status, repetition}]
    ids = table.column(run_id) if run_id else ()
    numbered = repetition is None and bool(ids) and all(_NUMBERED.match(each) for each in ids)
    found = [_NUMBERED.match(each) for each in ids] if numbered else []
    repeated = [(each[1], each[2]) for each in found if each] or (
        [(None, cell) for cell in table.column(repetition)] if repetition else []
    )
    factors = list(said.factors) if said.factors is not None else _guessed_factors(table, rest, said.measures, repeated)
    measures, extras = _split_rest(table, [name for name in rest if name not in factors], said.measures)
    notes = (
        [] if said.factors is not None or not factors else ["factors were told from measures by their repeating values"]
    )
    return ColumnRoles(
        run_id, status, repetition, numbered, tuple(factors), tuple(measures), tuple(extras), tuple(notes)
    )


def _check_names(table: ForeignTable, said: ImportDescription) -> None:
    single = [name for name in (said.run_id, said.status, said.repetition) if name]
    # A measure that the table lacks may come from a recipe.
    for name in (*single, *(said.factors or ()), *said.ignore):
        if name not in table.headings:
            fix = did_you_mean(name, table.headings)
            raise AnalysisError(f"there is no column {name!r}", where=table.path.name, fix=fix)


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
    count = len(table.rows)
    factors: list[str] = []
    for name in rest:
        if name in table.unnamed or (measures is not None and name in measures):
            continue
        cells = table.column(name)
        distinct = len(set(cells))
        is_number = table.is_numeric(name)
        if not all(cells) or (measures is None and split_heading(name)[1] is not None and distinct * 2 > count):
            break
        if distinct * 2 > count and (is_number or factors):
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


def _split_rest(
    table: ForeignTable, rest: Sequence[str], measures: tuple[str, ...] | None
) -> tuple[list[str], list[str]]:
    """Return the measures and the extras: text that is not a measure by the user's word is kept as it is."""
    if measures is not None:
        return [name for name in rest if name in measures], [name for name in rest if name not in measures]
    chosen = [name for name in rest if name not in table.unnamed and _is_measure(table, name)]
    return chosen, [name for name in rest if name not in chosen]


def _is_measure(table: ForeignTable, name: str) -> bool:
    """Return whether a column is empty still, or has numbers in half of its cells at least: the others are slips."""
    cells = [cell for cell in table.column(name) if cell]
    if not cells or table.is_numeric(name) or table.is_boolean(name):
        return True
    numbers = [cell for cell in cells if re.fullmatch(r"[+-]?[0-9.,eE+-]+", cell)]
    return 2 * len(numbers) >= len(cells)


_TABLE = "run_table.csv"


@dataclass(frozen=True, slots=True)
class Understanding:
    """Everything that was understood of a results folder.

    Attributes:
        root: the folder.
        name: the experiment's name.
        table: the run table, as text.
        roles: which column is what.
        headings: the name of each factor and measure here; the same as there, but for names that are taken.
        units: the unit of each measure of the table, where it is known.
        runs: the rows.
        samples: the raw files.
        recipes: which measure is computed from which samples.
        origin: `measured`, `simulated`, `estimated`, or None where nobody said.
        notes: what looked odd, and what was guessed.
    """

    root: Path
    name: str
    table: ForeignTable = field(repr=False)
    roles: ColumnRoles
    headings: Mapping[str, str]
    units: Mapping[str, Unit | None]
    runs: tuple[ForeignRun, ...] = field(repr=False)
    samples: tuple[ForeignSamples, ...]
    recipes: tuple[Recipe, ...]
    origin: str | None
    notes: tuple[str, ...]

    @property
    def new_measures(self) -> tuple[str, ...]:
        """Measures that the table lacks and that are computed from samples."""
        return tuple(recipe.measure for recipe in self.recipes if recipe.measure not in self.roles.measures)

    def treatments(self, factor: str) -> tuple[str, ...]:
        """Return the treatments of a factor: numbers ascending, False before True, others as they come."""
        texts = list(dict.fromkeys(run.treatments[factor] for run in self.runs))
        if self.table.is_boolean(factor):
            return tuple(sorted(texts))
        numbers = [number_of(text) for text in texts]
        if all(number is not None for number in numbers):
            texts.sort(key=lambda text: number_of(text) or 0)
        return tuple(texts)


def understand(root: Path, said: ImportDescription) -> Understanding:
    """Find out what is in a folder of results; nothing is written.

    Raises:
        StorageError: it cannot be read.
        AnalysisError: it cannot be understood, or what the user said is not so.
    """
    table = read_foreign_table(_table_path(root, said.table))
    if not table.rows:
        raise AnalysisError("there are no runs in it", where=str(table.path), fix="Name the table that holds the runs.")
    roles = roles_of(table, said)
    if not roles.measures and not said.recipes and not roles.factors:
        fix = "Name them: --factor and --measure."
        raise AnalysisError("no column is told to be a factor or a measure", where=str(table.path), fix=fix)
    notes = [*_table_notes(table), *roles.notes]
    runs = read_runs(root, table, roles, said, notes)
    folders = {run.source_id: run.folder for run in runs if run.folder is not None}
    samples, sample_notes = understand_samples(folders, said.samples, guess=said.guess)
    units = {name: unit_of(said.units[name]) if name in said.units else _unit(table, name) for name in roles.measures}
    check_recipes(said.recipes, samples)
    guessed = guess_recipes(units, samples, said.recipes) if said.guess else []
    return Understanding(
        root=root,
        name=said.name or _folder_name(root),
        table=table,
        roles=roles,
        headings=_headings(roles, [each.measure for each in said.recipes if each.measure not in units], notes),
        units=units,
        runs=tuple(runs),
        samples=tuple(samples),
        recipes=(*said.recipes, *guessed),
        origin=said.origin,
        notes=(*notes, *sample_notes),
    )


def _table_path(root: Path, told: str | None) -> Path:
    if not root.is_dir():
        raise StorageError("there is no such folder", where=str(root), fix="Name the folder that holds the results.")
    if told is not None:
        if (root / told).is_file():
            return root / told
        names = [path.name for path in root.glob("*.csv")]
        raise StorageError(f"there is no {told!r} in it", where=str(root), fix=did_you_mean(told, names))
    if (root / _TABLE).is_file():
        return root / _TABLE
    tables = sorted(root.glob("*.csv"))
    if len(tables) == 1:
        return tables[0]
    listed = ", ".join(path.name for path in tables[:10])
    problem = f"which of {listed} is the run table?" if tables else "there is no CSV file in it"
    raise StorageError(problem, where=str(root), fix="Name the run table: --table FILE.")


def _folder_name(root: Path) -> str:
    name = re.sub(r"[^A-Za-z0-9 ._-]+", "_", root.resolve().name).strip(" ._-")
    return name[:128] or "imported"


def _table_notes(table: ForeignTable) -> list[str]:
    words = table.dialect.words
    return [*([f"{table.path.name} is written with {words}"] if words else []), *table.notes]


def _unit(table: ForeignTable, measure: str) -> Unit | None:
    return split_heading(measure)[1] if measure in table.headings and table.is_numeric(measure) else None


def _headings(roles: ColumnRoles, computed: Sequence[str], notes: list[str]) -> dict[str, str]:
    """Return the name of each column here; a name that our run table takes for itself gets a line at its end."""
    headings: dict[str, str] = {}
    repeated = 2 if roles.repetition or roles.repetition_in_run_id else 1
    for name in (*roles.factors, *roles.measures, *computed, *roles.extras):
        here = name
        while any(name_findings(here, kind="column", repetitions=repeated)) or here == REPETITION:
            here = f"{here.strip()}_"
        if here != name:
            notes.append(f"column {name!r} is called {here!r} here: the name is taken")
        headings[name] = here
    return headings
