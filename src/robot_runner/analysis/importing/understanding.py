"""What was understood of results made elsewhere: shown before anything is written."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.column_roles import ColumnRoles, roles_of
from robot_runner.analysis.importing.foreign_runs import ForeignRun, read_runs
from robot_runner.analysis.importing.foreign_samples import ForeignSamples, understand_samples
from robot_runner.analysis.importing.foreign_table import ForeignTable, read_foreign_table
from robot_runner.analysis.importing.recomputation import check_recipes, guess_recipes
from robot_runner.analysis.importing.units import Unit, split_heading, unit_of
from robot_runner.design.columns import REPETITION, name_findings
from robot_runner.errors import AnalysisError, StorageError, did_you_mean
from robot_runner.storage.cells import number_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from robot_runner.analysis.importing.description import ImportDescription, Recipe

__all__ = ["Understanding", "understand"]

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
