"""The event manager: the broker between publishers and subscribers of events (paper, II.C)."""

from __future__ import annotations

import inspect
import os
import sys
import traceback
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from enum import Enum, IntEnum
from types import AsyncGeneratorType, CoroutineType, GeneratorType
from typing import Any, NoReturn

from robot_runner.core.errors import ConfigError, did_you_mean
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.treatments import parameters_guarded

# The events of an experiment and their order (paper, Fig. 2): the one table that says which process each is emitted in.


class RobotRunnerEvents(Enum):
    """The key moments of an experiment, in the order in which they come.

    A method of a config or a plugin that is named like an event is its callback (`callback_name`).
    """

    BEFORE_EXPERIMENT = "before_experiment"
    BEFORE_RUN = "before_run"
    START_RUN = "start_run"
    START_MEASUREMENT = "start_measurement"
    LAUNCH_MISSION = "launch_mission"
    STOP_MEASUREMENT = "stop_measurement"
    STOP_RUN = "stop_run"
    POPULATE_RUN_DATA = "populate_run_data"
    CONTINUE = "continue"
    AFTER_EXPERIMENT = "after_experiment"

    #: By identity, which is faster: that of `Enum` hashes the name, in Python.
    __hash__ = object.__hash__

    @property
    def callback_name(self) -> str:
        """The name of its method; `continue` is a keyword of Python, so that its method is `continue_experiment`."""
        return "continue_experiment" if self is RobotRunnerEvents.CONTINUE else self.value

    @property
    def is_closing(self) -> bool:
        """Whether it closes what another event opened, and so reaches its subscribers in reverse order."""
        return self in _CLOSING

    @property
    def belongs_to_run(self) -> bool:
        """Whether it is emitted for each run (and has a time-stamp column in the run table)."""
        return self not in {RobotRunnerEvents.BEFORE_EXPERIMENT, RobotRunnerEvents.AFTER_EXPERIMENT}


#: Emitted in the run's own process, in this order.
RUN_EVENTS = (
    RobotRunnerEvents.START_RUN,
    RobotRunnerEvents.START_MEASUREMENT,
    RobotRunnerEvents.LAUNCH_MISSION,
    RobotRunnerEvents.STOP_MEASUREMENT,
    RobotRunnerEvents.STOP_RUN,
    RobotRunnerEvents.POPULATE_RUN_DATA,
)

#: Emitted in the orchestrating process.
ORCHESTRATED_EVENTS = (
    RobotRunnerEvents.BEFORE_EXPERIMENT,
    RobotRunnerEvents.BEFORE_RUN,
    RobotRunnerEvents.CONTINUE,
    RobotRunnerEvents.AFTER_EXPERIMENT,
)

#: Opening events, each with the event that closes it, whatever fails in between.
CLOSED_BY = {
    RobotRunnerEvents.START_RUN: RobotRunnerEvents.STOP_RUN,
    RobotRunnerEvents.START_MEASUREMENT: RobotRunnerEvents.STOP_MEASUREMENT,
}

_CLOSING = frozenset(CLOSED_BY.values())

#: Events by the name of their method.
EVENTS_BY_CALLBACK = {event.callback_name: event for event in RobotRunnerEvents}


# Subscriptions: a callback is checked against its event when it is subscribed, not in the middle of a run.

Callback = Callable[..., Any]


class OwnerKind(IntEnum):
    """The kinds of subscribers, in the order in which they are called; closing events go in reverse."""

    SYSTEM = 0
    PROFILER = 1
    CONFIG = 2


