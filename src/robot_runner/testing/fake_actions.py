"""Actions of the scripted robot link: a test decides how goals end, and when on the clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.goals import ActionAborted, ActionCanceled, ActionResult, GoalStatus
from robot_runner.core.links.robot import GoalExecution, Message

#: The step of the clock between two checks of a wait, s.
_POLL = 0.01


@dataclass(frozen=True, slots=True)
class FakeAction:
    """The script of an action: how each goal that is sent to it goes.

    Attributes:
        result: fields of the result.
        status: the final status of a goal that is not cancelled; with `REJECTED`, it is not accepted.
        seconds: the duration of a goal.
        feedback: sent at equal intervals during the goal.
        text: the text that an actionlib server adds to the status.
        refuses_cancel: whether a cancel request is refused.
        action_type: its type; `*` where it does not matter.

    Example:
        >>> FakeAction({"error_code": 0}, seconds=3.0, feedback=[{"distance_remaining": 1.0}]).status.is_over
        True
    """

    result: Mapping[str, Any] = field(default_factory=dict)
    status: GoalStatus = GoalStatus.SUCCEEDED
    seconds: float = 0.0
    feedback: Sequence[Mapping[str, Any]] = ()
    text: str = ""
    refuses_cancel: bool = False
    action_type: str = "*"


class FakeGoal:
    """A goal that was sent to the scripted link.

    Attributes:
        time: when it was sent, by the clock.
        action: the name of the action, as it was given.
        action_type: the type, as it was given.
        goal: the message.
        fault: why there will be no result; a test may set it.
    """

    def __init__(
        self,
        clock: Clock,
        script: FakeAction,
        sent: tuple[str, str, Message],
        on_feedback: Callable[[Message], None] | None,
        execute: Callable[[GoalExecution], Message] | None = None,
    ) -> None:
        self.time = clock.now()
        self.action, self.action_type, self.goal = sent
        self.is_cancel_requested = False
        self.fault: LinkError | None = None
        self._clock = clock
        self._script = script
        self._on_feedback = on_feedback or (lambda _: None)
        self._execute = execute
        self._told = 0
        self._result: ActionResult | None = None

    @property
    def status(self) -> GoalStatus:
        """The status at the clock's time."""
        self._go_on()
        return GoalStatus.EXECUTING if self._result is None else self._result.status

    def result(self, *, timeout: float) -> ActionResult:
        """Move the clock on until the goal is over; a `LinkError` says that it is not in time."""
        deadline = self._clock.now() + timeout
        while self._is_going_on() and self._clock.now() < deadline:
            self._clock.sleep(_POLL)
        if self._result is None:
            raise LinkError(f"the goal is not over within {timeout:g} s", where=self.action, fix="Wait longer.")
        return self._result

    def cancel(self, *, timeout: float = 5.0) -> None:
        """Cancel the goal; a `LinkError` says that the script refuses that."""
        del timeout
        if not self._is_going_on():
            return
        if self._script.refuses_cancel:
            raise LinkError("the server refuses to cancel the goal", where=self.action, fix="Look at its log.")
        self.is_cancel_requested = True
        if self._execute is None:
            self._result = ActionResult(GoalStatus.CANCELED, self._script.result)
        self._go_on()

    def feedback(self, message: Message) -> None:
        """Send feedback; for the `execute` of an action that is offered here."""
        self._on_feedback(message)

    def _is_going_on(self) -> bool:
        self._go_on()
        return self._result is None

    def _go_on(self) -> None:
        if self._result is not None:
            return
        if self._execute is not None:
            self._result = _executed(self._execute, self)
            return
        passed, script = self._clock.now() - self.time, self._script
        share = passed / script.seconds if script.seconds > 0 else 1.0
        while self._told < len(script.feedback) and share >= (self._told + 1) / (len(script.feedback) + 1):
            self._told += 1
            self._on_feedback(script.feedback[self._told - 1])
        if passed >= script.seconds:
            self._result = ActionResult(script.status, script.result, script.text)


def _executed(execute: Callable[[GoalExecution], Message], goal: FakeGoal) -> ActionResult:
    try:
        return ActionResult(GoalStatus.SUCCEEDED, execute(goal))
    except ActionCanceled as ending:
        return ActionResult(GoalStatus.CANCELED, ending.result, ending.text)
    except ActionAborted as ending:
        return ActionResult(GoalStatus.ABORTED, ending.result, ending.text)
