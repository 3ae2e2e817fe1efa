"""Understand results from elsewhere; the user sees the understanding before anything is written."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from pathlib import Path

from robot_runner.analysis.declared_design import structure_findings
from robot_runner.analysis.importing.column_evidence import Role, RoleGuess
from robot_runner.analysis.importing.column_roles import ColumnRoles, roles_of
from robot_runner.analysis.importing.description import ImportDescription, Recipe, SamplesDescription
from robot_runner.analysis.importing.foreign_runs import TABLE, ForeignRun, read_runs
from robot_runner.analysis.importing.foreign_samples import ForeignSamples, understand_samples
from robot_runner.analysis.importing.foreign_table import ForeignTable, read_foreign_table, without_unanalysed
from robot_runner.analysis.importing.recomputation import check_recipes, guess_recipes
from robot_runner.analysis.importing.units import Unit, unit_of
from robot_runner.core.design.columns import REPETITION, is_fit_for_heading, name_findings
from robot_runner.core.errors import AnalysisError, Finding, StorageError, did_you_mean
from robot_runner.core.storage.cells import number_of
from robot_runner.core.words import counted, enumerated, listed, one_line

_WORKBOOKS = {".xlsx", ".xlsm", ".xls", ".ods"}
_SHOWN_TABLES = 10
_SHOWN_CELLS = 4
#: What spreadsheets write before the means and sums under a table, in small letters.
_SUMMARIES = (
    "mean average avg median total sum min max minimum maximum sd std stdev stddev variance mittelwert durchschnitt mw "
    "summe gesamt standardabweichung stabw moyenne somme media promedio suma somma gemiddelde totaal"
)
#: What benchmarks and subtotals write behind the name of the runs that a row sums up: `BM_plan_mean`, `Husky Total`.
_SUMMARY = re.compile(rf"(.+)[ _](?:{_SUMMARIES.replace(' ', '|')}|cv|count|ergebnis)", re.IGNORECASE)
#: Headings of columns that say in which unit, or of which quantity, the numbers beside them are; in small letters.
_OF_UNITS = re.compile(r"(.*[_ ])?units?")
_OF_QUANTITIES = re.compile(r"(metric|measure|measurement|quantity|variable|indicator|kpi)s?[_ ]?(name|type)?")


@dataclass(frozen=True, slots=True)
class Understanding:
    """The understanding of a results folder.

    Attributes:
        headings: the new name of each factor and measure: the old one, except where this is taken.
        units: the unit of each measure of the table, where it is known.
        recipes: how measures are computed from samples.
        origin: `measured`, `simulated`, `estimated`, or None where the user did not say.
        notes: anomalies and guesses.
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
    said: ImportDescription = field(default_factory=ImportDescription, repr=False)

    @property
    def questions(self) -> tuple[Finding, ...]:
        """The unsure guesses, each with the options that settle it."""
        where = self.table.path.name
        found = [Finding.error(where, guess.question, _settled_by(guess)) for guess in self.roles.unsure]
        for name, doubt in self.table.doubts.items():
            if name in {*self.roles.measures, *self.roles.design}:
                fix = "Say which the decimal sign is: --decimal point or --decimal comma."
                found.append(Finding.error(where, f"numbers of column {name!r} can be read in two ways: {doubt}", fix))
        return (*found, *self._odd_columns(where), *self._odd_rows(where))

    def _odd_columns(self, where: str) -> Iterator[Finding]:
        """Yield an error for each column by which the numbers beside it are not of one kind, or rows not all runs."""
        table, said = self.table, self.said
        kept = {*(said.factors or ()), *(said.measures or ()), *said.ignore, said.block, said.run_id}
        for name in (each for each in table.headings if each not in kept and not table.is_numeric(each)):
            cells = dict.fromkeys(filter(None, table.column(name)))
            quoted, several, shown = shlex.quote(name), len(cells) > 1, listed(cells, shown=_SHOWN_CELLS)
            if several and _OF_UNITS.fullmatch(name.casefold()) and any(map(unit_of, cells)):
                problem = f"column {name!r} has several units ({shown}), which are not converted"
                fix = f"Write the numbers of each column in one unit, or say --ignore {quoted}."
                yield Finding.error(where, problem, fix)
            if several and _OF_QUANTITIES.fullmatch(name.casefold()) and name in self.roles.factors:
                problem = f"column {name!r} names what the numbers beside it are ({shown})"
                fix = f"Write a column for each; if they are treatments, say --factor {quoted}."
                yield Finding.error(where, problem, fix)
            sums = {cell for cell in cells if (summary := _SUMMARY.fullmatch(cell)) and summary[1] in cells}
            lines = [place for place, cell in enumerate(table.column(name)) if cell in sums]
            if lines:
                example = f"line {table.lines[lines[0]]} with {table.column(name)[lines[0]]!r} for {name}"
                problem = f"{counted(len(lines), 'line')}, such as {example}, sum up other runs"
                yield Finding.error(where, problem, f"Remove the lines; if they are runs, say --factor {quoted}.")

    def _odd_rows(self, where: str) -> Iterator[Finding]:
        """Yield an error for each row that rather has headings or units, or sums up the runs above it."""
        table, said = self.table, self.said
        if not any(table.number(cell) is not None for cell in table.rows[0]):
            measures = [place for place, name in enumerate(table.headings) if name in self.roles.measures]
            units = [table.rows[0][place] for place in measures if unit_of(table.rows[0][place].strip("[]()"))]
            texts = [table.rows[0][place] for place in measures if not table.has_answers(table.headings[place])]
            if units:
                problem = f"line {table.lines[0]} has units rather than values ({enumerated(units)})"
                fix = "Write them into the heading, as in 'Energy (J)', and remove the line."
                yield Finding.error(where, problem, fix)
            elif len(texts) > 1 and all(texts):
                problem = f"line {table.lines[0]} has words rather than values ({enumerated(list(map(repr, texts)))})"
                fix = "Write one heading above each column, and remove the line; of a run, leave the cells empty."
                yield Finding.error(where, problem, fix)
        settled = {said.run_id, *(said.factors or ()), *(said.measures or ()), *said.ignore}
        open_columns = [place for place, name in enumerate(table.headings) if name not in settled]
        for row, line in zip(reversed(table.rows), reversed(table.lines), strict=True):
            words = [place for place in open_columns if row[place].casefold().strip(".: ") in _SUMMARIES.split()]
            if not words or table.column(name := table.headings[words[0]]).count(word := row[words[0]]) > 1:
                break
            problem = f"line {line} has {word!r} for {name}, as if it summed up the runs above it"
            option = "--run-id" if name == self.roles.run_id else "--factor"
            fix = f"Remove the line; if it is a run, say {option} {shlex.quote(name)}."
            yield Finding.error(where, problem, fix)

    @property
    def design_words(self) -> str:
        """The design of the runs in words: factors with their treatments, repetitions, blocks, number of runs."""
        declared = self.said.design.names if self.said.design is not None else ()
        varied = [name for name in self.roles.factors if len(self.treatments(name)) > 1 and name not in declared]
        counts = " x ".join(str(len(self.treatments(name))) for name in varied)
        combinations = Counter(tuple(run.treatments[name] for name in varied) for run in self.runs)
        possible = prod(len(self.treatments(name)) for name in varied)
        least, most = min(combinations.values()), max(combinations.values())
        parts = [f"{counts} ({' x '.join(map(one_line, varied))})" if varied else "one combination"]
        parts += [f"{len(combinations)} of {possible} combinations are there"] if len(combinations) < possible else []
        parts += [f"{counted(least, 'run') if least == most else f'{least} to {most} runs'} a combination"]
        parts += [f"declared as {one_line(self.said.design.in_words)}"] if self.said.design is not None else []
        if block := self.roles.block:
            in_design = block in self.roles.design
            blocks = self.treatments(block) if in_design else {run.repetition for run in self.runs}
            parts += [f"in {len(blocks)} blocks ({one_line(block)})"]
        return f"{', '.join(parts)}: {counted(len(self.runs), 'run')}"

    @property
    def new_measures(self) -> tuple[str, ...]:
        """The measures that are not in the table and are computed from samples."""
        return tuple(recipe.measure for recipe in self.recipes if recipe.measure not in self.roles.measures)

    @property
    def description(self) -> ImportDescription:
        """The description that leads to the same understanding without guessing."""
        return replace(
            self.said,
            name=self.name,
            table=self.table.path.name,
            run_id=self.roles.run_id,
            status=self.roles.status,
            repetition=self.roles.repetition,
            block=self.roles.block,
            factors=self.roles.factors,
            measures=self.roles.measures,
            units=_symbols(self.units),
            samples=tuple(
                SamplesDescription(
                    each.file,
                    each.name,
                    each.time,
                    None if each.time_unit == "clock" else each.time_unit,
                    _symbols(each.units),
                )
                for each in self.samples
            ),
            recipes=self.recipes,
            guess=False,
        )

    @property
    def design_facts(self) -> dict[str, object]:
        """The facts of the declared design, with the new headings; empty where none was declared."""
        design = self.said.design
        return {} if design is None else {"facts": design.facts("the import", self.headings.__getitem__)}

    def treatments(self, factor: str) -> tuple[str, ...]:
        """Return the treatments of a factor: numbers ascending, False before True, others as they occur."""
        texts = list(dict.fromkeys(run.treatments[factor] for run in self.runs))
        numbers = [number_of(text) for text in texts]
        if self.table.is_boolean(factor):
            texts.sort()
        elif None not in numbers:
            texts.sort(key=lambda text: number_of(text) or 0)
        return tuple(texts)