@dataclass(frozen=True, slots=True)
class Subscriber:
    """One callback of one event.

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
        """Call the callback, with the context if it takes one; a config may not set parameters of plugins meanwhile.

        Raises:
            ConfigError: the call has executed nothing, see `check_executed`.
        """
        is_config = self.kind is OwnerKind.CONFIG
        with parameters_guarded(getattr(context, "combination", ())) if is_config else nullcontext():
            returned = self.callback(context) if self.takes_context else self.callback()
        check_executed(returned, self.event.callback_name, self.callback, self.owner)
        return returned


#: An event and its callback, as a config subscribes it through the `EventSubscriptionController`.
Subscription = tuple[RobotRunnerEvents, Callback]

_requested: ContextVar[list[Subscription] | None] = ContextVar("requested", default=None)


@contextmanager
def recorded_subscriptions() -> Iterator[list[Subscription]]:
    """Record what is subscribed through the `EventSubscriptionController` while a config is loaded."""
    requests: list[Subscription] = []
    token = _requested.set(requests)
    try:
        yield requests
    finally:
        _requested.reset(token)


class EventSubscriptionController:
    """The paper's way to subscribe (Listing 1), from a config's `__init__`.

    A method that is named like an event is subscribed already; subscribing it as well changes nothing. An event may
    have several callbacks: they are called in the order in which they subscribed.
    """

    @staticmethod
    def subscribe_to_single_event(event: RobotRunnerEvents, callback: Callback) -> None:
        """Subscribe `callback` to `event`.

        Raises:
            ConfigError: `event` is not one, `callback` cannot be called with a context, or no config is being loaded.
        """
        requests = _requested.get()
        if requests is None:
            problem = "events can be subscribed to only while Robot Runner loads the config"
            fix = "Subscribe in the config's __init__ and start it with `robot-runner run`."
            raise ConfigError(problem, where="EventSubscriptionController", fix=fix)
        checked_subscriber(event, callback, owner="config", kind=OwnerKind.CONFIG)
        requests.append((event, callback))

    @classmethod
    def subscribe_to_multiple_events(cls, subscriptions: Iterable[Subscription]) -> None:
        """Subscribe several callbacks, each given as `(event, callback)`.

        Raises:
            ConfigError: as `subscribe_to_single_event`, or an element is no such pair.
        """
        for subscription in subscriptions:
            if not isinstance(subscription, tuple) or len(subscription) != 2:  # noqa: PLR2004 - a pair
                problem = f"{subscription!r} is not a pair of an event and a callback"
                fix = "Write (RobotRunnerEvents.LAUNCH_MISSION, self.launch_mission)."
                raise ConfigError(problem, where="EventSubscriptionController.subscribe_to_multiple_events", fix=fix)
            cls.subscribe_to_single_event(*subscription)


def checked_subscriber(event: object, callback: object, *, owner: str, kind: OwnerKind) -> Subscriber:
    """Return a subscriber after checking event and callback.

    Raises:
        ConfigError: there is no such event, or the callback takes neither no argument nor a context, or calling it
            would execute nothing.
    """
    if not isinstance(event, RobotRunnerEvents):
        fix = did_you_mean(str(event), [known.name for known in RobotRunnerEvents])
        raise ConfigError(f"{event!r} is not an event", where=owner, fix=fix)
    if not callable(callback):
        fix = f"Give a method such as self.{event.callback_name}."
        raise ConfigError(f"the callback of {event.name} is {callback!r}, which cannot be called", where=owner, fix=fix)
    takes_context = takes_a_context(event.callback_name, callback, owner)
    return Subscriber(event, owner, kind, callback, takes_context)


def _is_async(callback: Callback) -> bool:
    """Return whether calling it only makes a coroutine or an asynchronous generator."""
    return inspect.iscoroutinefunction(callback) or inspect.isasyncgenfunction(callback)


def takes_a_context(name: str, callback: Callback, owner: str) -> bool:
    """Return whether a callback takes a context; False if it takes no argument.

    Raises:
        ConfigError: it takes neither, or calling it would execute nothing.
    """
    if _is_async(callback) or inspect.isgeneratorfunction(callback):
        what, fix = (
            ("async", "Write a plain def, and await in it by asyncio.run(...).")
            if _is_async(callback)
            else ("a generator, as it has a yield", "Leave yield out, or have the callback loop over what yields.")
        )
        problem = f"{name} is {what}: its body would never be executed"
        raise ConfigError(problem, where=f"{owner}, {place_of(callback)}", fix=fix)
    code = getattr(getattr(callback, "__func__", None), "__code__", None)  # of a method
    first = None if code is None or code.co_flags & inspect.CO_VARARGS else code.co_varnames[: code.co_argcount][:1]
    if first in {("context",), ()}:
        problem = f"{name} has no self" + (", so that what it calls context is not the context" if first else "")
        raise ConfigError(problem, where=f"{owner}, {place_of(callback)}", fix=f"Write def {name}(self, context).")
    try:
        signature = signature_of(callback)
    except (TypeError, ValueError):  # written in C, without a signature
        return True
    for arguments in ((object(),), ()):
        try:
            signature.bind(*arguments)
        except TypeError:
            continue
        return bool(arguments)
    raise no_context(name, callback, owner)


def check_executed(returned: object, name: str, callback: Callback, owner: str) -> None:
    """Check that calling a callback has executed it: a decorator may have hidden from `takes_a_context` that it cannot.

    Raises:
        ConfigError: it is async, or a generator.
    """
    if isinstance(returned, CoroutineType | GeneratorType | AsyncGeneratorType):
        getattr(returned, "close", lambda: None)()  # or Python would warn that it was never awaited
        problem = f"{name} returned a {type(returned).__name__}: its body was never executed"
        fix = "Write a plain def: have what is async executed by asyncio.run(...), and leave yield out."
        raise ConfigError(problem, where=f"{owner}, {place_of(callback)}", fix=fix)


def no_context(name: str, callback: Callback, owner: str) -> ConfigError:
    """Return the error for a callback that cannot be called with a context."""
    problem = f"{name}{signature_of(callback)} cannot be called with a context"
    return ConfigError(problem, where=f"{owner}, {place_of(callback)}", fix=f"Write def {name}(self, context).")


def place_of(callback: Callback) -> str:
    """Return the file and line where a callback is defined, as far as Python knows."""
    code = getattr(inspect.unwrap(callback), "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else repr(callback)


def methods_of(subject: object) -> Iterator[tuple[RobotRunnerEvents, Callback]]:
    """Yield each event and the method of `subject` named like it, in the order of the events; None counts as none."""
    for name, event in EVENTS_BY_CALLBACK.items():
        method = getattr(subject, name, None)
        if method is not None:
            yield event, method


@dataclass(frozen=True, slots=True)
class CallbackFailure:
    """A callback that raised."""

    event: RobotRunnerEvents
    owner: str
    error: BaseException


@dataclass(frozen=True, slots=True)
class Emission:
    """The result of emitting one event.

    Attributes:
        returned: what each callback returned, with its owner, in the order of the calls.
        reached: the owners whose callback was called, the one that failed included.
        failures: the callbacks that raised: one at most, unless the event is a closing one.
    """

    returned: tuple[tuple[str, Any], ...]
    reached: tuple[str, ...]
    failures: tuple[CallbackFailure, ...]


class EventManager:
    """Knows the subscribers of each event and calls them: systems, profilers, config; closing events in reverse.

    Example:
        >>> from robot_runner.core.events.manager import RobotRunnerEvents
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
        """Subscribe `callback` to `event`; subscribing it twice changes nothing.

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

    def subscribers(self, *events: RobotRunnerEvents) -> list[Subscriber]:
        """Return the subscribers of each event, in the order in which they are called."""
        called: list[Subscriber] = []
        for event in events:
            known = self._subscribers.get(event, [])
            called += reversed(known) if event.is_closing else known
        return called

    def emit(
        self, event: RobotRunnerEvents, context_for: Callable[[str], object], *, but_not: Collection[str] = ()
    ) -> Emission:
        """Call the subscribers of `event`, except those of the owners in `but_not`.

        The first callback that raises ends the emission, except for a closing event: then all are called.
        """
        returned: list[tuple[str, Any]] = []
        reached: list[str] = []
        failures: list[CallbackFailure] = []
        process = os.getpid()
        for subscriber in self.subscribers(event):
            owner = subscriber.owner
            if owner in but_not:
                continue
            reached.append(owner)
            try:
                returned.append((owner, subscriber.call(context_for(owner))))
            except BaseException as error:  # noqa: BLE001 - also sys.exit and Ctrl-C must not skip the closing
                failures.append(CallbackFailure(event, owner, error))
            if os.getpid() != process:
                _leave_forked(failures)
            if failures and not event.is_closing:
                break
        return Emission(tuple(returned), tuple(reached), tuple(failures))


def _leave_forked(failures: Sequence[CallbackFailure]) -> NoReturn:
    """Exit from a process that a callback has forked and that has returned: it must not go on as a second run.

    That happens where `os.execvp` finds no program after an `os.fork`.
    """
    try:
        for failure in failures:
            traceback.print_exception(failure.error)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:  # also where the disk is full, or a stream is closed or None
        os._exit(1 if failures else 0)
