"""Stop an experiment from another terminal, as Ctrl-C does in its own.

The run that is being executed is closed, its robot made safe, and is to be done again; `robot-runner run` goes on.
"""

from __future__ import annotations

from argparse import Namespace

from robot_runner.cli.console import shown_path
from robot_runner.cli.parser import Parser, add_set, add_target
from robot_runner.cli.target import target_or_only
from robot_runner.core.execution.experiment_status import read_status, require_executed
from robot_runner.core.storage.lock import leave_request


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_set(parser)


def execute(arguments: Namespace) -> int:
    """Leave the request, and print its effect on the run."""
    folder = target_or_only("stop", arguments.target, arguments.set)
    status = read_status(folder.root)
    require_executed(status, shown_path(folder.root), "There is nothing to stop")
    leave_request(folder.stop)
    runs = f"; {status.closed_first}" if status.closed_first else ""
    print(f"{status.experiment_name} stops{runs}. To go on later: robot-runner run with its config.")
    return 0