def _symbols(units: Mapping[str, Unit | None]) -> dict[str, str]:
    return {name: unit.symbol for name, unit in units.items() if unit}


def understand(root: Path, said: ImportDescription) -> Understanding:
    """Understand the contents of a folder of results; nothing is written.

    Raises:
        StorageError: the results cannot be read.
        AnalysisError: the results cannot be understood, or the user's description does not fit them.
    """
    named = (*(said.factors or ()), *(said.measures or ()), *said.ignore, said.block)
    table = without_unanalysed(read_foreign_table(_table_path(root, said.table), said.decimal), named)
    where = str(table.path)
    if not table.rows:
        raise AnalysisError("there are no runs in the table", where=where, fix="Name the table that holds the runs.")
    roles = roles_of(table, said)
    if len(table.headings) == 1 and not table.is_numeric(table.headings[0]) and not said.recipes:
        fix = "Separate its cells by commas, semicolons or tabs, or name the table of the runs: --table FILE."
        raise AnalysisError("the table has one column, of text", where=where, fix=fix)
    if not roles.measures and not said.recipes and not roles.factors:
        fix = "Name them: --factor and --measure."
        raise AnalysisError("no column is recognised as a factor or a measure", where=where, fix=fix)
    words = table.dialect.words
    notes = [*([f"{table.path.name} is written with {words}"] if words else []), *table.notes, *roles.notes]
    runs = read_runs(root, table, roles, said.run_folder, notes)
    folders = {run.source_id: run.folder for run in runs if run.folder is not None}
    _check_design(said, runs, roles, where)
    samples, sample_notes = understand_samples(folders, said.samples, guess=said.guess)
    units = {name: _unit(table, name, said.units) for name in roles.measures}
    check_recipes(said.recipes, samples)
    guessed = guess_recipes(units, samples, said.recipes) if said.guess else []
    computed = [each.measure for each in said.recipes if each.measure not in units]
    if not units and not computed:
        notes.append("no column is taken for a measure: nothing can be analysed. Name one with --measure")
    if not roles.factors and len(units) > 1:
        told = "no column is taken for a factor: nothing is compared. Name one with --factor"
        notes.append(f"{told}; of treatments with a column each, write a row for each")
    return Understanding(
        root=root,
        name=said.name or re.sub(r"[^A-Za-z0-9 ._-]+", "_", root.resolve().name).strip(" ._-")[:128] or "imported",
        table=table,
        roles=roles,
        headings=_headings(roles, (*roles.design, *roles.measures, *computed, *roles.extras), notes),
        units=units,
        runs=tuple(runs),
        samples=tuple(samples),
        recipes=(*said.recipes, *guessed),
        origin=said.origin,
        said=said,
        notes=(*notes, *sample_notes),
    )


