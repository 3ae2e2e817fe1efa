"""The callbacks that a config subscribed, and those that it defines and forgot to subscribe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.dialects.hooks import check_callback
from robot_runner.dialects.stand_ins.events import RobotRunnerEvents, RunnerEvents, own_event
from robot_runner.errors import ConfigError, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.dialects.session import Session

__all__ = ["check_subscriptions"]


def check_subscriptions(session: Session, config: Any) -> list[Finding]:
    """Return what is wrong with the callbacks, and which would never be called."""
    return [*_unfit(session), *_forgotten(session, config)]


def _unfit(session: Session) -> Iterator[Finding]:
    for each in session.subscriptions:
        try:
            check_callback(each.callback, each.event)
        except ConfigError as error:
            yield error.as_finding()


def _forgotten(session: Session, config: Any) -> Iterator[Finding]:
    heard = {each.event for each in session.subscriptions}
    names = dict.fromkeys(event.name for events in (RobotRunnerEvents, RunnerEvents) for event in events)
    for name in names:
        method = name.lower()
        if own_event(name) not in heard and method in vars(type(config)):
            yield Finding.warning(
                f"{session.path.name}, {type(config).__name__}.{method}",
                f"nothing subscribes it to {name}, so it is never called, as in the earlier tool",
                "Subscribe it in __init__, or remove it.",
            )
