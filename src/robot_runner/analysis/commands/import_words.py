"""The output of `robot-runner import`: what was understood, how sure that is, and how recomputed measures agree."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.cli.console import Column, UserConsole, aligned, print_facts, shown_path, width_of
from robot_runner.core.words import counted, listed, one_line, shown_treatment

if TYPE_CHECKING:
    from robot_runner.analysis.importing.adoption import Adoption
    from robot_runner.analysis.importing.understanding import Understanding

_SHOWN_DIFFERENCES = 5
#: The numbers of rows and columns that a user will read before saying yes.
_SHOWN_ROWS, _SHOWN_COLUMNS = 3, 25
_STATUSES = {"Done": "done", "Failed": "failed", "-": "to do"}


def print_understanding(console: UserConsole, found: Understanding, target: Path) -> None:
    """Print what was understood of the results: the columns with the first rows, the design, the raw files."""
    roles = found.roles
    console.print(f"{found.name}: what was understood of {one_line(found.table.path.name)}", style="bold")
    for line in _column_lines(found):
        console.print(f"  {line}")
    counts = ", ".join(f"{count} {_STATUSES[status]}" for status, count in _status_counts(found).items() if count)
    repetition = roles.repetition or ("the run ids" if roles.repetition_in_run_id else "")
    facts = [("Runs", f"{len(found.runs)}: {counts}; ids from {one_line(roles.run_id or 'their place in the table')}")]
    facts += [("Design", found.design_words)]
    facts += [(f"Factor {name}", listed(map(shown_treatment, found.treatments(name)))) for name in roles.factors]
    facts += [("Blocks", one_line(roles.block) if roles.block else "")]
    facts += [("Repetitions", f"counted by {one_line(repetition)}" if repetition else "")]
    facts += [(f"Samples {each.file}", _samples_words(each)) for each in found.samples]
    recipes = [f"{one_line(each.measure)} = {each.words}{' (guessed)' * each.is_guessed}" for each in found.recipes]
    questions = [f"{each.problem}{'' if each.problem.endswith('?') else '.'} {each.fix}" for each in found.questions]
    facts += [*_beneath("Recomputed", recipes), *_beneath("Note", found.notes), *_beneath("Not sure", questions)]
    console.print()
    print_facts(console, [*facts, ("To", shown_path(target))])


def _beneath(name: str, lines: Iterable[str]) -> list[tuple[str, str]]:
    return [(name if not place else " ", one_line(line)) for place, line in enumerate(lines)]


def _status_counts(found: Understanding) -> dict[str, int]:
    return {status: sum(run.status.value == status for run in found.runs) for status in _STATUSES}


def _column_lines(found: Understanding) -> Iterator[str]:
    """Yield a row for each column of the table: its role, unit, how sure that is and why, and its first cells."""
    rows = [
        [
            guess.column,
            guess.role.value,
            _unit(found, guess.column),
            guess.confidence.value,
            *found.table.column(guess.column)[:_SHOWN_ROWS],
            guess.reason + "; unit not known" * (guess.column in found.units and found.units[guess.column] is None),
        ]
        for guess in found.roles.guesses
    ]
    # Unsure columns are always shown.
    kept = [row for place, row in enumerate(rows) if place < _SHOWN_COLUMNS or row[3] == "unsure"]
    firsts = [f"row {place + 1}" for place in range(min(_SHOWN_ROWS, len(found.table.rows)))]
    headings = ["column", "role", "unit", "sure?", *firsts, "because"]
    columns = [
        Column(heading, width_of([heading, *(row[place] for row in kept)]) if heading != "because" else 80)
        for place, heading in enumerate(headings)
    ]
    yield aligned(columns, headings)
    yield from (aligned(columns, row) for row in kept)
    if len(kept) < len(rows):
        yield f"and {counted(len(rows) - len(kept), 'column')} more: see them with --save-description"


def _unit(found: Understanding, name: str) -> str:
    return unit.symbol if (unit := found.units.get(name)) else ""


def _samples_words(samples: Any) -> str:
    values = [
        f"{one_line(name)}{f' in {unit.symbol}' if (unit := samples.units.get(name)) else ''}"
        for name in samples.columns
    ]
    runs = counted(len(samples.paths), "run")
    guesses = f"; guessed: {', '.join(map(one_line, samples.guesses))}" if samples.guesses else ""
    return f"{runs}; time: {one_line(samples.time)} ({samples.time_unit}); values: {listed(values, shown=8)}{guesses}"


def print_adoption(console: UserConsole, adoption: Adoption) -> None:
    """Print how recomputed measures agree with the table's, and where the files are."""
    from robot_runner.analysis.importing.recomputation import TOLERANCE, agreements  # noqa: PLC0415 - as above

    console.print("\nRecomputed from the samples, beside the table's own values", style="bold")
    found = agreements(adoption.differences)
    for each in found:
        if not each.differing:
            relative = each.largest.relative or 0.0
            console.print(
                f"  {one_line(each.measure)}: {counted(each.compared, 'run')} agree, within {abs(relative):.1g}"
            )
            continue
        console.print(
            f"  {one_line(each.measure)}: {len(each.differing)} of {counted(each.compared, 'run')} differ by more than "
            f"{TOLERANCE:.1%}",
            style="yellow",
        )
        if each.factor is not None:
            console.print(f"    the recomputed values are {each.factor:g} times the table's: is a unit mistaken?")
        for difference in each.differing[:_SHOWN_DIFFERENCES]:
            relative_words = "" if difference.relative is None else f" ({difference.relative:+.2%})"
            there, here = (
                f"{value:.6g} {difference.unit}".rstrip() for value in (difference.table, difference.recomputed)
            )
            console.print(f"    {difference.run_id}: {there} in the table, {here} recomputed{relative_words}")
    if not found:
        console.print("  nothing could be recomputed")
    for warning in adoption.warnings:
        console.print(f"  {one_line(warning)}", style="yellow")
    folder = shown_path(adoption.folder)
    console.print()
    print_facts(
        console,
        [
            ("Results", folder),
            ("All differences", f"{folder}/import/differences.csv" if found else ""),
            ("Next", f"robot-runner report {shlex.quote(folder)}"),
        ],
    )


