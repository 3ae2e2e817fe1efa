"""Adopt results of an earlier tool, or made by hand.

The run table and the raw files in the runs' folders are read as they are; what cannot be seen is told by options, or in
a TOML file. What was understood is shown before anything is written. The originals are never changed. Exit code 0:
adopted (or shown, with --dry-run); 2: refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.libraries import require_libraries
from robot_runner.cli.console import UserConsole, output, print_facts, print_json, shown_path
from robot_runner.cli.parser import UsageError, add_json
from robot_runner.cli.screens.plain import terminal_input
from robot_runner.core.words import counted, listed, one_line

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.analysis.importing.adoption import Adoption
    from robot_runner.analysis.importing.description import ImportDescription
    from robot_runner.analysis.importing.understanding import Understanding
    from robot_runner.cli.parser import Parser

__all__ = [
    "add_arguments",
    "differences_as_json",
    "execute",
    "print_adoption",
    "print_understanding",
    "understanding_as_json",
]


# What `robot-runner import` shows: what was understood, and how recomputed measures agree.

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


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument("folder", metavar="FOLDER", help="the folder that holds the run table and the runs' folders")
    parser.add_argument(
        "--to", metavar="FOLDER", help="the experiment folder to make; NAME_imported in the current folder if left out"
    )
    parser.add_argument("--description", metavar="FILE", help="a TOML file that describes the results")
    parser.add_argument(
        "--save-description", metavar="FILE", help="write what was understood to a TOML file, to mend it"
    )
    parser.add_argument("--name", help="the experiment's name; the folder's name if left out")
    parser.add_argument("--table", metavar="FILE", help="the run table, below the folder; run_table.csv if left out")
    for option, what in (("run-id", "the runs' ids"), ("status", "how far runs are"), ("repetition", "repetitions")):
        parser.add_argument(f"--{option}", metavar="COLUMN", help=f"the table's column of {what}")
    _add_repeated(parser, "--factor", "COLUMN", "a factor; may be given several times, and then all are to be named")
    _add_repeated(parser, "--measure", "COLUMN", "a measure; likewise")
    _add_repeated(parser, "--ignore", "COLUMN", "a column to leave out")
    _add_repeated(parser, "--unit", "COLUMN=UNIT", "the unit of a measure, such as energy=mJ")
    parser.add_argument("--run-folder", metavar="PATTERN", help="where a run's files are, such as 'raw/{run_id}'")
    _add_repeated(
        parser, "--samples", "FILE:COLUMN[:UNIT]", "raw samples and their time, in s, ms, us, ns, iso or a format"
    )
    _add_repeated(parser, "--sample-unit", "FILE:COLUMN=UNIT", "the unit of a column of samples: power.csv:power=mW")
    _add_repeated(
        parser,
        "--recompute",
        "MEASURE=HOW(FILE:COLUMN)",
        "how a measure comes out of samples: integral, mean, time_mean, mean_times_duration, sum, min, max, median, "
        "change, count or duration",
    )
    parser.add_argument("--origin", choices=("measured", "simulated", "estimated"), help="where the values come from")
    parser.add_argument("--no-guess", action="store_true", help="take nothing for samples that was not described")
    parser.add_argument("--dry-run", action="store_true", help="show what was understood, and write nothing")
    parser.add_argument("--yes", action="store_true", help="write without asking")
    add_json(parser)


def _add_repeated(parser: Parser, option: str, metavar: str, text: str) -> None:
    parser.add_argument(option, metavar=metavar, action="append", default=[], help=text)


def execute(arguments: Namespace) -> int:
    """Show what was understood; write it, if that is wanted; say how it differs from the table's own values."""
    require_libraries()
    from robot_runner.analysis.importing.adoption import adopt  # noqa: PLC0415 - takes a second to import
    from robot_runner.analysis.importing.understanding import understand  # noqa: PLC0415 - as above

    understanding = understand(Path(arguments.folder).expanduser(), _said(arguments))
    target = Path(arguments.to or f"{understanding.name}_imported").expanduser()
    if arguments.save_description:
        _save_description(Path(arguments.save_description), understanding)
    if not arguments.json:
        print_understanding(output(), understanding, target)
    if arguments.dry_run:
        return _shown(arguments, understanding)
    _make_sure(arguments)
    adoption = adopt(understanding, target)
    if arguments.json:
        print_json(
            {
                **understanding_as_json(understanding),
                "folder": str(adoption.folder),
                "differences": differences_as_json(adoption),
            }
        )
    else:
        print_adoption(output(), adoption)
    return 0


