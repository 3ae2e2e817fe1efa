"""What `robot-runner import` shows: what was understood, and how recomputed measures agree."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.cli.console import UserConsole, shown_path
from robot_runner.cli.facts import print_facts
from robot_runner.cli.wording import counted, listed, one_line

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.importing.adoption import Adoption
    from robot_runner.analysis.importing.understanding import Understanding

__all__ = ["differences_as_json", "print_adoption", "print_understanding", "understanding_as_json"]

_SHOWN_DIFFERENCES = 5


def print_understanding(console: UserConsole, found: Understanding, target: Path) -> None:
    """Print what was understood of the results."""
    roles = found.roles
    console.print(f"{found.name}: what was understood of {one_line(found.table.path.name)}", style="bold")
    statuses = [(status, sum(run.status.value == status for run in found.runs)) for status in ("Done", "Failed", "-")]
    words = {"Done": "done", "Failed": "failed", "-": "to do"}
    counts = ", ".join(f"{count} {words[status]}" for status, count in statuses if count)
    facts = [("Runs", f"{len(found.runs)}: {counts}; ids from {roles.run_id or 'their place in the table'}")]
    facts += [(f"Factor {one_line(name)}", listed(map(one_line, found.treatments(name)))) for name in roles.factors]
    repetition = roles.repetition or ("the run ids" if roles.repetition_in_run_id else "")
    facts += [("Repetitions", f"counted by {one_line(repetition)}" if repetition else "")]
    facts += [("Measures", listed([_measure_words(found, name) for name in roles.measures], shown=30))]
    facts += [("Kept as text", listed(map(one_line, roles.extras)))]
    facts += [(f"Samples {one_line(each.file)}", _samples_words(each)) for each in found.samples]
    facts += [
        (
            "Recomputed" if not place else " ",
            f"{one_line(recipe.measure)} = {recipe.words}{' (guessed)' * recipe.is_guessed}",
        )
        for place, recipe in enumerate(found.recipes)
    ]
    facts += [("Note" if not place else " ", one_line(note)) for place, note in enumerate(found.notes)]
    facts += [("To", shown_path(target))]
    print_facts(console, facts)


def _measure_words(found: Understanding, name: str) -> str:
    unit = found.units.get(name)
    return f"{one_line(name)} ({unit.symbol if unit else 'unit not known'})"


def _samples_words(samples: Any) -> str:
    values = [
        f"{one_line(name)}{f' in {unit.symbol}' if (unit := samples.units.get(name)) else ''}"
        for name in samples.columns
    ]
    runs = counted(len(samples.paths), "run")
    guesses = f"; guessed: {', '.join(map(one_line, samples.guesses))}" if samples.guesses else ""
    return f"{runs}; time: {one_line(samples.time)} ({samples.time_unit}); values: {listed(values, shown=8)}{guesses}"


def print_adoption(console: UserConsole, adoption: Adoption) -> None:
    """Print how the recomputed measures agree with the table's own, and where everything is."""
    from robot_runner.analysis.importing.agreement import TOLERANCE, agreements  # noqa: PLC0415 - as above

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
            console.print(
                f"    {difference.run_id}: {difference.table:.6g} in the table, {difference.recomputed:.6g} recomputed"
                f"{relative_words}"
            )
    if not found:
        console.print("  nothing could be recomputed")
    folder = shown_path(adoption.folder)
    console.print()
    print_facts(
        console,
        [
            ("Results", folder),
            ("All differences", f"{folder}/import/differences.csv" if found else ""),
            ("Next", f"robot-runner report {folder}"),
        ],
    )


def understanding_as_json(found: Understanding) -> dict[str, Any]:
    """Return what was understood as plain data."""
    return {
        "name": found.name,
        "table": found.table.path.name,
        "runs": {status: sum(run.status.value == status for run in found.runs) for status in ("Done", "Failed", "-")},
        "run_id": found.roles.run_id,
        "status": found.roles.status,
        "repetition": found.roles.repetition,
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
            "relative": each.relative,
        }
        for each in adoption.differences
    ]
