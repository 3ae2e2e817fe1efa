"""Explain where the values of a run come from, or check an experiment or package against ACM's artifact badges.

For each value: plugin, raw file, aggregation, config line, attempt and host.
"""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_folded, print_json
from robot_runner.cli.parser import Parser, add_json, add_set, add_target
from robot_runner.cli.target import folder_of_target, only_experiment, target_and_runs
from robot_runner.core.storage.table_columns import ColumnRole
from robot_runner.core.words import one_line, shown_treatment, shown_value

if TYPE_CHECKING:
    from robot_runner.replication.explanation import RunExplanation

_MARKS = {"met": "+", "not met": "-"}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    parser.add_argument(
        "run",
        metavar="RUN",
        nargs="?",
        help="the run's id, such as r_3; if left out, show the checklist of ACM's artifact badges for the experiment, "
        "or for a package given in its place",
    )
    parser.add_argument(
        "names", metavar="NAME", nargs="*", help="measures or columns of the run table; all of them if left out"
    )
    add_set(parser)
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print the origin of each value."""
    if arguments.run is None and not _may_be_run(arguments.target):
        return _explain_badges(arguments)
    words = [*filter(None, [arguments.run]), *arguments.names]
    folder, (run, *names) = target_and_runs("explain", arguments.target, words, arguments.set)
    from robot_runner.replication.explanation import explain_run  # noqa: PLC0415 - for a quick --help

    explanation = explain_run(folder.root, run, names)
    if arguments.json:
        print_json(asdict(explanation))
    else:
        _print(output(), explanation)
    return 0


def _may_be_run(target: str | None) -> bool:
    path = Path(target or "")
    return not (path.exists() or path.suffix or path.name != target)


def _explain_badges(arguments: Namespace) -> int:
    from robot_runner.replication.badges import badges_of  # noqa: PLC0415 - for a quick --help

    target = arguments.target or only_experiment("explain")
    path = Path(target).expanduser()
    is_config = path.suffix == ".py" or not path.exists()
    name, lines = badges_of(folder_of_target(target, arguments.set).root if is_config else path)
    if arguments.json:
        print_json({"name": name, "badges": [{**asdict(line), "state": line.state.value} for line in lines]})
        return 0
    console = output()
    console.print(Text(one_line(f"{name}: ACM's artifact badges"), style="bold"))
    for badge in dict.fromkeys(line.badge for line in lines):
        console.print()
        console.print(Text(one_line(badge), style="bold"))
        for line in (each for each in lines if each.badge == badge):
            state = line.state.value
            told = one_line(f"{line.what} ({state}). {line.fact}")
            print_folded(console, f"  {_MARKS.get(state, '?')} ", told, style="")
    return 0


def _print(console: UserConsole, explanation: RunExplanation) -> None:
    console.print(Text(f"{explanation.run_id} of {explanation.experiment}", style="bold"))
    print_facts(console, [(what, one_line(text)) for what, text in explanation.facts])
    for each in explanation.values:
        unit = f" {each.unit}" if each.unit not in {"", "1"} and each.value is not None else ""
        is_treatment = each.role == ColumnRole.FACTOR.value  # told digit by digit, as the table has it
        value = shown_treatment(each.value) if is_treatment else shown_value(each.value)
        head = Text(each.name, style="bold").append(f"  {value}{unit}", "not bold cyan")
        console.print()
        console.print(head.append(f"  {each.role}", "not bold dim"), soft_wrap=True)
        print_facts(console, [(what, one_line(text)) for what, text in each.facts])
