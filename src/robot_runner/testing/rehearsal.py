"""A run without an experiment around it: the six events, heard by plugins that are under test."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.events.event import CLOSED_BY, RobotRunnerEvents
from robot_runner.events.manager import EventManager
from robot_runner.events.subscription import OwnerKind
from robot_runner.plugins.api.plugin import System
from robot_runner.testing.context import context_for

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.events.context import RobotRunnerContext
    from robot_runner.events.measure import MeasureValue
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["Rehearsal", "rehearse"]


class Rehearsal:
    """Emits the events of one run to plugins, in the order in which a real run does.

    Args:
        context: the run's, as `make_context` makes it.
        plugins: who hears.

    Raises:
        ConfigError: a callback's signature does not fit.
    """

    def __init__(self, context: RobotRunnerContext, *plugins: Plugin) -> None:
        self._contexts = {plugin.name: context_for(plugin, context) for plugin in plugins}
        self._systems = [plugin for plugin in plugins if isinstance(plugin, System)]
        self._manager = EventManager()
        for plugin in plugins:
            kind = OwnerKind.SYSTEM if isinstance(plugin, System) else OwnerKind.PROFILER
            self._manager.subscribe_methods(plugin, owner=plugin.name, kind=kind)

    def emit(self, event: RobotRunnerEvents) -> None:
        """Emit one event and raise what a callback raised."""
        emission = self._manager.emit(event, self._contexts.__getitem__)
        for failure in emission.failures:
            raise failure.error

    def execute(self, mission: Callable[[], None]) -> None:
        """Emit all six events, with `mission` beside what hears `launch_mission`.

        What was opened is closed and the systems are made safe before anything is raised.
        """
        try:
            with ExitStack() as closing:
                for event in (RobotRunnerEvents.START_RUN, RobotRunnerEvents.START_MEASUREMENT):
                    closing.callback(self.emit, CLOSED_BY[event])
                    self.emit(event)
                self.emit(RobotRunnerEvents.LAUNCH_MISSION)
                mission()
        except BaseException:
            self.make_safe()
            raise
        self.emit(RobotRunnerEvents.POPULATE_RUN_DATA)

    def make_safe(self) -> None:
        """Make all systems safe, the last one first."""
        for system in reversed(self._systems):
            system.make_safe(self._contexts[system.name])


def rehearse(
    context: RobotRunnerContext, *plugins: Plugin, mission: Callable[[], None] = lambda: None
) -> Mapping[str, MeasureValue]:
    """Execute one run with these plugins and return the measures that they published, by column.

    Args:
        context: the run's, as `make_context` makes it.
        plugins: who hears the events; systems before profilers, closing events in reverse.
        mission: what happens while profilers measure; for a profiler alone, something like
            `lambda: context.clock.sleep(2.0)`.

    Example:
        >>> from pathlib import Path
        >>> from robot_runner.plugins import Measure, Profiler
        >>> from robot_runner.testing import make_context, rehearse
        >>> class Scale(Profiler):
        ...     measures = (Measure("Mass", "kg", "Mass of the robot."),)
        ...     def populate_run_data(self, context):
        ...         context.publish("Mass", 1.0)
        >>> scale = Scale()
        >>> dict(rehearse(make_context(Path("unused"), scale, robot=None), scale))
        {'Mass': 1.0}
    """
    Rehearsal(context, *plugins).execute(mission)
    return context.measures
