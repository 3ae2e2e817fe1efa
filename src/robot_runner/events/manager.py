"""The event manager: the broker between those who publish and those who hear (paper, II.C)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.events.subscription import Callback, OwnerKind, Subscriber, checked_subscriber, methods_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from robot_runner.events.event import RobotRunnerEvents

__all__ = ["CallbackFailure", "Emission", "EventManager"]


@dataclass(frozen=True, slots=True)
class CallbackFailure:
    """A callback that raised."""

    event: RobotRunnerEvents
    owner: str
    error: BaseException


@dataclass(frozen=True, slots=True)
class Emission:
    """What came of emitting one event.

    Attributes:
        returned: what each callback returned, with its owner, in the order of the calls.
        reached: the owners whose callback was called, the one that failed included.
        failures: the callbacks that raised: one at most, unless the event is a closing one.
    """

    returned: tuple[tuple[str, Any], ...]
    reached: tuple[str, ...]
    failures: tuple[CallbackFailure, ...]


class EventManager:
    """Knows who hears each event and calls them in order: systems, profilers, config; closing events in reverse.

    Example:
        >>> from robot_runner.events.event import RobotRunnerEvents
        >>> manager = EventManager()
        >>> heard = []
        >>> manager.subscribe(RobotRunnerEvents.START_RUN, heard.append, owner="config", kind=OwnerKind.CONFIG)
        >>> manager.emit(RobotRunnerEvents.START_RUN, lambda owner: f"context of {owner}").reached
        ('config',)
        >>> heard
        ['context of config']
    """

    def __init__(self) -> None:
        self._subscribers: defaultdict[RobotRunnerEvents, list[Subscriber]] = defaultdict(list)

    def subscribe(self, event: RobotRunnerEvents, callback: Callback, *, owner: str, kind: OwnerKind) -> None:
        """Have `callback` called at `event`; the same callback twice is heard once.

        Raises:
            ConfigError: the callback's signature does not fit.
        """
        heard = self._subscribers[event]
        if any(subscriber.owner == owner and subscriber.callback == callback for subscriber in heard):
            return
        subscriber = checked_subscriber(event, callback, owner=owner, kind=kind)
        heard.append(subscriber)
        heard.sort(key=lambda each: each.kind)  # stable: within a kind, the order of subscribing

    def subscribe_methods(self, subject: object, *, owner: str, kind: OwnerKind) -> None:
        """Subscribe every method of `subject` that is named like an event.

        Raises:
            ConfigError: the signature of one of them does not fit.
        """
        for event, method in methods_of(subject):
            self.subscribe(event, method, owner=owner, kind=kind)

    def subscribers(self, event: RobotRunnerEvents) -> list[Subscriber]:
        """Return who hears `event`, in the order in which they are called."""
        heard = self._subscribers.get(event, [])
        return heard[::-1] if event.is_closing else heard

    def emit(
        self,
        event: RobotRunnerEvents,
        context_for: Callable[[str], object],
        *,
        but_not: Collection[str] = (),
    ) -> Emission:
        """Call whoever hears `event`, except for what belongs to the owners in `but_not`.

        The first callback that raises ends the emission, except for a closing event: then all are called.
        """
        returned: list[tuple[str, Any]] = []
        reached: list[str] = []
        failures: list[CallbackFailure] = []
        for subscriber in self.subscribers(event):
            owner = subscriber.owner
            if owner in but_not:
                continue
            reached.append(owner)
            try:
                returned.append((owner, subscriber.call(context_for(owner))))
            except BaseException as error:  # noqa: BLE001 - also sys.exit and Ctrl-C must not skip the closing
                failures.append(CallbackFailure(event, owner, error))
                if not event.is_closing:
                    break
        return Emission(tuple(returned), tuple(reached), tuple(failures))
