"""Let an experiment that waits for a person before a run go on.

An experiment in SEMI mode waits so, one that has steps for the operator, and one that was paused; the command does the
same as ENTER, or the answers, in its own terminal. `robot-runner status` says what is waited for.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence

from robot_runner.cli.console import shown_path
from robot_runner.cli.parser import Parser, add_set, add_target
from robot_runner.cli.target import target_or_only
from robot_runner.core.config.operator_steps import Question, read_answers
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.experiment_status import continue_and_see, questions_of, read_status, require_waiting
from robot_runner.core.storage.lock import forget_requests


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_set(parser)
    parser.add_several("--answer", "NAME=VALUE", "answer a question that the step asks, such as voltage=11.8")


def execute(arguments: Namespace) -> int:
    """Let the experiment go on, and wait until it has taken the request."""
    folder = target_or_only("continue", arguments.target, arguments.set)
    status = read_status(folder.root)
    if (status.is_paused or status.pause_is_requested) and not arguments.answer:
        forget_requests(folder.pause)
        print(f"{status.experiment_name} {'goes on' if status.is_paused else 'does not pause'}.")
        return 0
    require_waiting(status, shown_path(status.folder))
    answers = _answers(arguments.answer, questions_of(status), shown_path(status.folder))
    continue_and_see(folder, status.waiting_for, answers, shown_path(folder.root))
    step = (status.waiting_for or {}).get("step")
    number = status.done + status.failed + 1
    done = f"{step!r} is done" if step else f"{number} of {status.run_count} runs begun"
    print(f"{status.experiment_name} goes on: {done}.")
    return 0


def _answers(given: Sequence[str], questions: Sequence[Question], where: str) -> dict[str, str]:
    """Return the answers by the names of the questions.

    Raises:
        ExecutionError: some are missing, or would not be taken; all of them are named.
    """
    answers: dict[str, str] = {}
    findings: list[Finding] = []
    for each in given:
        name, sign, text = each.partition("=")
        answers[name.strip()] = text
        if not sign:
            answers.pop(name.strip())
            findings.append(Finding.error(where, f"{each!r} is not an answer", "Write --answer NAME=VALUE."))
    _, refused = read_answers(questions, answers)
    findings += [Finding.error(f"--answer {each.where}", each.problem, each.fix) for each in refused]
    ExecutionError.refuse(findings)
    return answers
