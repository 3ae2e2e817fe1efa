"""What is known while a config file of an earlier tool is loaded and executed; its stand-in modules look here."""

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
        place: the code that subscribed it: a config that derives from another replaces what that one subscribed.
        is_of_fork: whether it was subscribed to an event of a fork's own, which stands beside the one that it is here.
    """

    event: RobotRunnerEvents
    callback: Callable[..., Any]
    place: CodeType
    is_of_fork: bool = False


def name_of(callback: object) -> str:
    """Return the name of a callback; empty where it has none."""
    return str(getattr(callback, "__name__", ""))


@dataclass(slots=True)
class Session:
    """One config file of an earlier tool.

    Attributes:
        seed: what a randomised order of its runs comes from.
        subscriptions: its callbacks, in the order in which they subscribed.
        findings: what was found while it was loaded, other than what refuses it at once.
        models: the run-table models that it made, in order.
        context: the context of the run that is being executed, or None.
        config_class: the class that describes the experiment, when the file has been executed.
        estimated: the columns whose values come from a model and not from a meter.
    """

    recognised: Recognised
    seed: int = 0
    subscriptions: list[EarlierSubscription] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    models: list[Any] = field(default_factory=list)
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
        """Note something that does not refuse the config; the same is noted once."""
        finding = Finding.warning(f"{self.path.name}, {where}", problem, fix)
        if finding not in self.findings:
            self.findings.append(finding)


# Not a context variable: the threads that a callback starts belong to the same config.
_active: list[Session] = []


@contextmanager
def active_session(session: Session) -> Iterator[None]:
    """Have stand-in modules look at this session."""
    _active.append(session)
    try:
        yield
    finally:
        _active.remove(session)


def current_session() -> Session:
    """Return the session of the config whose code is being executed.

    Raises:
        ConfigError: there is none.
    """
    if not _active:
        raise ConfigError(
            "the modules of the earlier tools are there only while Robot Runner executes a config file",
            where="stand-in modules",
            fix="Start the file with `robot-runner run`.",
        )
    return _active[-1]


def active_context() -> RobotRunnerContext | None:
    """Return the context of the run that is being executed, or None."""
    return _active[-1].context if _active else None


def current_run(where: str) -> RobotRunnerContext:
    """Return the context of the run that is being executed.

    Raises:
        LinkError: there is none; `where` names the plugin that needs it.
    """
    context = active_context()
    if context is None:
        raise LinkError(
            f"{where} can be used only while a run is executed",
            where=where,
            fix="Use it in start_run and in the events after it.",
        )
    return context


_log = logging.getLogger(__name__)


def warn_of_run(problem: str, *, fix: str = "") -> None:
    """Warn of something doubtful at the end of the experiment; outside a run it is logged."""
    context = active_context()
    if context is None:
        _log.warning("%s %s", problem, fix)
    else:
        context.warn(problem, fix=fix)
