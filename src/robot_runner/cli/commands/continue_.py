"""Let an experiment that waits between two runs go on.

An experiment in SEMI mode waits so, and one that was paused; the command does the same as ENTER in its own terminal.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robot_runner.cli.console import shown_path
from robot_runner.cli.parser import add_set, add_target
from robot_runner.cli.planning import folder_of_target
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.experiment_status import ExperimentStatus, read_status
from robot_runner.core.storage.lock import Command, forget_pause, send_command

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser
    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = ["add_arguments", "execute"]

#: How long the experiment may take the request, in seconds; it looks several times a second.
_PATIENCE = 5.0
_LOOK = 0.05


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_target(parser)
    add_set(parser)


def execute(arguments: Namespace) -> int:
    """Tell the experiment to go on, and see that it has taken the request."""
    folder = folder_of_target(arguments.target, arguments.set)
    status = read_status(folder.root)
    if status.is_paused or status.pause_is_requested:
        forget_pause(folder.pause)
        print(f"{status.experiment_name} {'goes on' if status.is_paused else 'does not pause'}.")
        return 0
    _refuse_unless_it_waits(status)
    send_command(folder.control, Command.CONTINUE)
    _wait_until_taken(folder)
    number = status.done + status.failed + 1
    print(f"{status.experiment_name} goes on: {number} of {status.run_count} runs begun.")
    return 0


def _refuse_unless_it_waits(status: ExperimentStatus) -> None:
    where = shown_path(status.folder)
    if status.holder is None:
        left = status.todo + status.failed
        fix = "Start it with `robot-runner run` and its config: it resumes." if left else "All its runs are done."
        raise ExecutionError("nobody executes this experiment", where=where, fix=fix)
    if not status.is_waiting_for_user:
        doing = f"executes {status.current_run}" if status.current_run else "is between two runs"
        raise ExecutionError(
            f"the experiment does not wait: process {status.holder.pid} on {status.holder.host} {doing}",
            where=where,
            fix="Wait until it asks; in AUTO mode it never does.",
        )


def _wait_until_taken(folder: ExperimentFolder) -> None:
    end = time.monotonic() + _PATIENCE
    while folder.control.exists():
        if time.monotonic() > end:
            raise ExecutionError(
                f"the experiment has not taken the request after {_PATIENCE:g} s",
                where=shown_path(folder.root),
                fix="Press ENTER in its own terminal; the request is taken once the experiment looks again.",
            )
        time.sleep(_LOOK)
