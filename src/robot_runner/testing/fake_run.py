"""A run without an experiment: the six events, and the plugins under test."""

from __future__ import annotations

import heapq
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from robot_runner.core.design.watched_combination import WatchedCombination, unread
from robot_runner.core.errors import did_you_mean
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.early_end import MissionStopped
from robot_runner.core.events.manager import CLOSED_BY, Emission, EventManager, OwnerKind, RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER, Measure, MeasureValue, resolve_columns, with_phases
from robot_runner.core.events.measure_broker import MeasureBroker
from robot_runner.core.events.resources import Closable, R, Resources
from robot_runner.core.events.window import MissionTimes
from robot_runner.core.execution.run_events import made_safe, publish_returned
from robot_runner.core.links.connect import SIMULATED, is_simulated, open_clock
from robot_runner.core.links.declared_host import Host, named_hosts
from robot_runner.core.links.host_commands import opened_host
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.plugin import Plugin, System, refused_name, usual_origin
from robot_runner.core.treatments import bind, factors_of
from robot_runner.measuring.host import HostLink
from robot_runner.measuring.serial_line import SerialLine
from robot_runner.ros.missions.joint_missions import sleep_with_others

# A clock that is moved by tests.


class Repetition:
    """A periodic callback of a fake clock, until it is closed."""

    def __init__(self) -> None:
        self.is_closed = False

    def close(self) -> None:
        """End the calls; closing twice does nothing."""
        self.is_closed = True


class FakeClock:
    """A `Clock` on which time passes only in `sleep`, which calls the scheduled callbacks at their times.

    Args:
        start: the time that it shows at first, s.

    Example:
        >>> clock = FakeClock(start=100.0)
        >>> clock.at(101.0, lambda: print("one second later"))
        >>> clock.sleep(5.0)
        one second later
        >>> clock.now()
        105.0
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()  # callbacks of the same time are called in the order of scheduling

    def now(self) -> float:
        """Return the time that it shows, s."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Move the clock on; exceptions of scheduled callbacks propagate."""
        if sleep_with_others(seconds):
            return
        target = self._now + max(seconds, 0.0)
        while self._due and self._due[0][0] <= target:
            self._now, _, callback = heapq.heappop(self._due)
            callback()
        self._now = max(self._now, target)

    def at(self, time: float, callback: Callable[[], None]) -> None:
        """Call `callback` when the clock shows `time`, or at the next sleep if that has passed."""
        heapq.heappush(self._due, (max(time, self._now), next(self._numbers), callback))

    def every(self, period: float, callback: Callable[[], None]) -> Repetition:
        """Call `callback` every `period` seconds, first one period from now, until the result is closed."""
        repetition, begun = Repetition(), self._now

        def tick(number: int) -> None:
            if not repetition.is_closed:
                self.at(begun + (number + 1) * period, lambda: tick(number + 1))
                callback()

        self.at(begun + period, lambda: tick(1))
        return repetition

    call_every = every  # so that a `PeriodicSampler` takes its readings on this clock


# A run's context for a test, with the broker for measures that a real run has.


class RecordingBroker(MeasureBroker):
    """The broker of a real run, which keeps its records instead of reporting them.

    Attributes:
        records: oldest first, each with its kind (`measure`, `finding`, `window`, ...).

    Example:
        >>> from robot_runner.plugins import Measure, Origin
        >>> broker = RecordingBroker({"Scale": [Measure("Mass", "kg", "Mass of the robot.")]})
        >>> broker.publish("Scale", "Mass", 1.0, Origin.MEASURED)
        >>> broker.values
        {'Mass': 1.0}
    """

    def __init__(self, measures_by_plugin: Mapping[str, Sequence[Measure]], *, run_id: str = "r_1") -> None:
        columns, _ = resolve_columns(None, measures_by_plugin)
        self.records: list[tuple[str, dict[str, Any]]] = []
        super().__init__(run_id, columns, self.report)

    def report(self, kind: str, fields: dict[str, Any]) -> None:
        """Keep a record."""
        self.records.append((kind, fields))

    @property
    def values(self) -> dict[str, MeasureValue]:
        """The values published so far, by column."""
        return {name: published.value for name, published in self.measures.items()}


