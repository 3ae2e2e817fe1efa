"""Execute the paper's experiment on the embedded robot.

It has 3 tasks x 5 repetitions, with energy, CPU and memory. The config file is written beside the results, to be read,
changed and executed again.
"""

from __future__ import annotations

import csv
import itertools
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    command_line,
    output,
    print_facts,
    shown_path,
    width_of,
)
from robot_runner.cli.design_words import heading_of
from robot_runner.cli.executing import Execution, execute_on_screen, read_or_not
from robot_runner.cli.screens.ending import print_verdict, whereabouts
from robot_runner.cli.templating import template, write_new_file
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import LinkError, StorageError
from robot_runner.core.links.connect import SIMULATED, link_findings
from robot_runner.core.words import shown_value

if TYPE_CHECKING:
    from robot_runner.cli.parser import Parser
    from robot_runner.core.execution.notices import ExperimentFinished

_FOLDER = "robot-runner-demo"
_SHOWN = ("run_id", "status", "Task", "Repetition", "CPU", "Memory", "Energy")
_UNITS = {"CPU": "%", "Memory": "%", "Energy": "J"}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--folder",
        metavar="FOLDER",
        default=_FOLDER,
        help=f"where to (./{_FOLDER} if it is left out); where it is in use, a numbered one beside it, or in it for .",
    )
    parser.add_argument("--plain", action="store_true", help="print plain lines on a terminal, too")


def execute(arguments: Namespace) -> int:
    """Execute the demo in a folder of its own, and show its results."""
    LinkError.refuse(link_findings(SIMULATED))  # before anything is written
    folder = _fresh(Path(arguments.folder).expanduser())
    config = folder / "demo.py"
    write_new_file(config, template("demo_config.py"), instead="Choose another folder.")
    experiment = prepare_or_refuse(config)
    execution = execute_on_screen(experiment, plain=arguments.plain)
    with read_or_not():
        if execution.finished:
            _print(output(), execution, execution.finished, config)
    return execution.exit_code


def _print(console: UserConsole, execution: Execution, finished: ExperimentFinished, config: Path) -> None:
    rows = _rows(finished.run_table)
    if not execution.was_shown_live:
        _print_table(console, rows)
    print_verdict(console, finished, execution.progress)
    _print_means(console, rows)
    again = command_line(shown_path(config))
    if finished.todo_count or finished.failed_count:
        following = [("Next", f"go on where it ended: {again}")]
    else:
        following = [
            ("Config", shown_path(config)),
            ("Next", f"change experiment_name and the tasks in it, then execute it: {again}"),
            ("", f"or begin an experiment of your own: {command_line('new')}"),
        ]
    print_facts(console, [*whereabouts(finished, execution.progress), *following])


def _fresh(wanted: Path) -> Path:
    """Make and return the folder, or the first numbered one beside it that is not in use.

    Of `.`, `..` and `/`, which have no name that could be numbered, it is a folder inside.
    """
    if wanted.name in {"", ".."} and wanted.is_dir() and any(wanted.iterdir()):
        return _fresh(wanted / _FOLDER)
    numbered = (wanted.with_name(f"{wanted.name}-{number}") for number in itertools.count(2))
    for folder in itertools.chain([wanted], numbered):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            is_free = not any(folder.iterdir())
        except FileExistsError:  # a file has this name
            continue
        except OSError as error:
            problem = f"the folder cannot be made: {error.strerror}"
            raise StorageError(problem, where=str(folder), fix="Name another one with --folder.") from error
        if is_free:
            return folder
    raise AssertionError  # there is always another number


def _rows(run_table: Path) -> list[dict[str, str]]:
    with run_table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _print_table(console: UserConsole, rows: Sequence[Mapping[str, str]]) -> None:
    console.print()
    cells = [[_cell(row, name) for name in _SHOWN] for row in rows]
    headings = [heading_of(name, _UNITS.get(name, "")) for name in _SHOWN]
    columns = [
        Column(column[0], width_of(column), name in _UNITS)
        for name, column in zip(_SHOWN, zip(headings, *cells, strict=True), strict=True)
    ]
    console.print("  " + aligned(columns, [column.heading for column in columns]), style="bold", soft_wrap=True)
    for line in cells:
        console.print("  " + aligned(columns, line), soft_wrap=True)


def _cell(row: Mapping[str, str], name: str) -> str:
    value = row.get(name, "")
    return shown_value(float(value) if value else None) if name in _UNITS else value


def _print_means(console: UserConsole, rows: Sequence[Mapping[str, str]]) -> None:
    energies: dict[str, list[float]] = {}
    for row in rows:
        if row["Energy"]:
            energies.setdefault(row["Task"], []).append(float(row["Energy"]))
    if not energies:
        return
    console.print()
    console.print("Mean energy of a mission by task", style="bold")
    means = {task: sum(values) / len(values) for task, values in energies.items()}
    longest = max(means.values())
    for task, mean in sorted(means.items(), key=lambda item: -item[1]):
        bar = "█" * round(40 * mean / longest)
        console.print(Text(f"  {task:12} {mean:7.1f} J  ").append(bar, style="cyan"), soft_wrap=True)
    console.print()
