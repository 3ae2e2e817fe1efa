"""A file of means: the mean and the standard deviation of each combination of a study, in a CSV file.

It is read however a spreadsheet writes it; numbers that can be read in two ways are refused.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from robot_runner.analysis.importing.foreign_table import dialect_of
from robot_runner.analysis.importing.units import plain_cells
from robot_runner.analysis.planning.assumed_values import AND, AssumedMeasure, finite_number
from robot_runner.core.errors import AnalysisError, StorageError, did_you_mean
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.words import combination_label, counted, listed

if TYPE_CHECKING:
    from robot_runner.analysis.planning.planned_study import Cell, Study

#: The suffix of a column with the standard deviation of a measure.
_SPREAD = ".sd"
_EACH = "Give it a cell under each heading."


def means_file(
    study: Study, path: Path, spreads: Mapping[str, float], measures: Sequence[str]
) -> dict[str, AssumedMeasure]:
    """Read the means of a CSV file with columns for factors, measures and `<measure>.sd`, and a row per combination.

    A factor without a column has no effect; columns of other measures are not read.

    Raises:
        AnalysisError: the file cannot be read, or lacks a combination or a standard deviation.
    """
    where = f"--means {path}"
    table = _cells_of(study, path, where)
    known = [*study.factors, *study.units, *(f"{name}{_SPREAD}" for name in study.units)]
    for name in table.columns:
        if name not in known:
            raise AnalysisError(f"there is no factor or measure {name!r}", where=where, fix=did_you_mean(name, known))
    names = [name for name in table.columns if name in measures]
    if not names:
        raise AnalysisError("no column is a measure", where=where, fix=f"Name one: {', '.join(measures)}.")
    return {name: _of_table(study, table, name, spreads, where) for name in names}


def _cells_of(study: Study, path: Path, where: str) -> pd.DataFrame:
    with storage_errors(path, "read"):
        is_pipe = path.is_fifo()
    if is_pipe:
        raise AnalysisError("a pipe cannot be read twice", where=where, fix="Name a CSV file.")
    try:
        dialect = dialect_of(path)
        with storage_errors(path, "read"), path.open(encoding=dialect.encoding, errors="replace", newline="") as file:
            reader = csv.reader(file, delimiter=dialect.delimiter)
            lines = [(row, reader.line_num) for row in reader][dialect.blank_lines :]
    except (AnalysisError, StorageError, csv.Error) as error:
        problem = f"the file is not CSV: {error}" if isinstance(error, csv.Error) else error.problem
        raise AnalysisError(problem, where=where, fix="Name a CSV file.") from error
    filled = [each for each in lines if any(each[0])] or [([], 0)]
    width = max((place for place, name in enumerate(filled[0][0], start=1) if name), default=0)
    # Spreadsheets write separators behind the last cell.
    (heading, _), *rows = [(row if any(row[width:]) else row[:width], line) for row, line in filled]
    for row, line in rows:
        if len(row) != len(heading):
            told = dialect.delimiter.join(row)
            problem = f"{told!r} has {counted(len(row), 'cell')}, and the heading has {len(heading)}"
            has_commas = dialect.delimiter == "," and len(row) > len(heading)
            fix = "Write decimal points, or semicolons between the cells." if has_commas else _EACH
            raise AnalysisError(problem, where=f"{where}:{line}", fix=fix)
    if twice := [name for name, count in Counter(heading).items() if count > 1]:
        raise AnalysisError(f"{listed(twice)} is there twice", where=where, fix="Rename or delete one column.")
    table = pd.DataFrame([row for row, _ in rows], columns=heading, dtype=str)
    named = [name for name, cells in table.items() if set(cells) <= {*study.factors.get(name, ())}]
    numbers = _plain_numbers(table.drop(columns=named), where, may_group=dialect.delimiter == ";")
    return pd.DataFrame({name: numbers.get(name, cells) for name, cells in table.items()})


def _plain_numbers(table: pd.DataFrame, where: str, *, may_group: bool) -> dict[str, list[str]]:
    """Return columns with decimal points; `may_group` says whether points, too, may stand between thousands."""
    bare = {name: [cell.rstrip("% ") for cell in cells] for name, cells in table.items()}
    first = [plain_cells(cells, decimal=None, has_decimal_commas=may_group) for cells in bare.values()]
    # What other columns have for certain settles a doubt, unless some have decimal commas and others points.
    signs = {"," for each in first if each.has_decimal_commas}
    signs |= {"." for each in first if not each.doubt and not each.words and any("." in cell for cell in each.cells)}
    decimal = signs.pop() if len(signs) == 1 else None
    found = {}
    for name, cells in bare.items():
        plain = plain_cells(cells, decimal=decimal, has_decimal_commas=may_group)
        if plain.doubt:
            problem = f"numbers of {name} can be read in two ways: {plain.doubt}"
            fix = "Write nothing between thousands, and decimal points with other than three decimals."
            raise AnalysisError(problem, where=where, fix=fix)
        if plain.unit is None:  # a cell with a unit is no number, or a treatment
            told = zip(plain.cells, cells, table[name], strict=True)
            found[name] = [number + cell[len(before) :] for number, before, cell in told]
    return found


def _of_table(study: Study, table: pd.DataFrame, name: str, spreads: Mapping[str, float], where: str) -> AssumedMeasure:
    rows = list(_rows_of_cells(study, table, where))

    def numbers(column: str, texts: pd.Series) -> dict[Cell, float]:
        return {cell: finite_number(texts[row], where, f"{column} of {AND.join(cell)}") for cell, row in rows}

    if table[name].str.strip().str.endswith("%").all():
        return AssumedMeasure.of_shares(name, numbers(name, table[name].str.strip(" %")))
    means = numbers(name, table[name])
    own = f"{name}{_SPREAD}"
    if own in table:
        found = numbers(own, table[own])
        if below := [AND.join(cell) for cell, spread in found.items() if spread < 0]:
            raise AnalysisError(f"{own} of {listed(below)} is below 0", where=where, fix="Give standard deviations.")
    elif name in spreads:
        found = dict.fromkeys(study.cells, spreads[name])
    else:
        fix = f"Add the column {own}, or give --sd; write shares of yes as 80%."
        raise AnalysisError(f"the spread of {name} is missing", where=where, fix=fix)
    return AssumedMeasure(name, means, found)


def _rows_of_cells(study: Study, table: pd.DataFrame, where: str) -> Iterator[tuple[Cell, int]]:
    """Yield the row of each combination."""
    told = [name for name in study.factors if name in table]
    rows: dict[Cell, int] = {}
    for row in range(len(table)):
        texts = tuple(str(table[name][row]) for name in told)
        if texts in rows:
            problem = (
                f"rows {rows[texts] + 1} and {row + 1} are both of {combination_label(texts) or 'all combinations'}"
            )
            untold = [name for name in study.varied if name not in told]
            fix = f"Leave one out{f', or add the column {untold[0]}' if untold else ''}."
            raise AnalysisError(problem, where=where, fix=fix)
        rows[texts] = row
    missing = []
    for cell in study.cells:
        own = tuple(text for name, text in zip(study.factors, cell, strict=True) if name in told)
        if own in rows:
            yield cell, rows[own]
        else:
            missing.append(combination_label(own) or "all combinations")
    if missing:
        problem = (
            f"{counted(len(missing), 'combination')} of the design {'has' if len(missing) == 1 else 'have'} no row"
        )
        raise AnalysisError(problem, where=where, fix=f"Add rows for {listed(dict.fromkeys(missing))}.")