class FakeLinks:
    """Fakes in place of a robot's links; plugins get them as they would get real ones.

    Args:
        robot: returned by `connect_robot`.
        serial: returned by `open_serial_line` for every port.
        host: returned by `connect_host` for every computer.
        namespace: the robot's.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeHostLink
        >>> links = FakeLinks(host=FakeHostLink(FakeClock()))
    """

    def __init__(
        self,
        *,
        robot: RobotLink | None = None,
        serial: SerialLine | None = None,
        host: HostLink | None = None,
        namespace: str = "",
    ) -> None:
        key = namespace.strip("/") or "/"
        named = {f"robot {key}": robot, f"serial {key}": serial, f"host {key}": host}
        self._links: dict[str, Closable] = {name: link for name, link in named.items() if link is not None}
        self._named: dict[str, Closable | None] = {"port": serial, "computer": host}

    def plant(self, resources: Resources) -> None:
        """Put these links among the opened resources of a run."""
        resources.open("simulation", ExitStack[None])  # nothing to close, so that none is started
        for key, link in self._links.items():
            resources.open(key, partial(_itself, link))

    def resources(self) -> Resources:
        """Return the resources of a run in which these links replace the real ones."""
        resources = _FakeResources(self._named)
        self.plant(resources)
        return resources


class _FakeResources(Resources):
    """Returns the fake for any port or computer that it replaces: a test must not talk to real devices."""

    def __init__(self, named: Mapping[str, Closable | None]) -> None:
        super().__init__()
        self._named = named

    def open(self, key: str, opener: Callable[[], R]) -> R:
        """Return the resource that was opened under `key`, or its fake."""
        fake = self._named.get(key.partition(" ")[0])
        return super().open(key, opener if fake is None else lambda: cast("R", fake))


def _itself(link: Closable) -> Closable:
    return link


def make_context(
    folder: Path,
    *plugins: Plugin,
    robot: str | None = SIMULATED,
    links: FakeLinks | None = None,
    clock: Clock | None = None,
    combination: Mapping[str, Any] | None = None,
    run_seed: int = 1,
    phases: Sequence[str] = (),
    hosts: Mapping[str, Host | str] = MappingProxyType({}),
) -> RobotRunnerContext:
    """Return the context of a run for the first of `plugins`; `context_for` makes those of the others.

    The measures that the plugins declare are the only ones that can be published. Close `context.resources`
    when done, as the end of a run does.

    Args:
        folder: where the run's folder is made, such as pytest's `tmp_path`.
        plugins: the plugins of the experiment; without any, the context is the config's.
        robot: how the robot is reached.
        links: replace the robot's links; without them the embedded robot is used, where `robot` names it.
        clock: the run's clock; left out, a `FakeClock` where `links` are given, else that of the robot.
        combination: the treatment of each factor.
        run_seed: the seed of the run.
        phases: the phases for which measures are published, too.
        hosts: the computers that `context.host` opens, as a config names them.

    Raises:
        LinkError: `robot` cannot be reached.
        PluginError: a plugin has no name, or one that is not valid.

    Example:
        >>> from pathlib import Path
        >>> context = make_context(Path("unused"), robot=None, combination={"Task": "Video"})
        >>> context.owner, context.combination["Task"]
        ('config', 'Video')
    """
    resources = Resources() if links is None else links.resources()
    for plugin in plugins:
        bind(plugin, combination or {})
        if refused := refused_name(plugin):
            raise refused
    if links is None and clock is None and robot is not None:
        clock = open_clock(robot, resources, seed=run_seed)
    clock = clock or FakeClock()
    broker = RecordingBroker({plugin.name: with_phases(plugin.measures, phases) for plugin in plugins})
    return RobotRunnerContext(
        experiment_name="test",
        experiment_folder=folder,
        robot=robot,
        run_id="r_1",
        run_number=1,
        run_count=1,
        attempt=1,
        combination=WatchedCombination(combination or {}, lambda _: None),
        repetition=1,
        run_seed=run_seed,
        run_path=folder / "runs" / "r_1",
        clock=clock,
        resources=resources,
        owner=plugins[0].name if plugins else CONFIG_OWNER,
        times=MissionTimes(clock, broker.report, phases),
        broker=broker,
        hosts=partial(opened_host, named_hosts(hosts)),
        usual_origin=usual_origin(plugins[0] if plugins else None, is_simulated=is_simulated(robot)),
    )


def context_for(plugin: Plugin, context: RobotRunnerContext) -> RobotRunnerContext:
    """Return the same run's context for another plugin."""
    return replace(
        context, owner=plugin.name, usual_origin=usual_origin(plugin, is_simulated=is_simulated(context.robot))
    )


