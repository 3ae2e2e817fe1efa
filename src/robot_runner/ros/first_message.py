"""Waits for the first message of a topic that satisfies a condition, over any transport."""

from __future__ import annotations

import threading
from collections.abc import Callable

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Message


class FirstMessage:
    """Keeps the first message that satisfies a condition (None: any), or what the condition raised; then `is_over`.

    The caller waits for `timeout` (s), which is for the error.
    """

    def __init__(self, condition: Callable[[Message], bool] | None, timeout: float) -> None:
        self.is_over = threading.Event()
        self._condition = condition
        self._timeout = timeout
        self._found: Message | None = None
        self._fault: Exception | None = None
        self._lock = threading.Lock()  # in ROS 1 each publisher of the topic has a thread here

    def take(self, message: Message) -> None:
        """Check one message."""
        if self.is_over.is_set():
            return
        fault: Exception | None = None
        try:
            if not (self._condition is None or self._condition(message)):
                return
        except Exception as raised:  # noqa: BLE001 - it is raised to the caller whose condition this is
            fault = raised
        with self._lock:
            if not self.is_over.is_set():
                self._found, self._fault = message, fault
                self.is_over.set()

    def result(self, topic: str, explain: Callable[[], str]) -> Message:
        """Return the message.

        Raises:
            LinkError: there was none in time; `explain` returns the fix.
            Exception: the condition's own.
        """
        if self._fault is not None:
            raise self._fault
        if self._found is None:
            what = "no message" if self._condition is None else "no message that satisfies the condition"
            fix = explain() or "Check whether the topic's node is alive, or give a longer timeout."
            raise LinkError(f"{what} came within {self._timeout:g} s", where=topic, fix=fix)
        return self._found
