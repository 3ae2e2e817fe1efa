"""A goal that a link sent to an action server, until it is over."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import ClassVar, Protocol

from robot_runner.core.errors import LinkError
from robot_runner.core.links.goals import ActionResult, GoalStatus
from robot_runner.core.links.robot import Message

#: How often it is looked whether the server of an awaited goal is still there, s.
_LOOK = 1.0


class ActionClient(Protocol):
    """One action of a graph, as it is used from here; kept for all goals of a link.

    Attributes:
        cancels_at_once: whether `cancel` returns at once; else it waits in vain for a server that is gone.
    """

    cancels_at_once: ClassVar[bool]

    def send(self, goal: Message, sent: SentGoal, timeout: float) -> None:
        """Send a complete goal, and return once it is accepted; raise a `LinkError` where it is not."""

    def cancel(self, sent: SentGoal, timeout: float) -> None:
        """Request the cancelling of a goal; raise a `LinkError` where the server refuses."""

    def is_served(self) -> bool:
        """Whether its server is still there."""

    def close(self) -> None:
        """Leave the action."""


class SentGoal:
    """A goal that was sent, until it is over: an action client reports its states and result, its sender waits for it.

    It is a `Goal` of `core.links.robot`, where the exceptions of `result` and `cancel` are documented. It waits as the
    link's transport does; `take_feedback` deals with what it raises. Its `key` identifies it in the protocol; it
    `is_abandoned` where its sender no longer waits, because it was not accepted in time.
    """

    def __init__(
        self, action: str, wait: Callable[[threading.Event, float], None], take_feedback: Callable[[Message], None]
    ) -> None:
        self.action = action
        self.key = ""
        self.is_abandoned = False
        self.client: ActionClient | None = None
        self._wait = wait
        self._take_feedback = take_feedback
        self._lock = threading.Lock()
        self.status = GoalStatus.UNKNOWN
        self._changed = threading.Event()
        self._is_over = threading.Event()
        self._result: ActionResult | None = None
        self.fault: LinkError | None = None

    @property
    def is_over(self) -> bool:
        """Whether there is a result, or will never be one."""
        return self._is_over.is_set()

    def result(self, *, timeout: float) -> ActionResult:
        """Wait until the goal is over and return its result; `timeout` is in seconds."""
        if not self._wait_until_over(timeout):
            problem = f"the goal is not over within {timeout:g} s: it is {self.status}"
            raise LinkError(problem, where=self.action, fix="Give a longer timeout, or cancel the goal.")
        if self._result is None:
            raise self.fault or self._gone()
        return self._result

    def cancel(self, *, timeout: float = 5.0) -> None:
        """Cancel the goal and wait until it is over; `timeout` is in seconds."""
        deadline = time.monotonic() + timeout
        self.ask_for_end(timeout)
        if not self._wait_until_over(timeout, deadline):
            problem = f"the goal does not end within {timeout:g} s after it was asked to: it is {self.status}"
            fix = "Check whether its server looks for cancel requests, or give a longer timeout."
            raise LinkError(problem, where=self.action, fix=fix)

    def ask_for_end(self, timeout: float) -> None:
        """Request the cancelling of the goal, if not over; raise a `LinkError` if its server refuses or is gone."""
        if self.is_over or self.client is None:
            return
        if self.client.cancels_at_once:  # to find out whether its server is there may take long
            self.client.cancel(self, timeout)
        if not self._is_served(self.client):
            self.lose(self._gone())
            raise self._gone()
        if not self.client.cancels_at_once:
            self.client.cancel(self, timeout)

    def note(self, status: GoalStatus) -> None:
        """Note its state on the server; a goal that is over stays over, and one that has begun was accepted before."""
        with self._lock:
            is_late = status is GoalStatus.ACCEPTED and self.status is not GoalStatus.UNKNOWN
            if not (self.status.is_over or is_late):
                self.status = status
        self._changed.set()

    def take_feedback(self, message: Message) -> None:
        """Pass feedback on while the goal is not over."""
        if not self.is_over:
            self._take_feedback(message)

    def finish(self, result: ActionResult) -> None:
        """Set the result; only the first counts."""
        with self._lock:
            if self._result is None and self.fault is None:
                self._result = result
                self.status = result.status
        self._end()

    def lose(self, fault: LinkError, *, before_told: Callable[[], object] = lambda: None) -> None:
        """End the goal without a result, even if one arrives now; `before_told` is called before its sender returns."""
        with self._lock:
            if self._result is None and self.fault is None:
                self.fault = fault
        try:
            before_told()
        finally:
            self._end()

    def wait_for_status(self, claim: Callable[[GoalStatus], bool], timeout: float) -> bool:
        """Wait until something holds of the status; return whether it does."""
        deadline = time.monotonic() + timeout
        while not claim(self.status):
            left = deadline - time.monotonic()
            if left <= 0 or self.fault is not None:
                return claim(self.status)
            self._changed.clear()
            if not claim(self.status):
                self._wait(self._changed, left)
        return True

    def _end(self) -> None:
        self._is_over.set()
        self._changed.set()

    def _wait_until_over(self, timeout: float, deadline: float | None = None) -> bool:
        # Its own count of the time: a simulated second is not one of this machine.
        left = timeout if deadline is None else min(timeout, max(0.0, deadline - time.monotonic()))
        while not self.is_over and left > 0:
            self._wait(self._is_over, min(_LOOK, left))
            left -= _LOOK
            if not self.is_over and self.client is not None and not self._is_served(self.client):
                self._wait(self._is_over, _LOOK)  # a result that is on its way
                if not self.is_over:
                    self.lose(self._gone())
        return self.is_over

    def _is_served(self, client: ActionClient) -> bool:
        try:
            return client.is_served()
        except LinkError:  # a graph that cannot be asked may carry a request all the same
            return True

    def _gone(self) -> LinkError:
        problem = f"the action server is gone; the goal was {self.status}"
        return LinkError(problem, where=self.action, fix="Look at the log of its node, and start it again.")
