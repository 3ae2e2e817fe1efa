"""Executes the goals of an action that a link offers, over any protocol."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from robot_runner.core.links.goals import ActionAborted, ActionCanceled, ActionResult, GoalStatus
from robot_runner.core.links.robot import GoalExecution, Message
from robot_runner.ros.shapes import Shape, completed

_logger = logging.getLogger(__name__)

#: How long a goal that is over is remembered, so that its client may still ask for its result, s; actionlib: 5.
_REMEMBERED_SECONDS = 60.0
#: How long the executions may take to end when their action is withdrawn, s.
_ENDING_SECONDS = 2.0


@dataclass(frozen=True, slots=True)
class ActionTypes:
    """The message types of an action: of its goal, of the result, and of the feedback during its execution."""

    goal: Shape
    result: Shape
    feedback: Shape


def part_of(shape: Shape, name: str) -> Shape:
    """Return the message type of a field."""
    return next(field.kind for field in shape.fields if field.name == name)  # type: ignore[return-value]


class Outlet(Protocol):
    """Publishes feedback, states and results of the goals of one action."""

    def tell_feedback(self, execution: Execution, message: Message) -> None:
        """Publish feedback of a goal, with every field."""

    def tell_status(self, executions: Sequence[Execution]) -> None:
        """Publish the states of all goals that are remembered."""

    def tell_result(self, execution: Execution, result: ActionResult) -> None:
        """Publish the result of a goal, with every field."""


class Execution:
    """A goal, with every field of its type, while it is executed, and for some time after.

    Its `key` is that of the protocol; `accepted_ns` is in ns since the epoch. Once it is over there is a `result`.
    """

    def __init__(self, server: GoalServer, key: str, goal: Message) -> None:
        self.key = key
        self.goal = goal
        self.accepted_ns = time.time_ns()
        self.status = GoalStatus.ACCEPTED
        self.result: ActionResult | None = None
        self.over = threading.Event()
        self.over_since = 0.0
        self.told = threading.Event()  # set once the result is published; `teller` is the thread that publishes it
        self.teller = 0
        self._server = server

    @property
    def is_cancel_requested(self) -> bool:
        """Whether its end was requested."""
        return self.status is GoalStatus.CANCELING

    def feedback(self, message: Message) -> None:
        """Send feedback to the client of the goal."""
        self._server.tell_feedback(self, message)


class GoalServer:
    """Executes the goals of an action, given by its full name, each in a thread of its own.

    `accept` says whether to accept a goal; None accepts all. `on_fault` is called with exceptions of `execute` or
    `accept` that are not the end of a goal.
    """

    def __init__(
        self,
        action: str,
        types: ActionTypes,
        execute: Callable[[GoalExecution], Message],
        accept: Callable[[Message], bool] | None,
        on_fault: Callable[[Exception], None],
    ) -> None:
        self.action = action
        self.types = types
        self.start: Callable[[Callable[[], None]], None] = _start_thread
        self._execute = execute
        self._accept = accept
        self._on_fault = on_fault
        self._lock = threading.Lock()
        # Held while states are read and published, so that the last message always has the newest ones. Reentrant, as a
        # callback that receives a state in the same thread may cancel a goal.
        self._telling = threading.RLock()
        self._executions: dict[str, Execution] = {}
        self._outlet: Outlet | None = None
        self._is_closed = False

    @property
    def executions(self) -> list[Execution]:
        """The goals that are remembered, the oldest first."""
        now = time.monotonic()
        with self._lock:
            self._executions = {
                key: each
                for key, each in self._executions.items()
                if not each.told.is_set() or now - each.over_since <= _REMEMBERED_SECONDS
            }
            return list(self._executions.values())

    def connect(self, outlet: Outlet) -> None:
        """Set where feedback, states and results are published."""
        self._outlet = outlet

    def find(self, key: str) -> Execution | None:
        """Return the execution of a goal, or None where it is not known."""
        with self._lock:
            return self._executions.get(key)

    def accept(self, key: str, goal: Mapping[str, object]) -> Execution | None:
        """Accept a goal and begin to execute it, or return None where it is rejected."""
        try:
            complete = completed(self.types.goal, goal, where=self.action)
            if not (self._accept is None or self._accept(complete)):
                return None
        except Exception as fault:  # noqa: BLE001 - the link fails the run for it
            self._on_fault(fault)
            return None
        execution = Execution(self, key, complete)
        with self._lock:
            if self._is_closed or key in self._executions:
                return None  # the action was withdrawn meanwhile, or the goal was sent twice
            self._executions[key] = execution
        self.start(lambda: self._run(execution))
        return execution

    def cancel(self, execution: Execution) -> bool:
        """Request the end of a goal; return whether it is not over yet."""
        with self._lock:
            if execution.status.is_over:
                return False
            execution.status = GoalStatus.CANCELING
        self._tell_status()
        return True

    def tell_feedback(self, execution: Execution, message: Message) -> None:
        """Publish feedback of a goal; raise a `LinkError` where it does not follow its definition."""
        complete = completed(self.types.feedback, message, where=f"the feedback of {self.action}")
        if self._outlet is not None and not execution.over.is_set():
            self._outlet.tell_feedback(execution, complete)

    def close(self) -> None:
        """Accept no more goals, and request the end of those that are executed; those that do not end are aborted.

        It returns once the results of all have been published, as the caller then leaves their topics.
        """
        with self._lock:  # so that every goal is either not accepted, or among those that are ended
            self._is_closed = True
        executions = self.executions
        for execution in executions:
            self.cancel(execution)
        deadline = time.monotonic() + _ENDING_SECONDS
        for execution in executions:
            if not execution.over.wait(max(0.0, deadline - time.monotonic())):
                self._finish(execution, GoalStatus.ABORTED, "the action is not offered any more", {})
            elif execution.teller != threading.get_ident():  # else a callback that receives the result closes this
                execution.told.wait(max(0.0, deadline - time.monotonic()))

    def _run(self, execution: Execution) -> None:
        with self._lock:
            if execution.status is GoalStatus.ACCEPTED:
                execution.status = GoalStatus.EXECUTING
        self._tell_status()
        try:
            result = self._execute(execution)
            complete = completed(self.types.result, result, where=f"the result of {self.action}")
            self._finish(execution, GoalStatus.SUCCEEDED, "", complete)
        except ActionCanceled as ending:
            # ROS has no state for an end that was not requested: the server gave the goal up.
            status = GoalStatus.CANCELED if execution.is_cancel_requested else GoalStatus.ABORTED
            self._finish(execution, status, ending.text, ending.result)
        except ActionAborted as ending:
            self._finish(execution, GoalStatus.ABORTED, ending.text, ending.result)
        except Exception as fault:  # noqa: BLE001 - the link fails the run for it
            self._on_fault(fault)
            self._finish(execution, GoalStatus.ABORTED, str(fault), {})

    def _finish(self, execution: Execution, status: GoalStatus, text: str, result: Mapping[str, object]) -> None:
        try:
            complete = completed(self.types.result, result, where=f"the result of {self.action}")
        except Exception as fault:  # noqa: BLE001 - as above
            self._on_fault(fault)
            status, complete = GoalStatus.ABORTED, completed(self.types.result, {}, where=self.action)
        with self._lock:
            if execution.over.is_set():
                return
            execution.status, execution.over_since = status, time.monotonic()
            execution.result = ActionResult(status, complete, text)
            execution.teller = threading.get_ident()
            execution.over.set()
        try:
            if self._outlet is not None:
                self._outlet.tell_result(execution, execution.result)
            self._tell_status()
        except Exception:
            _logger.info("the end of a goal of %s could not be reported", self.action, exc_info=True)
        execution.told.set()

    def _tell_status(self) -> None:
        with self._telling:
            try:
                if self._outlet is not None:
                    self._outlet.tell_status(self.executions)
            except Exception:  # goals go on, and can still be cancelled, although their states are not published
                _logger.warning("the states of the goals of %s could not be reported", self.action, exc_info=True)


def _start_thread(work: Callable[[], None]) -> None:
    threading.Thread(target=work, name="action", daemon=True).start()
