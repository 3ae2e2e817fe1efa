"""The system that combines several: their missions begin together, and are stopped together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
from robot_runner.core.events.manager import CLOSED_BY, EVENTS_BY_CALLBACK, RobotRunnerEvents
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.graph_names import full_name, namespace_prefix
from robot_runner.core.plugin import Circumstances, Plugin, System
from robot_runner.core.words import enumerated
from robot_runner.ros.missions.joint_missions import JointMission, SharedClock, execute_together

if TYPE_CHECKING:
    from robot_runner.core.events.measure import Origin
    from robot_runner.core.events.measure_broker import MeasureBroker
    from robot_runner.core.events.window import MissionTimes
    from robot_runner.core.links.graph_names import GraphNeed
    from robot_runner.core.storage.input_files import InputFile

_LAUNCH = RobotRunnerEvents.LAUNCH_MISSION
_FEWEST = 2


class Together(System):
    """Executes the missions of several systems at the same time, such as of two robots.

    The missions begin together, and the mission of the run lasts until the last has ended. If one fails, the others are
    stopped at once, and the error names the one that failed. The measures of a system are prefixed by its name
    (`alice.Distance`), and so are its phases (`alice_leg_1`); its raw data are in a folder of its name. On a simulated
    robot all missions share the simulated seconds, as of two robots in one room.

    Args:
        *systems: two or more, each with a name of its own; each may bind parameters to factors.
        name: the class's name if left out.

    Raises:
        PluginError: they are fewer than two, one is not a system, or two have the same name.

    Example:
        >>> from robot_runner.plugins.systems import BasicTurtlebot3
        >>> pair = Together(
        ...     BasicTurtlebot3(name="alice", namespace="/alice", task="Video", task_factor=None),
        ...     BasicTurtlebot3(name="bob", namespace="/bob", task="Video", task_factor=None),
        ... )
        >>> [measure.name for measure in pair.measures][:2]
        ['alice.Duration', 'alice.Distance']
    """

    needs: ClassVar[str] = "What its systems need: a robot for each."

    def __init__(self, *systems: System, name: str | None = None) -> None:
        super().__init__(name=name)
        self.systems = systems
        self._check_systems()
        self.measures = tuple(
            replace(measure, name=f"{system.name}.{measure.name}", description=f"{system.name}: {measure.description}")
            for system in systems
            for measure in system.measures
        )
        self.starts_nodes = any(system.starts_nodes for system in systems)
        self.bytes_per_run = sum(system.bytes_per_run for system in systems)
        self._entered: dict[RobotRunnerEvents, list[System]] = {}
        for callback, event in EVENTS_BY_CALLBACK.items():
            if event is not _LAUNCH and any(hasattr(system, callback) for system in systems):
                setattr(self, callback, partial(self._pass_on, event))

    def _check_systems(self) -> None:
        strangers = [each for each in self.systems if not isinstance(each, System)]
        if strangers or len(self.systems) < _FEWEST:
            given = f"{strangers[0]!r} is not a system" if strangers else f"{len(self.systems)} system is given"
            fix = "Give two systems or more: Together(Waypoints(..., name='alice'), Waypoints(..., name='bob'))."
            raise PluginError(given, where=self.name, fix=fix)
        names = [each.name.casefold() for each in self.systems]
        twice = next((each for each in self.systems if names.count(each.name.casefold()) > 1), None)
        if twice is not None:
            problem = f"{names.count(twice.name.casefold())} of its systems are named {twice.name!r}"
            fix = f"Give each a name of its own: {type(twice).__name__}(name='alice')."
            raise PluginError(problem, where=self.name, fix=fix)

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return the claims of all its systems."""
        return dict.fromkeys(claim for system in self.systems for claim in system.claims(robot))

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return the findings of its systems, and an error where two of them command the same topic."""
        others = tuple(each for each in circumstances.plugins if each is not self)
        asked = replace(circumstances, plugins=(*others, *self.systems))
        for system in self.systems:
            yield from system.check(asked)
        yield from self._check_commanded()

    def _check_commanded(self) -> Iterator[Finding]:
        commanding: dict[str, list[str]] = {}
        for system in self.systems:
            for topic in getattr(system, "commands", ()):
                commanding.setdefault(full_name(getattr(system, "namespace", ""), topic), []).append(system.name)
        for topic, names in commanding.items():
            if len(names) > 1:
                problem = f"{enumerated(names)} command the same robot at the same time, on {topic!r}"
                fix = "Give each its robot's namespace, as in Waypoints(..., namespace='/alice')."
                yield Finding.error(f"plugin {self.name}", problem, fix)

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return the needs of its systems, each below its own namespace."""
        for system in self.systems:
            prefix = namespace_prefix(getattr(system, "namespace", "") or "")
            for need in system.required_graph(circumstances):
                name = need.name if need.name.startswith("/") or not prefix else f"{prefix[1:]}/{need.name}"
                yield replace(need, name=name)

    def input_files(self) -> Iterable[InputFile]:
        """Return the input files of its systems."""
        for system in self.systems:
            yield from system.input_files()

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        """Return the duration of the longest mission, s; None where one is not known."""
        known = [system.duration_s(combination) for system in self.systems]
        return max((each for each in known if each is not None), default=None) if None not in known else None

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Execute the missions at the same time."""
        missions = [
            JointMission(system.name, partial(_called, system, _LAUNCH, self._context_of(system, context)))
            for system in self.systems
            if hasattr(system, _LAUNCH.callback_name)
        ]
        execute_together(missions, context.clock, takes_turns=is_simulated(context.robot))

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Make all its systems safe, even if one fails."""
        with ExitStack() as each_of_them:
            for system in self.systems:  # the last one first
                each_of_them.callback(system.make_safe, self._context_of(system, context))

    def stand_by(self, context: RobotRunnerContext) -> None:
        """Let all its systems get ready, even if one fails."""
        with ExitStack() as each_of_them:
            for system in self.systems:
                each_of_them.callback(system.stand_by, self._context_of(system, context))

    def _pass_on(self, event: RobotRunnerEvents, context: Any) -> dict[str, Any] | None:
        """Call the callbacks of its systems; at a closing event, of those that got the opening one, in reverse."""
        if event.is_closing:
            self._close(event, context)
            return None
        reached = self._entered[event] = []
        returned: dict[str, Any] = {}
        for system in self.systems:
            reached.append(system)
            given = _called(system, event, self._context_of(system, context))
            if isinstance(given, dict):
                returned |= {f"{system.name}.{name}": value for name, value in given.items()}
        return returned or None

    def _close(self, event: RobotRunnerEvents, context: Any) -> None:
        opening = next((each for each, closing in CLOSED_BY.items() if closing is event), event)
        reached = self._entered.pop(opening, self.systems)
        with ExitStack() as each_of_them:
            for system in reached:  # the last one first
                each_of_them.callback(_called, system, event, self._context_of(system, context))

    def _context_of(self, system: System, context: Any) -> Any:
        if not hasattr(context, "broker"):  # before and after the experiment
            return context
        return replace(
            context,
            owner=system.name,
            clock=SharedClock(context.clock),
            run_path=context.run_path / self.name,
            broker=_BrokerOfOne(context.broker, self.name, system),
            times=_TimesOfOne(context.times, system.name),
        )


