"""The events of the earlier tools, and how a config subscribed to them."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from enum import Enum, auto
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import ConfigError, did_you_mean
from robot_runner.core.events.manager import RobotRunnerEvents as OwnEvents
from robot_runner.legacy.session import EarlierSubscription, current_session

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import CodeType

    from robot_runner.legacy.session import Session

__all__ = ["EventSubscriptionController", "RobotRunnerEvents", "RunnerEvents", "own_event"]


class RobotRunnerEvents(Enum):
    """The events of Robot Runner; `DURING_RUN` and `SIGNAL_SEMI_CONTINUE` are those of its first months."""

    BEFORE_EXPERIMENT = auto()
    BEFORE_RUN = auto()
    START_RUN = auto()
    START_MEASUREMENT = auto()
    LAUNCH_MISSION = auto()
    DURING_RUN = auto()
    CONTINUE = auto()
    SIGNAL_SEMI_CONTINUE = auto()
    STOP_MEASUREMENT = auto()
    STOP_RUN = auto()
    POPULATE_RUN_DATA = auto()
    AFTER_EXPERIMENT = auto()


class RunnerEvents(Enum):
    """The events of Experiment Runner."""

    BEFORE_EXPERIMENT = auto()
    BEFORE_RUN = auto()
    START_RUN = auto()
    START_MEASUREMENT = auto()
    INTERACT = auto()
    CONTINUE = auto()
    STOP_MEASUREMENT = auto()
    STOP_RUN = auto()
    POPULATE_RUN_DATA = auto()
    AFTER_EXPERIMENT = auto()


_OTHER_NAMES = {
    "DURING_RUN": OwnEvents.LAUNCH_MISSION,
    "INTERACT": OwnEvents.LAUNCH_MISSION,
    "SIGNAL_SEMI_CONTINUE": OwnEvents.CONTINUE,
}


def own_event(name: str) -> OwnEvents:
    """Return our event for the name of one of the earlier tools.

    Example:
        >>> own_event("INTERACT").name
        'LAUNCH_MISSION'
    """
    return _OTHER_NAMES.get(name) or OwnEvents[name]


class EventSubscriptionController:
    """Where a config subscribes; the earlier tools kept one callback an event, the last; a fork took lists of them."""

    @staticmethod
    def subscribe_to_single_event(event: Any, callback_method: Callable[..., Any]) -> None:
        """Have a callback called at an event.

        Raises:
            ConfigError: there is no such event, or the callback cannot be called.
        """
        _subscribe(event, callback_method, _calling_code())

    @staticmethod
    def subscribe_to_multiple_events(subscriptions: Iterable[tuple[Any, Any]]) -> None:
        """Subscribe several callbacks, each given as `(event, callback)`.

        Raises:
            ConfigError: an element is no such pair, there is no such event, or a callback cannot be called.
        """
        _subscribe_all(subscriptions, _calling_code())

    @staticmethod
    def subscribe_to_multiple_events_multiple_callbacks(subscriptions: Iterable[tuple[Any, Any]]) -> None:
        """Subscribe several callbacks, given as `(event, [callback, ...])`: the spelling of a public fork.

        Raises:
            ConfigError: as above.
        """
        _subscribe_all(subscriptions, _calling_code())

    @staticmethod
    def raise_event(event: Any, context: Any = None) -> Any:
        """Call whoever hears an event, as the tool itself did; returns what the last one returned."""
        returned = None
        for each in _heard(current_session(), own_event(event.name)):
            returned = each.callback() if context is None else each.callback(context)
        return returned

    @staticmethod
    def get_event_callback(event: Any) -> Callable[..., Any] | None:
        """Return the callback of an event, or None."""
        heard = _heard(current_session(), own_event(event.name))
        return heard[-1].callback if heard else None


def _subscribe_all(subscriptions: Any, place: CodeType) -> None:
    if not isinstance(subscriptions, Iterable):
        raise _no_pair(subscriptions)
    for subscription in subscriptions:
        if not isinstance(subscription, tuple | list) or len(subscription) != 2:  # noqa: PLR2004 - a pair
            raise _no_pair(subscription)
        event, callback = subscription
        _subscribe(event, callback, place)


def _subscribe(event: Any, callback: Any, place: CodeType) -> None:
    """Subscribe a callback, or a list of them: those were meant to be called one after another."""
    session = current_session()
    events = RunnerEvents if session.recognised.dialect.class_name == "RunnerConfig" else RobotRunnerEvents
    if not isinstance(event, RobotRunnerEvents | RunnerEvents):
        name = getattr(event, "name", None) or str(event)
        raise ConfigError(f"{event!r} is no event", where=events.__name__, fix=did_you_mean(name, events.__members__))
    callbacks = list(callback) if isinstance(callback, list | tuple) else [callback]
    for each in callbacks:
        if not callable(each):
            raise ConfigError(
                f"the callback of {event.name} is {each!r}, which cannot be called",
                where="EventSubscriptionController",
                fix=f"Give a method such as self.{event.name.lower()}.",
            )
    _make_room(session, event, callbacks, place)
    heard = [each.callback for each in _heard(session, own_event(event.name))]
    session.subscriptions += [
        EarlierSubscription(own_event(event.name), each, place)
        for each in dict.fromkeys(callbacks)
        if each not in heard
    ]


def _make_room(session: Session, event: Any, callbacks: list[Any], place: CodeType) -> None:
    """Remove what a config takes over from the one that it derives from; say where both are called now."""
    for each in _heard(session, own_event(event.name)):
        if each.callback in callbacks:
            continue
        if each.place is not place:
            session.subscriptions.remove(each)
        else:
            session.warn(
                "EventSubscriptionController",
                f"two callbacks hear {event.name}: {_named(each.callback)} and {', '.join(map(_named, callbacks))}; "
                "the earlier tools called the last alone, and now both are called",
                "Subscribe one of them only, if that was not meant.",
            )


def _heard(session: Session, event: OwnEvents) -> list[EarlierSubscription]:
    return [each for each in session.subscriptions if each.event is event]


def _calling_code() -> CodeType:
    """Return the code that called the controller."""
    return sys._getframe(2).f_code  # noqa: SLF001 - the way to tell whose __init__ it is


def _named(callback: Any) -> str:
    return getattr(callback, "__name__", repr(callback))


def _no_pair(subscription: Any) -> ConfigError:
    return ConfigError(
        f"{subscription!r} is no pair of an event and a callback",
        where="EventSubscriptionController.subscribe_to_multiple_events",
        fix="Write a list of pairs such as (RunnerEvents.START_RUN, self.start_run).",
    )
