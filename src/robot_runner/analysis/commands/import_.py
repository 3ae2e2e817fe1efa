"""Adopt results of an earlier tool, or made by hand.

The run table and the raw files in the runs' folders are read as they are; options or a TOML file give
what cannot be seen. What was understood is shown before anything is written. The originals are never changed.
Exit code 0: adopted (or shown, with --dry-run); 2: refused.
"""

from __future__ import annotations

import signal
from argparse import Namespace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from robot_runner.analysis.commands.import_words import (
    differences_as_json,
    print_adoption,
    print_understanding,
    understanding_as_json,
)
from robot_runner.analysis.declared_design import parse_design
from robot_runner.analysis.importing.description import (
    ImportDescription,
    SamplesDescription,
    check_time_unit,
    check_unit,
    description_text,
    parse_recipe,
    read_description,
)
from robot_runner.analysis.libraries import require_libraries
from robot_runner.cli.console import output, print_json
from robot_runner.cli.parser import Parser, UsageError, add_json
from robot_runner.cli.screens.plain import terminal_input
from robot_runner.core.errors import AnalysisError
from robot_runner.core.execution.interruption import stop_signals_handled, stop_signals_to_handle
from robot_runner.core.storage.safe_write import write_beside_and_rename

if TYPE_CHECKING:
    from robot_runner.analysis.importing.understanding import Understanding

#: Options that say the same as the entry of a description with their name.
_TEXTS = ("name", "table", "run_id", "status", "repetition", "block", "run_folder", "origin")


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("folder", metavar="FOLDER", help="the folder that holds the run table and the runs' folders")
    parser.add_argument(
        "--to", metavar="FOLDER", help="the experiment folder to make; NAME_imported in the current folder if left out"
    )
    parser.add_argument("--description", metavar="FILE", help="a TOML file that describes the results")
    parser.add_argument(
        "--save-description", metavar="FILE", help="write what was understood to a TOML file, to correct it"
    )
    parser.add_argument("--name", help="the experiment's name; the folder's name if left out")
    parser.add_argument("--table", metavar="FILE", help="the run table, below the folder; run_table.csv if left out")
    for option, what in (("run-id", "the runs' ids"), ("status", "how far runs are"), ("repetition", "repetitions")):
        parser.add_argument(f"--{option}", metavar="COLUMN", help=f"the table's column of {what}")
    parser.add_argument(
        "--block", metavar="COLUMN", help="what runs are grouped by, such as the robot, the room or the day"
    )
    _add_repeated(parser, "--factor", "COLUMN", "a factor; may be given several times")
    _add_repeated(parser, "--measure", "COLUMN", "a measure; likewise")
    _add_repeated(parser, "--ignore", "COLUMN", "a column to leave out")
    parser.add_argument(
        "--design",
        metavar="KIND:PART=COLUMN,...",
        help="the design by which the runs were planned, such as crossover:unit=Robot,period=Day,washout=yes or "
        "split_plot:plot=Laying; its columns are taken out of the comparison",
    )
    parser.add_argument(
        "--decimal", choices=("point", "comma"), help="the decimal sign of the table's numbers, where it is not clear"
    )
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
    parser.add_argument(
        "--no-guess",
        action="store_true",
        help="take nothing for samples that was not named, and, with --factor, no other column for a factor",
    )
    parser.add_argument("--dry-run", action="store_true", help="show what was understood, and write nothing")
    parser.add_argument("--yes", action="store_true", help="write without asking, unless something is not sure")
    add_json(parser)


def _add_repeated(parser: Parser, option: str, metavar: str, text: str) -> None:
    parser.add_argument(option, metavar=metavar, action="append", default=[], help=text)


