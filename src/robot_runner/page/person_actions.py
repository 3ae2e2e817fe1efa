"""The actions of a page, the only part of it that writes: answer and continue, pause, end a pause, stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from robot_runner.core.config.operator_steps import read_answers
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.experiment_status import (
    ExperimentStatus,
    continue_and_see,
    questions_of,
    require_executed,
    require_waiting,
)
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import forget_requests, leave_request
from robot_runner.page.followed_experiment import FollowedExperiment

_LONGEST_ANSWER = 2_000


class RefusedAnswersError(ExecutionError):
    """Answers were refused; the findings' `where` are the names of the questions."""


def _go_on(experiment: FollowedExperiment, said: Mapping[str, Any]) -> str:
    """Tell an experiment that waits to go on with these answers.

    Raises:
        RefusedAnswersError: an answer is refused.
        ExecutionError: it does not wait, or for something else than the person saw.
    """
    status = _status(experiment)
    require_waiting(status, experiment.folder.name)
    waiting = status.waiting_for or {}
    if (said.get("run"), said.get("step")) != (waiting.get("next_run"), waiting.get("step")):
        raise ExecutionError("it no longer waits for this", where=str(said.get("run")), fix="Look at what it asks now.")
    given = said.get("answers", {})
    answers = {
        str(name): str(text)[:_LONGEST_ANSWER] for name, text in (given.items() if isinstance(given, dict) else ())
    }
    _, refused = read_answers(questions_of(status), answers)
    RefusedAnswersError.refuse(map(_for_a_page, refused))
    continue_and_see(ExperimentFolder(experiment.folder), waiting, answers, experiment.folder.name)
    return "It goes on."


def _for_a_page(finding: Finding) -> Finding:
    """Return a finding without its fix, which is for the command line."""
    is_missing = finding.fix.startswith("Add --answer")
    return type(finding).error(finding.where, finding.problem, "Enter an answer." if is_missing else finding.fix)


def _pause(experiment: FollowedExperiment, _said: Mapping[str, Any]) -> str:
    """Ask for a pause before the next run."""
    status = _status(experiment)
    require_executed(status, experiment.folder.name, "There is nothing to pause")
    leave_request(ExperimentFolder(experiment.folder).pause)
    return f"It pauses {status.moment_of_pause}."


def _end_pause(experiment: FollowedExperiment, _said: Mapping[str, Any]) -> str:
    """End a pause, or take the request back."""
    require_executed(_status(experiment), experiment.folder.name, "There is nothing to go on with")
    forget_requests(ExperimentFolder(experiment.folder).pause)
    return "It goes on."


def _stop(experiment: FollowedExperiment, _said: Mapping[str, Any]) -> str:
    """Ask to stop as by Ctrl-C."""
    status = _status(experiment)
    require_executed(status, experiment.folder.name, "There is nothing to stop")
    leave_request(ExperimentFolder(experiment.folder).stop)
    return f"It stops: {status.closed_first}." if status.closed_first else "It stops."


def _status(experiment: FollowedExperiment) -> ExperimentStatus:
    experiment.look()
    status = experiment.status()
    if status is None:
        fix = "Wait a moment."
        raise ExecutionError("nothing is known of this experiment yet", where=experiment.folder.name, fix=fix)
    return status


#: The actions by their names in URLs: functions of the experiment and the request's JSON, which return a message.
ACTIONS: dict[str, Callable[[FollowedExperiment, Mapping[str, Any]], str]] = {
    "continue": _go_on,
    "pause": _pause,
    "end-pause": _end_pause,
    "stop": _stop,
}
