"""Runs from the rows of another tool's run table."""

from __future__ import annotations

import os
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.column_evidence import STATUSES, repetition_number
from robot_runner.analysis.importing.foreign_table import ANSWERS
from robot_runner.analysis.importing.units import MISSING
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.cells import CellValue, RunStatus
from robot_runner.core.words import counted, enumerated, listed

if TYPE_CHECKING:
    from robot_runner.analysis.importing.column_roles import ColumnRoles
    from robot_runner.analysis.importing.foreign_table import ForeignTable

#: The table of the runs; a folder with one is a study of its own, as a pilot or another night.
TABLE = "run_table.csv"
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")
_LONGEST_ID = 60
_NUMBER = re.compile(r"\d+")
#: Names of raw files in tables.
_FILE = re.compile(r"[^\0]{1,200}\.(csv|tsv|json|txt|log|bag|db3|mcap|parquet|png|jpe?g|mp4|zip|gz)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ForeignRun:
    """One run, from a row of the run table.

    Attributes:
        run_id: its id in the experiment; the source's, without characters that cannot be in a folder's name.
        source_id: its id in the source.
        treatments: the texts of the factors' cells.
        repetition: from 1; None where there are none.
        measures: the values; None for a missing one.
        extras: the texts of columns that are kept unchanged.
        folder: the folder of its raw files, or None.
    """

    run_id: str
    source_id: str
    status: RunStatus
    treatments: Mapping[str, str]
    repetition: int | None
    measures: Mapping[str, CellValue]
    extras: Mapping[str, str]
    folder: Path | None


def read_runs(
    root: Path, table: ForeignTable, roles: ColumnRoles, pattern: str | None, notes: list[str]
) -> list[ForeignRun]:
    """Return the runs of a table, and add anomalies to the notes.

    `pattern` is the path of a run's files below `root`, with `{run_id}` in it; None for `{run_id}` or `runs/{run_id}`.

    Raises:
        AnalysisError: a run has no id; a status or a repetition cannot be read.
    """
    table = _without_copies(table, roles, notes)
    source_ids = table.column(roles.run_id) if roles.run_id else [f"r_{n}" for n in range(1, len(table.rows) + 1)]
    times = Counter(source_ids)
    patterns = [pattern] if pattern else ["{run_id}", "runs/{run_id}"]
    run_ids, repetitions = _run_ids(source_ids, table, notes), _repetitions(table, roles, source_ids, notes)
    treatments = {name: _treatments(name, table) for name in roles.design}
    said = [name for name in roles.measures if table.says_yes_or_no(name)]
    if said:
        notes.append(f"yes and no of {enumerated(said)} are True and False here, so that proportions are compared")
    words = {name: ANSWERS if name in said else _TRUTH for name in roles.measures}
    runs = []
    for place, (row, source_id) in enumerate(zip(table.rows, source_ids, strict=True)):
        cells = dict(zip(table.headings, row, strict=True))
        measures = {name: _value(cells[name], table, words[name]) for name in roles.measures}
        is_one = times[source_id] == 1 and not _leads_out(source_id)
        named = [each.replace("{run_id}", source_id) for each in patterns if is_one]
        folders = [os.path.join(root, each) for each in named]  # noqa: PTH118 - ten times as fast
        runs.append(
            ForeignRun(
                run_id=run_ids[place],
                source_id=source_id,
                status=_status(cells, roles, measures, f"{table.path}:{table.lines[place]}"),
                treatments={name: treatments[name][cells[name]] for name in roles.design},
                repetition=repetitions[place],
                measures=measures,
                extras={name: cells[name] for name in roles.extras},
                folder=next((Path(folder) for folder in folders if os.path.isdir(folder)), None),  # noqa: PTH112 - any word
            )
        )
    notes += [
        *_run_notes(table, roles, runs),
        *_folder_notes(root, runs),
        *_link_notes(root, runs),
        *_file_notes(root, runs),
    ]
    return _renumbered(runs, notes)


def _leads_out(source_id: str) -> bool:
    """Return whether an id, in the path of its run's files, would lead to files beside the results."""
    return source_id.startswith("/") or ".." in source_id.split("/")


def _renumbered(runs: list[ForeignRun], notes: list[str]) -> list[ForeignRun]:
    """Return the runs with repetitions numbered within each combination, where the table counts across combinations."""
    most = max(Counter(tuple(run.treatments.values()) for run in runs).values())
    if any(run.repetition is None for run in runs) or max(run.repetition or 0 for run in runs) <= 2 * most:
        return runs
    places: dict[int, int] = {}
    seen: Counter[tuple[str, ...]] = Counter()
    for place in sorted(range(len(runs)), key=lambda place: runs[place].repetition or 0):
        combination = tuple(runs[place].treatments.values())
        seen[combination] += 1
        places[place] = seen[combination]
    notes.append("repetitions are numbered again within each combination: the table counts them across combinations")
    return [replace(run, repetition=places[place]) for place, run in enumerate(runs)]


def _without_copies(table: ForeignTable, roles: ColumnRoles, notes: list[str]) -> ForeignTable:
    """Return the table without rows that equal an earlier one in all cells: tables are assembled by hand."""
    first = dict(zip(reversed(table.rows), reversed(table.lines), strict=True))
    copies = len(table.rows) - len(first)
    if roles.run_id is None or not copies:
        return table
    notes.append(f"{counted(copies, 'row')} left out that {'is' if copies == 1 else 'are'} there twice, cell by cell")
    rows = sorted(first, key=first.__getitem__)
    return replace(table, rows=tuple(rows), lines=tuple(first[row] for row in rows))


def _run_ids(source_ids: Sequence[str], table: ForeignTable, notes: list[str]) -> list[str]:
    """Return a unique id for each run that can name a folder."""
    plain = [_UNFIT.sub("_", source).strip(".-")[:_LONGEST_ID] for source in source_ids]
    if "" in plain:
        where = f"{table.path}:{table.lines[plain.index('')]}"
        raise AnalysisError("the run has no id", where=where, fix="Give it one.")
    changed = sum(one != other for one, other in zip(plain, source_ids, strict=True))
    if changed:
        notes.append(f"{counted(changed, 'run id')} had characters that cannot name a folder, replaced by '_'")
    taken = {each.casefold() for each in plain}
    seen: set[str] = set()
    run_ids = []
    for run_id in plain:
        free, number = run_id, 2
        while free.casefold() in seen or (free != run_id and free.casefold() in taken):
            free, number = f"{run_id}_{number}", number + 1
        seen.add(free.casefold())
        run_ids.append(free)
    again = [place for place, (one, other) in enumerate(zip(run_ids, plain, strict=True)) if one != other]
    if again:
        example = f"{source_ids[again[0]]!r} in line {table.lines[again[0]]} is called {run_ids[again[0]]!r} here"
        told = f"{counted(len(again), 'run')} had an id that another has, so that none of either has raw files"
        notes.append(f"{told}: {example}")
    return run_ids


def _repetitions(
    table: ForeignTable, roles: ColumnRoles, source_ids: Sequence[str], notes: list[str]
) -> list[int | None]:
    if roles.repetition is None:
        numbers = [roles.repetition_of(run_id) for run_id in source_ids]
    else:
        cells = table.column(roles.repetition)
        numbers = [repetition_number(cell) for cell in cells]
        if None in numbers:
            place = numbers.index(None)
            where = f"{table.path}:{table.lines[place]}, column {roles.repetition!r}"
            fix = "Correct it, remove the line if it sums up others, or name the column a factor: --factor."
            raise AnalysisError(f"{cells[place]!r} is not a repetition number", where=where, fix=fix)
    if 0 in numbers:
        notes.append("repetitions are numbered from 1 here, not from 0")
        return [None if number is None else number + 1 for number in numbers]
    return numbers


def _status(cells: Mapping[str, str], roles: ColumnRoles, measures: Mapping[str, CellValue], where: str) -> RunStatus:
    if roles.status is None:
        return RunStatus.DONE if any(value is not None for value in measures.values()) else RunStatus.TODO
    word = cells[roles.status]
    if word.casefold() not in STATUSES:
        fix = "Write DONE, TODO or FAILED, or name another column: --status."
        raise AnalysisError(f"{word!r} is not a status", where=f"{where}, column {roles.status!r}", fix=fix)
    return STATUSES[word.casefold()]


#: The values of texts in measures, in any case; yes and no count only in columns without other texts.
_TRUTH = {"true": True, "false": False}


def _value(cell: str, table: ForeignTable, words: Mapping[str, bool]) -> CellValue:
    if cell.casefold() in MISSING:
        return None
    number = table.number(cell)
    return number if number is not None else words.get(cell.casefold(), cell)


def _treatments(factor: str, table: ForeignTable) -> dict[str, str]:
    """Return the treatment of each cell of a factor; `1`, `01` and `1.0` are the same number."""
    cells = dict.fromkeys(table.column(factor))
    if table.is_boolean(factor):
        return {cell: cell.capitalize() if cell.casefold() in _TRUTH else cell for cell in cells}
    if not table.is_numeric(factor):
        return {cell: cell for cell in cells}
    texts: dict[float, str] = {}
    found = {}
    for cell in cells:
        number = table.number(cell)
        # A cell without a number must not become a treatment named None.
        found[cell] = cell if number is None else texts.setdefault(number, str(number))
    return found


def _run_notes(table: ForeignTable, roles: ColumnRoles, runs: Sequence[ForeignRun]) -> list[str]:
    notes = []
    running = [cell for cell in table.column(roles.status) if cell.casefold() == "running"] if roles.status else []
    if running:
        notes.append(f"{counted(len(running), 'run')} were being executed when the table was written: to do again")
    for name in roles.design:
        notes += _slips_of_the_pen(name, dict.fromkeys(run.treatments[name] for run in runs))
        notes += _missing_treatments(name, Counter(run.treatments[name] for run in runs))
    for name in roles.measures:
        texts = [run.run_id for run in runs if isinstance(run.measures[name], str)]
        if texts and any(isinstance(run.measures[name], int | float) for run in runs):
            told = f"{name} is text in {counted(len(texts), 'run')}, such as {texts[0]}: no statistics of it"
            notes.append(f"{told}. Where a value is missing, leave the cell empty")
        if {run.measures[name] for run in runs} - {None} == {0, 1} and table.is_numeric(name):
            told = f"{name} is 0 or 1 in all runs: if that is no and yes"
            notes.append(f"{told}, write False and True, so that proportions are compared")
        notes += _nines(name, [run.measures[name] for run in runs])
        unit = table.unit(name)
        if _ENERGY.search(name) or (unit is not None and unit.si == "J"):
            notes += _negative_energies(name, runs)
    notes += _repeated_repetitions(runs)
    raw = [run.run_id for run in runs if run.status is RunStatus.TODO and run.folder and any(run.folder.glob("*.csv"))]
    if raw and roles.status:
        told = f"{counted(len(raw), 'run')} to do {'has' if len(raw) == 1 else 'have'} raw files, such as {raw[0]}"
        notes.append(f"{told}: if they were executed, say --ignore {shlex.quote(roles.status)}")
    without = [run.run_id for run in runs if run.status is RunStatus.DONE and run.folder is None]
    if any(run.folder for run in runs) and without:
        notes.append(f"{counted(len(without), 'run')} done without a folder of raw files, such as {without[0]}")
    return notes


def _repeated_repetitions(runs: Sequence[ForeignRun]) -> Iterator[str]:
    """Yield a note where runs of a combination have the same number: two treatments under one name, or two series."""
    counts = Counter((tuple(run.treatments.items()), run.repetition) for run in runs if run.repetition is not None)
    if again := [each for each, count in counts.items() if count > 1]:
        combination, number = again[0]
        which = f"repetition {number}{' of ' if combination else ''}{', '.join(map(' '.join, combination))}"
        many = f"{counted(len(again), 'repetition')} {'is' if len(again) == 1 else 'are'} there more than once"
        yield f"{many}, such as {which}: is a factor missing, or was a series repeated?"


def _slips_of_the_pen(name: str, treatments: Iterable[str]) -> Iterator[str]:
    """Yield a note for each treatment that differs from another in case or blanks alone."""
    spelt: dict[str, str] = {}
    for text in treatments:
        other = spelt.setdefault(" ".join(text.casefold().split()), text)
        if other != text:
            yield f"{name} has {other!r} and {text!r}: two treatments here. If they are one, spell them alike"


#: Words that no treatment has for a name, other than `None` and dashes, in small letters.
_NO_NAMES = MISSING - {"none", "-", "\N{EN DASH}", "\N{EM DASH}"}


def _missing_treatments(name: str, treatments: Mapping[str, int]) -> Iterator[str]:
    """Yield a note for each treatment that is rather a missing value."""
    for text, count in treatments.items():
        if text.casefold() in _NO_NAMES:
            told = f"{name} has {text!r} in {counted(count, 'run')}: a treatment here"
            yield f"{told}. If it is missing, fill it in, or leave these runs out"


#: Minus one, or nines alone, by which programs tell that there is none, and how far it is from all others then.
_NINES = re.compile(r"-1|-9{2,}|9{4,}")
_FAR = 10


def _nines(name: str, values: Sequence[object]) -> Iterator[str]:
    """Say which nines, or minus one, stand rather for a missing value: far from all other numbers of a measure."""
    numbers = Counter(float(value) for value in values if isinstance(value, int | float))
    nines = [number for number in numbers if _NINES.fullmatch(f"{number:.0f}") and number == int(number)]
    others = [number for number in numbers if number not in nines]
    for number in nines:
        most = max(map(abs, others), default=number)
        is_far = abs(number) >= _FAR * most
        is_alone = number < 0 <= min(others, default=number)
        if is_far or (is_alone and (number < -1 or most >= _FAR)):
            why = "and no other is below 0" if number == -1 and not is_far else "far from all others"
            told = f"{name} is {number:.0f} in {counted(numbers[number], 'run')}, {why}"
            yield f"{told}: a missing value? Then leave these cells empty"


#: Noise about zero has not been seen to go so far beyond the largest value.
_FAR_BELOW = 3
_ENERGY = re.compile(r"energ(?!.*(?:sav|chang|diff|delta))|joule", re.IGNORECASE)


def _negative_energies(name: str, runs: Sequence[ForeignRun]) -> Iterator[str]:
    """Say in which few runs an energy is farther below zero than any other is above it, as where a counter wrapped."""
    values = {run.run_id: value for run in runs if isinstance(value := run.measures[name], int | float)}
    most = max(values.values(), default=0)
    wrapped = [run_id for run_id, value in values.items() if 0 < most * _FAR_BELOW <= -value]
    if wrapped and 2 * len(wrapped) < len(values):
        told = f"{name} is negative in {counted(len(wrapped), 'run')}, such as {wrapped[0]}"
        yield f"{told}: a counter that wrapped around, or was reset? Then leave these cells empty"


_FOLDERS_SHOWN = 3
#: Fewer folders with CSV files are often those of figures and notes.
_FEWEST_FOLDERS = 3


def _folder_notes(root: Path, runs: Sequence[ForeignRun]) -> Iterator[str]:
    """Yield a note on folders that look like those of runs but belong to none in the table."""
    used = {run.folder for run in runs if run.folder is not None}
    if not used:
        files = [each for below in ("", "runs/") for each in root.glob(f"{below}*/*.csv")]
        studies = {each.parent for each in files if each.name == TABLE}
        files = [each for each in files if each.parent not in studies]
        folders = sorted({each.parent for each in files})
        alike = Counter(kind for _, kind in {(each.parent, _NUMBER.sub("#", each.name)) for each in files})
        if len(folders) >= max(_FEWEST_FOLDERS, len(runs) / 2) and 2 * max(alike.values()) > len(folders):
            found = f"{counted(len(folders), 'folder')} with CSV files, such as {folders[0].name}"
            options = "(--run-id COLUMN), or say where those of a run are (--run-folder 'raw/{run_id}')"
            yield f"{found}, belong to no run: name the column that has their names {options}"
    kinds = {_NUMBER.sub("#", run.folder.name) for run in runs if run.folder is not None}
    parents = {folder.parent for folder in used}
    beside = sorted(path for parent in parents for path in parent.iterdir() if path.is_dir() and path not in used)
    left = [path.name for path in beside if _NUMBER.sub("#", path.name) in kinds and not (path / TABLE).exists()]
    if left:
        of_runs = f"{counted(len(left), 'folder')} of raw files beside those of {counted(len(used), 'run')}"
        yield f"{of_runs} that the table does not have: {listed(left, shown=_FOLDERS_SHOWN)}"


def _link_notes(root: Path, runs: Sequence[ForeignRun]) -> Iterator[str]:
    """Yield notes on ids and links that lead out of the results, and on links to files that are not there."""
    out = [run.source_id for run in runs if _leads_out(run.source_id)]
    if out:
        yield f"{counted(len(out), 'run id')} would lead out of the folder, such as {out[0]!r}: no raw files are taken"
    folders = {run.folder: sorted(run.folder.iterdir()) for run in runs if run.folder}
    above = sorted({each for folder in folders for each in (folder, *folder.parents) if each.is_relative_to(root)})
    links = [each for each in (*above, *chain.from_iterable(folders.values())) if each.is_symlink()]
    if lost := [os.path.relpath(each, root) for each in links if not each.exists()]:
        yield f"links to raw files lead nowhere ({listed(lost)}): bring the files, as by datalad get"
    results = root.resolve()
    copied = {each: each.resolve() for each in links if each.is_file() or each in above}
    out = [f"{os.path.relpath(each, root)} to {end}" for each, end in copied.items() if not end.is_relative_to(results)]
    if out:
        yield f"the files are copied to which links lead out of the folder: {listed(out, shown=1)}"


def _file_notes(root: Path, runs: Sequence[ForeignRun]) -> Iterator[str]:
    """Yield a note for each column that names missing files."""
    for name in runs[0].extras if runs else ():
        named = [(run, run.extras[name]) for run in runs if _FILE.fullmatch(run.extras[name])]
        missing = [
            text
            for run, text in named
            if not any(os.path.exists(place / text) for place in (root, run.folder or root))  # noqa: PTH110 - any word
        ]
        if missing:
            files = counted(len(named), "file")
            yield f"column {name!r} names {files}, of which {len(missing)} are missing, such as {missing[0]}"