def execute(arguments: Namespace) -> int:
    """Show what was understood; write it, if wanted; show where recomputed values differ from the table's."""
    require_libraries()
    from robot_runner.analysis.importing.adoption import adopt  # noqa: PLC0415 - takes a second to import
    from robot_runner.analysis.importing.understanding import understand  # noqa: PLC0415 - as above

    understanding = understand(Path(arguments.folder).expanduser(), _said(arguments))
    target = Path(arguments.to or f"{understanding.name}_imported").expanduser()
    if arguments.save_description:
        text = description_text(understanding.description)
        write_beside_and_rename(Path(arguments.save_description).expanduser(), lambda file: file.write(text))
    if not arguments.json:
        print_understanding(output(), understanding, target)
    if arguments.dry_run:
        if arguments.json:
            print_json(understanding_as_json(understanding))
        else:
            output().print("Nothing was written (--dry-run).", style="bold")
        return 0
    _make_sure(arguments, understanding)
    with stop_signals_handled(_stop):
        adoption = adopt(understanding, target)
    if arguments.json:
        print_json(
            {
                **understanding_as_json(understanding),
                "folder": str(adoption.folder),
                "differences": differences_as_json(adoption),
                "warnings": list(adoption.warnings),
            }
        )
    else:
        print_adoption(output(), adoption)
    return 0


def _stop(_number: int, _frame: FrameType | None) -> None:
    """End the import by an exception, so that what is half written is removed; a second signal changes nothing."""
    for number in stop_signals_to_handle():
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _said(arguments: Namespace) -> ImportDescription:
    path = Path(arguments.description).expanduser() if arguments.description else None
    described = ImportDescription() if path is None else read_description(path)
    return described.with_options(
        ImportDescription(
            **{name: getattr(arguments, name) for name in _TEXTS},
            decimal={"point": ".", "comma": ","}.get(arguments.decimal),
            factors=tuple(arguments.factor) or None,
            measures=tuple(arguments.measure) or None,
            ignore=tuple(arguments.ignore),
            units=dict(_assignment("--unit", each) for each in arguments.unit),
            samples=_samples(arguments),
            recipes=tuple(map(parse_recipe, arguments.recompute)),
            guess=not arguments.no_guess,
            design=parse_design(arguments.design) if arguments.design else None,
        )
    )


def _assignment(option: str, text: str) -> tuple[str, str]:
    name, equals, unit = text.rpartition("=")
    if not equals or not name:
        raise UsageError(f"{text!r} names no unit", where=option, fix="Write COLUMN=UNIT, such as energy=mJ.")
    check_unit(unit, f"{option} {text}")
    return name.strip(), unit.strip()


def _samples(arguments: Namespace) -> tuple[SamplesDescription, ...]:
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
        time, _, unit = rest.partition(":")
        if not time:
            fix = "Write FILE:COLUMN or FILE:COLUMN:UNIT."
            raise UsageError(f"{text!r} names no column", where="--samples", fix=fix)
        check_time_unit(unit or None, f"--samples {text}")
        times[file] = (time, unit or None)
    said = []
    for file in dict.fromkeys([*times, *units]):
        heading, counted_in = times.get(file, (None, None))
        said.append(SamplesDescription(file, time=heading, time_unit=counted_in, units=units.get(file, {})))
    return tuple(said)


def _make_sure(arguments: Namespace, understanding: Understanding) -> None:
    """Ask at a terminal whether the understanding is right.

    Raises:
        AnalysisError: with `--yes`, something is not sure; its findings name the options that settle it.
        UsageError: the user says no, or there is no terminal.
    """
    if arguments.yes:
        AnalysisError.refuse(understanding.questions)
        return
    if arguments.json or terminal_input() is None:
        fix = "Look at it with --dry-run, then add --yes."
        raise UsageError("nobody can be asked whether that is right", where="robot-runner import", fix=fix)
    answer = input("Is that right, and shall it be written? [y/N] ").strip().casefold()
    if answer not in {"y", "yes"}:
        fix = "Say what is otherwise by options, or correct a file made with --save-description."
        raise UsageError("nothing was written", where="robot-runner import", fix=fix)
