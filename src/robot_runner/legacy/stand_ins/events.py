"""The config classes, contexts, events and subscriptions of the earlier tools."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, MutableMapping
from enum import Enum
from pathlib import Path
from types import CodeType
from typing import Any, ClassVar

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.errors import ConfigError, did_you_mean
from robot_runner.core.events.manager import RobotRunnerEvents as OwnEvents
from robot_runner.legacy.session import EarlierSubscription, Session, current_session

#: The events of Robot Runner; DURING_RUN and SIGNAL_SEMI_CONTINUE are from its first version.
RobotRunnerEvents = Enum(
    "RobotRunnerEvents",
    "BEFORE_EXPERIMENT BEFORE_RUN START_RUN START_MEASUREMENT LAUNCH_MISSION DURING_RUN CONTINUE SIGNAL_SEMI_CONTINUE "
    "STOP_MEASUREMENT STOP_RUN POPULATE_RUN_DATA AFTER_EXPERIMENT VALIDATE_EXPERIMENT",
)
RunnerEvents = Enum(
    "RunnerEvents",
    "BEFORE_EXPERIMENT BEFORE_RUN START_RUN START_MEASUREMENT INTERACT CONTINUE STOP_MEASUREMENT STOP_RUN "
    "POPULATE_RUN_DATA AFTER_EXPERIMENT VALIDATE_EXPERIMENT",
)
#: An additional event of a fork, at which a config checked its requirements.
VALIDATE = "VALIDATE_EXPERIMENT"
_OTHER_NAMES = {
    "DURING_RUN": OwnEvents.LAUNCH_MISSION,
    "INTERACT": OwnEvents.LAUNCH_MISSION,
    "SIGNAL_SEMI_CONTINUE": OwnEvents.CONTINUE,
    VALIDATE: OwnEvents.BEFORE_EXPERIMENT,
}


def own_event(name: str) -> OwnEvents:
    """Return our event for the name of an event of the earlier tools.

    Example:
        >>> own_event("INTERACT").name
        'LAUNCH_MISSION'
    """
    return _OTHER_NAMES.get(name) or OwnEvents[name]


class EventSubscriptionController:
    """The subscriptions of a config. The earlier tools kept the last callback of each event; a fork took lists."""

    @staticmethod
    def subscribe_to_single_event(event: Any, callback_method: Callable[..., Any]) -> None:
        """Subscribe a callback to an event.

        Raises:
            ConfigError: there is no such event, or the callback cannot be called.
        """
        _subscribe(event, callback_method, _calling_code())

    @staticmethod
    def subscribe_to_multiple_events(subscriptions: Iterable[tuple[Any, Any]]) -> None:
        """Subscribe several callbacks, each given as `(event, callback)`.

        Raises:
            ConfigError: an element is not such a pair, there is no such event, or a callback cannot be called.
        """
        place = _calling_code()
        if not isinstance(subscriptions, Iterable):
            raise _no_pair(subscriptions)
        for subscription in subscriptions:
            if not isinstance(subscription, tuple | list) or len(subscription) != 2:  # noqa: PLR2004 - a pair
                raise _no_pair(subscription)
            event, callback = subscription
            _subscribe(event, callback, place)

    #: The method of a public fork, with elements `(event, [callback, ...])`.
    subscribe_to_multiple_events_multiple_callbacks = subscribe_to_multiple_events

    @staticmethod
    def raise_event(event: Any, context: Any = None) -> Any:
        """Call the callbacks of an event, as the tool itself did; returns the value of the last one."""
        returned = None
        for each in _subscribed(current_session(), own_event(event.name)):
            returned = each.callback() if context is None else each.callback(context)
        return returned

    @staticmethod
    def get_event_callback(event: Any) -> Callable[..., Any] | None:
        """Return the callback of an event, or None."""
        heard = _subscribed(current_session(), own_event(event.name))
        return heard[-1].callback if heard else None


def _subscribe(event: Any, callback: Any, place: CodeType) -> None:
    """Subscribe a callback, or a list of callbacks, which are called one after another."""
    session = current_session()
    events = RunnerEvents if session.recognised.dialect.class_name == "RunnerConfig" else RobotRunnerEvents
    if not isinstance(event, RobotRunnerEvents | RunnerEvents):
        name = getattr(event, "name", None) or str(event)
        fix = did_you_mean(name, events.__members__)
        raise ConfigError(f"{event!r} is not an event", where=events.__name__, fix=fix)
    callbacks = list(callback) if isinstance(callback, list | tuple) else [callback]
    for each in callbacks:
        if not callable(each):
            problem = f"the callback of {event.name} is {each!r}, which cannot be called"
            fix = f"Give a method such as self.{event.name.lower()}."
            raise ConfigError(problem, where="EventSubscriptionController", fix=fix)
    if event.name == VALIDATE:
        problem = "this event is a fork's own: its callback is called at before_experiment"
        session.warn(VALIDATE, problem, "Call it in before_experiment, to be sure of the order.")
    _make_room(session, event, callbacks, place)
    heard = [each.callback for each in _subscribed(session, own_event(event.name))]
    subscribed = [
        EarlierSubscription(own_event(event.name), each, place, is_of_fork=event.name == VALIDATE)
        for each in dict.fromkeys(callbacks)
        if each not in heard
    ]
    # The fork validated first.
    at = 0 if event.name == VALIDATE else len(session.subscriptions)
    session.subscriptions[at:at] = subscribed


def _make_room(session: Session, event: Any, callbacks: list[Any], place: CodeType) -> None:
    """Remove the base config's callbacks that a derived config replaces; warn if both are called now."""
    for each in _subscribed(session, own_event(event.name)):
        if each.callback in callbacks or each.is_of_fork != (event.name == VALIDATE):
            continue
        if each.place is not place:
            session.subscriptions.remove(each)
        else:
            problem = (
                f"two callbacks subscribe to {event.name}: {_named(each.callback)} and "
                f"{', '.join(map(_named, callbacks))}; the earlier tools called the last alone, now both are called"
            )
            session.warn("EventSubscriptionController", problem, "Subscribe one of them only, if that was not meant.")