def _check_design(said: ImportDescription, runs: Sequence[ForeignRun], roles: ColumnRoles, where: str) -> None:
    if said.design is None:
        return
    import pandas as pd  # noqa: PLC0415 - takes half a second to import

    rows = [dict(run.treatments) for run in runs]
    factors = [name for name in roles.factors if name not in said.design.names]
    AnalysisError.refuse(structure_findings(said.design, pd.DataFrame(rows), factors, f"{where}, design"))


def _table_path(root: Path, name: str | None) -> Path:
    tables = sorted(path for path in root.glob("*.csv") if path.is_file())  # and no named pipe
    candidates = [root / (name or "")]
    if name is None and not tables:
        candidates += sorted(each for each in root.glob("*") if not each.name.startswith("~$"))  # those are locks
    for each in candidates:
        if each.suffix.casefold() in _WORKBOOKS and each.is_file():
            fix = "Save it as CSV with the program that opens it, or name the table: --table FILE."
            raise StorageError("this is a workbook, and no CSV file", where=str(each), fix=fix)
    if root.is_file():
        fix = f"Name the folder that holds it: {shlex.quote(str(root.parent))} --table {shlex.quote(root.name)}"
        raise StorageError("this is a file, not a folder of results", where=str(root), fix=fix)
    if not root.is_dir():
        raise StorageError("there is no such folder", where=str(root), fix="Name the folder that holds the results.")
    if (root / (name or TABLE)).is_file():
        return root / (name or TABLE)
    if name is None and len(tables) == 1:
        return tables[0]
    names = [path.name for path in tables]
    if name is not None:
        raise StorageError(f"there is no {name!r} in the folder", where=str(root), fix=did_you_mean(name, names))
    which = f"which of {', '.join(names[:_SHOWN_TABLES])} is the run table?"
    problem = which if names else "there is no CSV file in the folder"
    fix = "Name the run table: --table FILE."
    if len(names) > 1:
        fix += (
            " If each is the log of a run, write a table of the runs, and put each into a folder named by its run's id."
        )
    raise StorageError(problem, where=str(root), fix=fix)


