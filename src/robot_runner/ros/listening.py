"""What the links of real graphs share about callbacks, which come from threads of the client library."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.links.robot import Message, Subscription

__all__ = ["first_message", "guarded"]

_logger = logging.getLogger(__name__)


def guarded(callback: Callable[[Any], None], where: str) -> Callable[[Any], None]:
    """Return the callback with its faults written to the run's log: a thread of the client library hears nobody's.

    Args:
        callback: called with each message.
        where: the topic.
    """

    def call(message: Any) -> None:
        try:
            callback(message)
        except Exception:
            _logger.exception("the callback of %s raised", where)

    return call


def first_message(
    subscribe: Callable[[Callable[[Message], None]], Subscription],
    condition: Callable[[Message], bool] | None,
    *,
    timeout: float,
    where: str,
    explain: Callable[[], str] = str,
    wait: Callable[[threading.Event, float], object] = threading.Event.wait,
) -> Message:
    """Return the first message from now on that satisfies the condition.

    Args:
        subscribe: subscribes a callback, which is called from another thread.
        condition: None for any message. What it raises is raised here.
        timeout: how long to wait, s.
        where: the topic.
        explain: says why none may have come: one imperative, or nothing.
        wait: waits for an event, for so many seconds.

    Raises:
        LinkError: none came in time.
    """
    found: list[Message] = []
    faults: list[Exception] = []
    is_over = threading.Event()

    def hear(message: Message) -> None:
        if is_over.is_set():
            return
        try:
            if condition is None or condition(message):
                found.append(message)
                is_over.set()
        except Exception as fault:  # noqa: BLE001 - it is raised where the condition came from
            faults.append(fault)
            is_over.set()

    subscription = subscribe(hear)
    try:
        wait(is_over, timeout)
        is_over.set()
    finally:
        subscription.close()
    if faults:
        raise faults[0]
    if not found:
        raise _silence(where, timeout, is_any=condition is None, fix=explain())
    return found[0]


def _silence(where: str, timeout: float, *, is_any: bool, fix: str) -> LinkError:
    what = "no message" if is_any else "no message that satisfies the condition"
    return LinkError(
        f"{what} came within {timeout:g} s",
        where=where,
        fix=fix or "Look whether the topic's node is alive, or give a longer timeout.",
    )
