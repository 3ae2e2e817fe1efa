"""What a person asks of an experiment that another process executes: to go on, to pause, to stop."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robot_runner.core.config.operator_steps import Question
from robot_runner.core.errors import ExecutionError
from robot_runner.core.storage.lock import Command, send_command

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.execution.experiment_status import ExperimentStatus
    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = ["continue_and_see", "questions_of", "require_executed", "require_waiting"]

#: How long the experiment may take the request, in seconds; it looks several times a second.
_PATIENCE = 5.0
_LOOK = 0.05


def questions_of(status: ExperimentStatus) -> list[Question]:
    """Return what an experiment asks at this moment."""
    asked = status.waiting_for["questions"] if status.waiting_for else ()
    return [Question.from_mapping(facts) for facts in asked]


def require_executed(status: ExperimentStatus, where: str, what: str) -> None:
    """Let only an experiment pass that somebody executes.

    Args:
        status: how far it is.
        where: its folder, as the person reads it.
        what: what cannot be done otherwise: `There is nothing to pause`.

    Raises:
        ExecutionError: nobody does.
    """
    if status.holder is None:
        fix = f"{what}; `robot-runner run` with its config goes on."
        raise ExecutionError("nobody executes this experiment", where=where, fix=fix)


def require_waiting(status: ExperimentStatus, where: str) -> None:
    """Let only an experiment pass that waits for a person.

    Raises:
        ExecutionError: it does not; says what it does.
    """
    if status.holder is None:
        left = status.todo + status.failed
        fix = "Start it with `robot-runner run` and its config: it resumes." if left else "All its runs are done."
        raise ExecutionError("nobody executes this experiment", where=where, fix=fix)
    if not status.is_waiting_for_user:
        doing = f"executes {status.current_run}" if status.current_run else "is between two runs"
        raise ExecutionError(
            f"the experiment does not wait: process {status.holder.pid} on {status.holder.host} {doing}",
            where=where,
            fix="Wait until it asks; without steps for the operator, and in AUTO mode, it never does.",
        )


def continue_and_see(files: ExperimentFolder, answers: Mapping[str, str], where: str) -> None:
    """Tell an experiment that waits to go on, and see that it has taken the request.

    Raises:
        StorageError: the folder cannot be written.
        ExecutionError: the request was not taken within five seconds.
    """
    send_command(files.control, Command.CONTINUE, answers)
    end = time.monotonic() + _PATIENCE
    while files.control.exists():
        if time.monotonic() > end:
            raise ExecutionError(
                f"the experiment has not taken the request after {_PATIENCE:g} s",
                where=where,
                fix="Press ENTER in its own terminal; the request is taken once the experiment looks again.",
            )
        time.sleep(_LOOK)
