"""Take runs in again that were excluded.

The journal keeps that they were excluded, why and how long.
"""

from __future__ import annotations

from argparse import Namespace

from robot_runner.cli.excluding import include_runs
from robot_runner.cli.parser import Parser, add_runs, add_set, add_target
from robot_runner.cli.target import target_and_runs
from robot_runner.core.words import counted, listed


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_runs(parser)
    parser.add_argument("--reason", metavar="TEXT", default="", help="why they count after all: kept with the time")
    add_set(parser)


def execute(arguments: Namespace) -> int:
    """Include the runs, and print them."""
    folder, runs = target_and_runs("include", arguments.target, arguments.runs, arguments.set)
    included = include_runs(folder, runs, arguments.reason)
    print(f"{counted(len(included), 'run')} {'counts' if len(included) == 1 else 'count'} again: {listed(included)}.")
    return 0