def understanding_as_json(found: Understanding) -> dict[str, Any]:
    """Return what was understood as plain data."""
    return {
        "name": found.name,
        "table": found.table.path.name,
        "runs": _status_counts(found),
        "run_id": found.roles.run_id,
        "status": found.roles.status,
        "repetition": found.roles.repetition,
        "block": found.roles.block,
        "design": found.design_words,
        "columns": [
            {
                "name": guess.column,
                "role": guess.role.value,
                "unit": _unit(found, guess.column),
                "confidence": guess.confidence.value,
                "reason": guess.reason,
            }
            for guess in found.roles.guesses
        ],
        "questions": [{"problem": each.problem, "fix": each.fix} for each in found.questions],
        "factors": {name: list(found.treatments(name)) for name in found.roles.factors},
        "measures": {name: unit.symbol if unit else "" for name, unit in found.units.items()},
        "extras": list(found.roles.extras),
        "samples": [
            {
                "file": each.file,
                "runs": len(each.paths),
                "time": each.time,
                "time_unit": each.time_unit,
                "units": {name: unit.symbol if unit else "" for name, unit in each.units.items()},
                "guessed": list(each.guesses),
            }
            for each in found.samples
        ],
        "recompute": {recipe.measure: recipe.words for recipe in found.recipes},
        "notes": list(found.notes),
    }


def differences_as_json(adoption: Adoption) -> list[dict[str, Any]]:
    """Return all differences as plain data."""
    return [
        {
            "run": each.run_id,
            "measure": each.measure,
            "table": each.table,
            "recomputed": each.recomputed,
            "unit": each.unit,
            "relative": each.relative,
        }
        for each in adoption.differences
    ]
