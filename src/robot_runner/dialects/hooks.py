"""Calling a callback of an earlier tool: with the context or without, as it was written."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from robot_runner.errors import ConfigError
from robot_runner.events.event import RobotRunnerEvents
from robot_runner.events.subscription import place_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.dialects.stand_ins.contexts import EarlierContext

__all__ = ["call", "check_callback"]

#: Events whose callbacks the earlier tools called without a context.
_WITHOUT_CONTEXT = frozenset(
    {
        RobotRunnerEvents.BEFORE_EXPERIMENT,
        RobotRunnerEvents.BEFORE_RUN,
        RobotRunnerEvents.CONTINUE,
        RobotRunnerEvents.AFTER_EXPERIMENT,
    }
)
_ROW_NAMES = frozenset({"row", "run", "run_variation", "variation"})


def call(callback: Callable[..., Any], event: RobotRunnerEvents, context: EarlierContext | None) -> Any:
    """Call a callback with as much as it takes: nothing, the context, or (as in some forks) the row of the table."""
    for arguments in _offers(callback, event, context):
        if _fits(callback, arguments):
            return callback(*arguments)
    raise _unfit(callback, event)


def check_callback(callback: Callable[..., Any], event: RobotRunnerEvents) -> None:
    """See that a callback can be called at an event.

    Raises:
        ConfigError: it can be called neither without arguments nor with a context.
    """
    most = 2 if event is RobotRunnerEvents.LAUNCH_MISSION else 1
    if not any(_fits(callback, (object(),) * count) for count in range(most + 1)):
        raise _unfit(callback, event)


def _offers(
    callback: Callable[..., Any], event: RobotRunnerEvents, context: EarlierContext | None
) -> Sequence[tuple[Any, ...]]:
    given = context.run_variation if context is not None and _wants_row(callback, event) else context
    if event is RobotRunnerEvents.LAUNCH_MISSION:
        return ((given,), (), (given, _Signal()))  # Robot Runner's first callbacks also got a signal to set
    return ((), (given,)) if event in _WITHOUT_CONTEXT else ((given,), ())


class _Signal:
    """Said, in Robot Runner's first months, that the run was completed; a run is, when its callback returns."""

    def set(self) -> None:
        """Do nothing."""

    def is_set(self) -> bool:
        """Return that it is not."""
        return False


def _wants_row(callback: Callable[..., Any], event: RobotRunnerEvents) -> bool:
    if event is not RobotRunnerEvents.BEFORE_RUN:
        return False
    try:
        names = list(inspect.signature(callback).parameters)
    except (TypeError, ValueError):
        return False
    return bool(names) and names[0] in _ROW_NAMES


def _fits(callback: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
    try:
        inspect.signature(callback).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # written in C, without a signature
        return True
    return True


def _unfit(callback: Callable[..., Any], event: RobotRunnerEvents) -> ConfigError:
    name = getattr(callback, "__name__", repr(callback))
    signature = "self" if event in _WITHOUT_CONTEXT else "self, context"
    return ConfigError(
        f"{name}{inspect.signature(callback)} cannot be called at {event.name}",
        where=place_of(callback),
        fix=f"Write def {name}({signature}).",
    )
