"""Who hears what: a callback is checked against its event when it is subscribed, not in the middle of a run."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from robot_runner.errors import ConfigError, did_you_mean
from robot_runner.events.event import EVENTS_BY_CALLBACK, RobotRunnerEvents

__all__ = [
    "Callback",
    "EventSubscriptionController",
    "OwnerKind",
    "RequestedSubscription",
    "Subscriber",
    "checked_subscriber",
    "place_of",
    "recorded_subscriptions",
]

Callback = Callable[..., Any]


class OwnerKind(IntEnum):
    """Who hears an event, in the order in which they hear it; closing events go the other way."""

    SYSTEM = 0
    PROFILER = 1
    CONFIG = 2


@dataclass(frozen=True, slots=True)
class Subscriber:
    """One callback that hears one event.

    Attributes:
        owner: the plugin's name, or `config`.
        takes_context: whether the callback has a parameter for the context; it may leave it out.
    """

    event: RobotRunnerEvents
    owner: str
    kind: OwnerKind
    callback: Callback
    takes_context: bool

    def call(self, context: object) -> Any:
        """Call the callback, with the context if it takes one."""
        return self.callback(context) if self.takes_context else self.callback()


@dataclass(frozen=True, slots=True)
class RequestedSubscription:
    """A subscription as a config asked for it through the `EventSubscriptionController`."""

    event: RobotRunnerEvents
    callback: Callback


_requested: ContextVar[list[RequestedSubscription] | None] = ContextVar("requested", default=None)


@contextmanager
def recorded_subscriptions() -> Iterator[list[RequestedSubscription]]:
    """Record what is subscribed through the `EventSubscriptionController` while a config is loaded."""
    requests: list[RequestedSubscription] = []
    token = _requested.set(requests)
    try:
        yield requests
    finally:
        _requested.reset(token)


class EventSubscriptionController:
    """The paper's way to subscribe (Listing 1), from a config's `__init__`.

    A method that is named like an event hears it without being subscribed; subscribing it as well changes
    nothing. Several callbacks may hear one event: they are called in the order in which they subscribed.
    """

    @staticmethod
    def subscribe_to_single_event(event: RobotRunnerEvents, callback: Callback) -> None:
        """Have `callback` called at `event`.

        Raises:
            ConfigError: `event` is no event, `callback` cannot be called with a context, or no config is being loaded.
        """
        requests = _requested.get()
        if requests is None:
            raise ConfigError(
                "events can be subscribed to only while Robot Runner loads the config",
                where="EventSubscriptionController",
                fix="Subscribe in the config's __init__ and start it with `robot-runner run`.",
            )
        checked_subscriber(event, callback, owner="config", kind=OwnerKind.CONFIG)
        requests.append(RequestedSubscription(event, callback))

    @classmethod
    def subscribe_to_multiple_events(cls, subscriptions: Iterable[tuple[RobotRunnerEvents, Callback]]) -> None:
        """Subscribe several callbacks, each given as `(event, callback)`.

        Raises:
            ConfigError: as `subscribe_to_single_event`, or an element is no such pair.
        """
        for subscription in subscriptions:
            if not isinstance(subscription, tuple) or len(subscription) != 2:  # noqa: PLR2004 - a pair
                raise ConfigError(
                    f"{subscription!r} is no pair of an event and a callback",
                    where="EventSubscriptionController.subscribe_to_multiple_events",
                    fix="Write (RobotRunnerEvents.LAUNCH_MISSION, self.launch_mission).",
                )
            cls.subscribe_to_single_event(*subscription)


def checked_subscriber(event: object, callback: object, *, owner: str, kind: OwnerKind) -> Subscriber:
    """Return the subscriber after a look at the event and at the callback's signature.

    Raises:
        ConfigError: there is no such event, or the callback takes neither nothing nor a context.
    """
    if not isinstance(event, RobotRunnerEvents):
        raise ConfigError(
            f"{event!r} is no event",
            where=owner,
            fix=did_you_mean(str(event), [known.name for known in RobotRunnerEvents]),
        )
    if not callable(callback):
        raise ConfigError(
            f"the callback of {event.name} is {callback!r}, which cannot be called",
            where=owner,
            fix=f"Give a method such as self.{event.callback_name}.",
        )
    return Subscriber(event, owner, kind, callback, takes_context=_takes_context(event, callback, owner))


def _takes_context(event: RobotRunnerEvents, callback: Callback, owner: str) -> bool:
    try:
        signature = inspect.signature(callback)
    except (TypeError, ValueError):  # written in C, without a signature: the context is what an event gives
        return True
    for arguments in ((object(),), ()):
        try:
            signature.bind(*arguments)
        except TypeError:
            continue
        return bool(arguments)
    raise ConfigError(
        f"{event.callback_name}{signature} cannot be called with a context",
        where=f"{owner}, {place_of(callback)}",
        fix=f"Write def {event.callback_name}(self, context).",
    )


def place_of(callback: Callback) -> str:
    """Return the file and line where a callback is defined, as far as Python knows."""
    code = getattr(inspect.unwrap(callback), "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else repr(callback)


def methods_of(subject: object) -> Iterator[tuple[RobotRunnerEvents, Callback]]:
    """Yield the methods of `subject` that are named like an event, in the order of the events."""
    for name, event in EVENTS_BY_CALLBACK.items():
        method = getattr(subject, name, None)
        if callable(method):
            yield event, method