class Rehearsal:
    """Emits the events of one run to plugins, in the order in which a real run does.

    Args:
        context: the run's, as `make_context` makes it.
        plugins: the subscribers.

    Raises:
        ConfigError: the signature of a callback is not valid.
    """

    def __init__(self, context: RobotRunnerContext, *plugins: Plugin) -> None:
        self._context, self._times = context, context.times
        self._contexts = {plugin.name: context_for(plugin, context) for plugin in plugins}
        self._systems = [plugin for plugin in plugins if isinstance(plugin, System)]
        self._manager = EventManager()
        for plugin in plugins:
            kind = OwnerKind.SYSTEM if isinstance(plugin, System) else OwnerKind.PROFILER
            self._manager.subscribe_methods(plugin, owner=plugin.name, kind=kind)

    def emit(self, event: RobotRunnerEvents, *, but_not: Collection[str] = ()) -> None:
        """Emit one event, publish the values that `populate_run_data` returned, and raise a callback's exception.

        The mission begins at `launch_mission`, and ends at `stop_measurement`. The plugins named in `but_not` do not
        get the event.
        """
        self._check(self._emission(event, but_not))

    def execute(self, mission: Callable[[], None]) -> None:
        """Emit all six events, with `mission` beside the callbacks of `launch_mission`.

        Before an exception propagates, closing events are emitted and the systems are made safe. A mission that
        `context.stop_mission` ends is not a failure: the systems are made safe, and the run goes on. What a thread
        raises counts once the mission has ended, unless the thread handles it; while closing it is a finding.
        """
        is_stopped = False
        try:
            with self._threads() as raised, ExitStack() as closing:
                for event in (RobotRunnerEvents.START_RUN, RobotRunnerEvents.START_MEASUREMENT):
                    emission = self._emission(event)
                    heard = {subscriber.owner for subscriber in self._manager.subscribers(event)}
                    closing.callback(self.emit, CLOSED_BY[event], but_not=heard.difference(emission.reached))
                    self._check(emission)
                try:
                    self.emit(RobotRunnerEvents.LAUNCH_MISSION)
                    mission()
                    if raised:
                        raise raised[0].exc_value or raised[0].exc_type
                except MissionStopped:
                    is_stopped = True
            if is_stopped:
                self.make_safe()
            self._miss_phases()
            self.emit(RobotRunnerEvents.POPULATE_RUN_DATA)
        except BaseException:
            self.make_safe()
            raise

    def make_safe(self) -> None:
        """Make all systems safe, the last one first; an exception of one propagates after all were called."""
        with ExitStack() as asking:
            for system in self._systems:
                asking.callback(made_safe, system, self._contexts[system.name])

    @contextmanager
    def _threads(self) -> Iterator[list[threading.ExceptHookArgs]]:
        """Collect what threads raise and do not handle; where the run goes on all the same, it is a finding."""
        raised: list[threading.ExceptHookArgs] = []
        earlier, others = threading.excepthook, threading.enumerate()  # those of an earlier run are not of this one
        threading.excepthook = lambda told: (earlier if told.thread in others else raised.append)(told)
        try:
            yield raised
        finally:
            threading.excepthook = earlier
        for each in raised:
            if not isinstance(each.exc_value, MissionStopped):
                name = getattr(each.thread, "name", "(ended)")
                self._context.warn(f"thread {name} raised {each.exc_type.__name__}: {each.exc_value}")

    def _miss_phases(self) -> None:
        there = [phase.name for phase in self._context.phases]
        for name in self._times.requested:
            if name not in there:
                self._context.warn(f"the mission had no phase {name!r}", fix=did_you_mean(name, there))

    def _emission(self, event: RobotRunnerEvents, but_not: Collection[str] = ()) -> Emission:
        if event is RobotRunnerEvents.LAUNCH_MISSION:
            self._times.begin()
        elif event is RobotRunnerEvents.STOP_MEASUREMENT:
            self._times.end()
        emission = self._manager.emit(event, self._contexts.__getitem__, but_not=but_not)
        if event is RobotRunnerEvents.POPULATE_RUN_DATA:
            for owner, returned in emission.returned:
                publish_returned(self._contexts[owner], returned)
        return emission

    @staticmethod
    def _check(emission: Emission) -> None:
        for failure in emission.failures:
            raise failure.error


def rehearse(
    context: RobotRunnerContext, *plugins: Plugin, mission: Callable[[], None] = lambda: None
) -> Mapping[str, MeasureValue]:
    """Execute one run with these plugins and return the measures that they published, by column.

    Args:
        context: the run's, as `make_context` makes it.
        plugins: the subscribers; systems come before profilers, at closing events in reverse.
        mission: executed while profilers measure; for a profiler alone, something like
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
    if isinstance(context.combination, WatchedCombination):
        bound = {factor for plugin in plugins for factor in factors_of(plugin).values()}
        for factor in sorted(context.combination.unread - bound):
            finding = unread(context.run_id, factor)
            context.warn(finding.problem, fix=finding.fix)
    return context.measures
