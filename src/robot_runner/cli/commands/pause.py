"""Let an experiment pause once the run that is being executed has ended.

Nothing is ended: `robot-runner continue` goes on. An experiment that ends or is killed meanwhile is not paused when it
is resumed.
"""

from __future__ import annotations

from argparse import Namespace

from robot_runner.cli.console import shown_path
from robot_runner.cli.parser import Parser, add_set, add_target
from robot_runner.cli.screens.plain import continue_command
from robot_runner.cli.target import target_or_only
from robot_runner.core.execution.experiment_status import read_status, require_executed
from robot_runner.core.storage.lock import leave_request


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_set(parser)


def execute(arguments: Namespace) -> int:
    """Leave the request, and print when it takes effect."""
    folder = target_or_only("pause", arguments.target, arguments.set)
    status = read_status(folder.root)
    require_executed(status, shown_path(folder.root), "There is nothing to pause")
    command = continue_command(folder.root)
    if status.is_paused:
        print(f"{status.experiment_name} is paused already. To go on: {command}")
        return 0
    leave_request(folder.pause)
    print(f"{status.experiment_name} pauses {status.moment_of_pause}. To go on, or to take this back: {command}")
    return 0
