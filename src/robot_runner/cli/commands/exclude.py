"""Leave runs out of the statistics, and say why.

Nothing is removed: the runs stay in the run table with the reason, and in the report's account of deviations. A run
that is still to do is not executed either.
"""

from __future__ import annotations

from argparse import Namespace

from robot_runner.cli.excluding import exclude_runs
from robot_runner.cli.parser import Parser, add_runs, add_set, add_target
from robot_runner.cli.target import target_and_runs
from robot_runner.core.words import counted, listed


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_runs(parser)
    parser.add_argument(
        "--reason", metavar="TEXT", required=True, help="why: kept with the time, and shown wherever runs are counted"
    )
    add_set(parser)


def execute(arguments: Namespace) -> int:
    """Exclude the runs, and print them."""
    folder, runs = target_and_runs("exclude", arguments.target, arguments.runs, arguments.set)
    excluded = exclude_runs(folder, runs, arguments.reason)
    if not excluded:
        print("These runs are excluded already, for this reason.")
        return 0
    verb = "is" if len(excluded) == 1 else "are"
    print(f"{counted(len(excluded), 'run')} {verb} excluded: {listed(excluded)}. `robot-runner include` undoes it.")
    return 0