def _unit(table: ForeignTable, measure: str, units: Mapping[str, str]) -> Unit | None:
    if measure in units:
        return unit_of(units[measure])
    has_numbers = any(table.number(cell) is not None for cell in table.column(measure))
    return table.unit(measure) if has_numbers else None


def _settled_by(guess: RoleGuess) -> str:
    options = [f"--{each} {shlex.quote(guess.column)}" for each in ("factor", "measure", "ignore")]
    first = {Role.REPETITION: "repetition", Role.BLOCK: "block", Role.TEXT: "block"}.get(guess.role)
    options = [f"--{first} {shlex.quote(guess.column)}", *options] if first else options
    return f"Say what it is: {', '.join(options[:-1])} or {options[-1]}."


def _headings(roles: ColumnRoles, names: Iterable[str], notes: list[str]) -> dict[str, str]:
    """Return the new name of each column; a name that the run table reserves gets an underscore at its end."""
    headings: dict[str, str] = {}
    taken = {REPETITION}
    repeated = 2 if roles.repetition or roles.repetition_in_run_id else 1
    for name in names:
        here = "".join(character for character in name if is_fit_for_heading(character)).strip() or "column"
        while here in taken or any(name_findings(here, kind="column", repetitions=repeated)):
            here = f"{here}_"
        if here != name:
            why = "the name is taken" if here.strip("_") == name.strip("_") else "a heading cannot hold all of it"
            notes.append(f"column {name!r} is called {here!r} here: {why}")
        headings[name] = here
        taken.add(here)
    return headings