def _said(arguments: Namespace) -> ImportDescription:
    from robot_runner.analysis.importing.description import (  # noqa: PLC0415 - as above
        ImportDescription,
        parse_recipe,
        read_description,
    )

    described = read_description(Path(arguments.description)) if arguments.description else ImportDescription()
    return described.with_options(
        ImportDescription(
            name=arguments.name,
            table=arguments.table,
            run_id=arguments.run_id,
            status=arguments.status,
            repetition=arguments.repetition,
            factors=tuple(arguments.factor) or None,
            measures=tuple(arguments.measure) or None,
            ignore=tuple(arguments.ignore),
            units=dict(_assignment("--unit", each) for each in arguments.unit),
            run_folder=arguments.run_folder,
            samples=_samples(arguments),
            recipes=tuple(map(parse_recipe, arguments.recompute)),
            origin=arguments.origin,
            guess=not arguments.no_guess,
        )
    )


def _assignment(option: str, text: str) -> tuple[str, str]:
    from robot_runner.analysis.importing.description import check_unit  # noqa: PLC0415 - as above

    name, equals, unit = text.rpartition("=")
    if not equals or not name:
        raise UsageError(f"{text!r} names no unit", where=option, fix="Write COLUMN=UNIT, such as energy=mJ.")
    check_unit(unit, f"{option} {text}")
    return name.strip(), unit.strip()


def _samples(arguments: Namespace) -> Any:
    from robot_runner.analysis.importing.description import SamplesDescription, check_time_unit  # noqa: PLC0415 - as above

    units: dict[str, dict[str, str]] = {}
    for text in arguments.sample_unit:
        name, unit = _assignment("--sample-unit", text)
        file, colon, column = name.partition(":")
        if not colon:
            raise UsageError(f"{text!r} names no file", where="--sample-unit", fix="Write FILE:COLUMN=UNIT.")
        units.setdefault(file, {})[column] = unit
    times: dict[str, tuple[str, str | None]] = {}
    for text in arguments.samples:
        file, _, rest = text.partition(":")
        column, _, unit = rest.partition(":")
        if not column:
            raise UsageError(
                f"{text!r} names no column", where="--samples", fix="Write FILE:COLUMN or FILE:COLUMN:UNIT."
            )
        check_time_unit(unit or None, f"--samples {text}")
        times[file] = (column, unit or None)
    return tuple(
        SamplesDescription(
            file,
            time=times.get(file, (None, None))[0],
            time_unit=times.get(file, (None, None))[1],
            units=units.get(file, {}),
        )
        for file in dict.fromkeys([*times, *units])
    )


def _save_description(path: Path, understanding: Understanding) -> None:
    from robot_runner.analysis.importing.description import description_text  # noqa: PLC0415 - as above
    from robot_runner.core.storage.safe_write import write_beside_and_rename  # noqa: PLC0415 - as above

    text = description_text(understanding.description)
    write_beside_and_rename(path, lambda file: file.write(text))


def _shown(arguments: Namespace, understanding: Understanding) -> int:
    if arguments.json:
        print_json(understanding_as_json(understanding))
    else:
        output().print("Nothing was written (--dry-run).", style="bold")
    return 0


def _make_sure(arguments: Namespace) -> None:
    """Ask at a terminal whether it is right.

    Raises:
        UsageError: it is not, or nobody can be asked.
    """
    if arguments.yes:
        return
    if arguments.json or terminal_input() is None:
        fix = "Look at it with --dry-run, then add --yes."
        raise UsageError("nobody can be asked whether that is right", where="robot-runner import", fix=fix)
    answer = input("Is that right, and shall it be written? [y/N] ").strip().casefold()
    if answer not in {"y", "yes"}:
        fix = "Say what is otherwise by options, or mend a file made with --save-description."
        raise UsageError("nothing was written", where="robot-runner import", fix=fix)