def _subscribed(session: Session, event: OwnEvents) -> list[EarlierSubscription]:
    return [each for each in session.subscriptions if each.event is event]


def _calling_code() -> CodeType:
    return sys._getframe(2).f_code  # noqa: SLF001 - the way to tell whose __init__ it is


def _named(callback: Any) -> str:
    return getattr(callback, "__name__", repr(callback))


def _no_pair(subscription: Any) -> ConfigError:
    problem = f"{subscription!r} is not a pair of an event and a callback"
    fix = "Write a list of pairs such as (RunnerEvents.START_RUN, self.start_run)."
    return ConfigError(problem, where="EventSubscriptionController.subscribe_to_multiple_events", fix=fix)


#: `execute_run` is the later name of `run_variation`.
CONTEXT_ATTRIBUTES = ("run_variation", "execute_run", "run_nr", "run_dir")


class EarlierContext:
    """The context of a run, the same object for all of its callbacks.

    Attributes:
        run_variation: the row of the run table with `__run_id`, `__done`, treatments and measures; callbacks may write
            to it. `execute_run` is the same.
        run_nr: the number of the run in the table, from 1.
        run_dir: the run's folder.

    Example:
        >>> EarlierContext({"Task": "Video"}, 1, Path("run_0")).execute_run["Task"]
        'Video'
    """

    def __init__(self, run_variation: MutableMapping[str, Any], run_nr: int, run_dir: Path) -> None:
        self.run_variation = run_variation
        self.run_nr = run_nr
        self.run_dir = Path(run_dir)

    @property
    def execute_run(self) -> MutableMapping[str, Any]:
        """The row of the run table."""
        return self.run_variation

    @execute_run.setter
    def execute_run(self, row: MutableMapping[str, Any]) -> None:
        self.run_variation = row

    #: The same, under the name in our own messages.
    combination = execute_run

    def __getattr__(self, name: str) -> Any:
        hint = did_you_mean(name, CONTEXT_ATTRIBUTES, f"It has {', '.join(CONTEXT_ATTRIBUTES)}.")
        raise AttributeError(f"the context has no {name!r}. {hint}", name=name, obj=self)


class _BesideConfig:
    """A folder in that of the config file, or that itself: Experiment Runner's default for results."""

    def __init__(self, name: str = "") -> None:
        self._name = name

    def __get__(self, config: object, owner: type) -> Path:
        return current_session().path.parent / self._name


def do_nothing(config: object, context: Any = None) -> None:
    """Do nothing; the default of callbacks that a derived config may leave out."""


class _Config:
    name: str
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 1000
    run_table_model: Any = None
    experiment_path: Path | None = None
    _events: ClassVar[Any]

    before_experiment = before_run = start_run = start_measurement = do_nothing
    stop_measurement = stop_run = populate_run_data = after_experiment = do_nothing

    def __init__(self) -> None:
        names = [(event, event.name.lower()) for event in self._events if "CONTINUE" not in event.name]
        callbacks = [(event, getattr(self, name)) for event, name in names if hasattr(self, name)]
        EventSubscriptionController.subscribe_to_multiple_events(callbacks)


class RobotRunnerConfig(_Config):
    """The config class of Robot Runner: it subscribes every callback under its own name."""

    name: str = "new_robot_runner_experiment"
    required_ros_version: Any = 2
    required_ros_distro: Any = "foxy"
    results_output_path: Path = Path("~/Documents/experiments")
    _events = RobotRunnerEvents
    launch_mission = do_nothing


class RunnerConfig(_Config):
    """The config class of Experiment Runner: it subscribes every callback under its own name."""

    ROOT_DIR = _BesideConfig()
    name: str = "new_runner_experiment"
    results_output_path: Any = _BesideConfig("experiments")
    _events = RunnerEvents
    interact = do_nothing
