"""The state of loading and executing a config file of an earlier tool, for its stand-in modules."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType
from typing import Any

from robot_runner.core.errors import ConfigError, Finding, LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.legacy.recognition import Recognised


@dataclass(frozen=True, slots=True)
class EarlierSubscription:
    """A callback that the config subscribed.

    Attributes:
        place: the code that subscribed it: a derived config replaces the callbacks of its base.
        is_of_fork: whether it subscribed to an additional event of a fork, which does not replace our event's callback.
    """

    event: RobotRunnerEvents
    callback: Callable[..., Any]
    place: CodeType
    is_of_fork: bool = False


def name_of(callback: object) -> str:
    """Return the name of a callback; empty if it has none."""
    return str(getattr(callback, "__name__", ""))


@dataclass(slots=True)
class Session:
    """One config file of an earlier tool.

    Attributes:
        seed: the seed of a random order of its runs.
        own_seed: the whole number with which the config seeds `random`, or None: its order is the earlier tool's then.
        is_begun: whether the experiment has begun, so that its seed is known.
        subscriptions: its callbacks, in the order of subscription.
        findings: from loading it, except errors that are raised at once.
        models: the run-table models that it made, in order.
        model: the one whose runs are executed; until that is known, the last one.
        context: the context of the run that is being executed, or None.
        config_class: the config class, once the file has been executed.
        estimated: the columns whose values are estimates by a model, not readings of a meter.
    """

    recognised: Recognised
    seed: int = 0
    own_seed: int | None = None
    is_begun: bool = False
    subscriptions: list[EarlierSubscription] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    models: list[Any] = field(default_factory=list)
    model: Any = None
    context: RobotRunnerContext | None = None
    config_class: type = object
    estimated: set[str] = field(default_factory=set)

    @property
    def path(self) -> Path:
        """The config file, absolute."""
        return self.recognised.path

    def callbacks_of(self, *events: RobotRunnerEvents) -> set[str]:
        """Return the names of the callbacks of some events."""
        return {name_of(each.callback) for each in self.subscriptions if each.event in events}

    def warn(self, where: str, problem: str, fix: str = "") -> None:
        """Add a warning, unless it was added before."""
        finding = Finding.warning(f"{self.path.name}, {where}", problem, fix)
        if finding not in self.findings:
            self.findings.append(finding)


# Not a context variable: the threads that a callback starts belong to the same config.
_active: list[Session] = []


@contextmanager
def active_session(session: Session) -> Iterator[None]:
    """Make this session the one that stand-in modules use."""
    _active.append(session)
    try:
        yield
    finally:
        _active.remove(session)


def current_session() -> Session:
    """Return the session of the config whose code is being executed.

    Raises:
        ConfigError: no config is being executed.
    """
    if not _active:
        problem = "the modules of the earlier tools are there only while Robot Runner executes a config file"
        raise ConfigError(problem, where="stand-in modules", fix="Start the file with `robot-runner run`.")
    return _active[-1]


def active_context() -> RobotRunnerContext | None:
    """Return the context of the run that is being executed, or None."""
    return _active[-1].context if _active else None


def current_run(where: str) -> RobotRunnerContext:
    """Return the context of the run that is being executed.

    Raises:
        LinkError: no run is being executed; `where` names the plugin that needs it.
    """
    context = active_context()
    if context is None:
        fix = "Use it in start_run and in the events after it."
        raise LinkError(f"{where} can be used only while a run is executed", where=where, fix=fix)
    return context


_log = logging.getLogger(__name__)


def warn_of_run(problem: str, *, fix: str = "") -> None:
    """Add a warning to the run, which is shown at the end of the experiment; outside a run it is logged."""
    context = active_context()
    if context is None:
        _log.warning("%s %s", problem, fix)
    else:
        context.warn(problem, fix=fix)