def _called(system: Plugin, event: RobotRunnerEvents, context: ExperimentContext) -> Any:
    callback: Callable[..., Any] | None = getattr(system, event.callback_name, None)
    return callback(context) if callback is not None else None


class _BrokerOfOne:
    """A run's broker for one of the systems: prefixes its measures, findings and notes by its name."""

    def __init__(self, broker: MeasureBroker, together: str, system: System) -> None:
        self._broker = broker
        self._together = together
        self._name = system.name
        self._measures = [measure.name for measure in system.measures]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._broker, name)

    def publish(self, owner: str, name: str, value: object, origin: Origin) -> None:
        del owner
        self._broker.publish(self._together, f"{self._name}.{name}", value, origin)

    def warn(self, owner: str, problem: str, fix: str) -> None:
        del owner
        self._broker.warn(self._together, f"{self._name}: {problem}", fix)

    def doubt(self, owner: str, problem: str, fix: str, measures: Sequence[str]) -> None:
        del owner
        given = [measures] if isinstance(measures, str) else measures  # a text is one name, not a sequence of letters
        if named := [f"{self._name}.{name}" for name in given or self._measures]:
            self._broker.doubt(self._together, f"{self._name}: {problem}", fix, named)
        else:
            self.warn("", problem, fix)

    def note(self, owner: str, kind: str, facts: Mapping[str, object]) -> None:
        del owner
        self._broker.note(self._together, kind, facts)


class _TimesOfOne:
    """The times of a mission for one of the systems: its phases are prefixed by its name."""

    def __init__(self, times: MissionTimes, name: str) -> None:
        self._times = times
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._times, name)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        with self._times.phase(f"{self._name}_{name}"):
            yield
