"""The condition that a person has said yes, from any terminal."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from dataclasses import dataclass

from robot_runner.core.errors import ConditionError
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import take_request
from robot_runner.core.words import one_line


def confirmed(what: str) -> Condition:
    """Return the condition that a person has said yes, with `robot-runner continue` in any terminal.

    It is for a moment within a run. What a person does before a run is a step of the operator (`OperatorStep`).

    Args:
        what: what they confirm, so that it completes the sentence "a person says that ...".

    Raises:
        ConditionError: it is empty.

    Example:
        >>> print(confirmed("the robot has left the lift"))
        a person says that the robot has left the lift
    """
    if not isinstance(what, str) or not what.strip():
        fix = "Say what, as in confirmed('the robot has left the lift')."
        raise ConditionError("nothing is to be confirmed", where="confirmed", fix=fix)
    return Confirmed(one_line(what.strip()))


@dataclass(frozen=True)
class Confirmed(Condition):
    """What a person is to confirm."""

    what: str

    is_outside = True
    every_s = 0.2

    def __str__(self) -> str:
        return f"a person says that {self.what}"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        """Ask, and look for the answer; an earlier one does not count."""
        folder = ExperimentFolder.found_at(context.experiment_folder)
        asked = (context.run_id, self.what)
        take_request(folder.control, asked)
        command = f"robot-runner continue {shlex.quote(str(folder.root))}"
        context.broker.note(context.owner, "asked", {"step": self.what, "command": command})
        opened.callback(lambda: context.broker.note(context.owner, "answered", {"step": self.what}))
        is_confirmed = False

        def look() -> Look:
            nonlocal is_confirmed
            is_confirmed = is_confirmed or take_request(folder.control, asked) is not None
            return Look(is_confirmed, "confirmed" if is_confirmed else command, is_confirmed)

        return look
