"""The rules for every profiler, as tests for its author to inherit."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.config.plugin_checks import misspelt_callbacks
from robot_runner.core.errors import Finding
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.events.manager import EventManager, OwnerKind, RobotRunnerEvents
from robot_runner.core.events.measure import Measure, MeasureValue
from robot_runner.core.links.connect import SIMULATED
from robot_runner.core.plugin import Circumstances, Plugin, Profiler
from robot_runner.measuring.quality import MINIMUM_COVERAGE
from robot_runner.testing.fake_run import FakeClock, FakeLinks, RecordingBroker, Rehearsal, make_context

#: The time between two closings, s, so that the second would change the results of a plugin that repeats the work.
_BETWEEN_CLOSINGS = 0.2

#: The end of a complaint of two runs whose values differ, for an author whose device never reads the same twice.
_WHERE_VALUES_VARY = "Where equal runs have other values, as on a real device, set is_repeatable = False."

#: How many missions long the runs are in which a profiler gets another chance of a value. A program that samples may be
#: slow to start on a busy computer, and the mission of a contract is short.
_LONGER_MISSIONS = (3, 9, 27)


class MissionFailed(Exception):  # noqa: N818 - it is what a mission of a test raises, not an error of ours
    """Raised by a contract in the middle of a mission, to test a plugin's reaction."""


def require(claim: object, otherwise: str) -> None:
    """Fail the test with a sentence unless the claim holds."""
    if not claim:
        raise AssertionError(otherwise)


class PluginContract:
    """What `ProfilerContract` and `SystemContract` share; inherit from one of those.

    Attributes:
        robot: how the robot is reached in the tests.
        combination: the treatments of the run, by factor.
        is_repeatable: whether two runs under equal conditions have equal values, as on simulated robots.
    """

    robot: ClassVar[str | None] = SIMULATED
    combination: ClassVar[Mapping[str, Any]] = {}
    is_repeatable: ClassVar[bool] = True

    def make_plugin(self) -> Plugin:
        """Return a new and equal plugin at each call; for the author to write."""
        raise NotImplementedError("write make_plugin(self), which returns the plugin to test")

    def make_links(self, clock: FakeClock) -> FakeLinks | None:
        """Return fakes in place of the robot's links; None, the default, uses the robot that `robot` names."""
        del clock
        return None

    def make_context(self, folder: Path, plugin: Plugin, *, run_seed: int = 1) -> RobotRunnerContext:
        """Return the context of a run; to be overridden where `robot` and `make_links` are not enough."""
        clock = FakeClock()
        links = self.make_links(clock)
        return make_context(
            folder,
            plugin,
            robot=self.robot,
            links=links,
            clock=clock if links is not None else None,
            combination=self.combination,
            run_seed=run_seed,
        )

    def mission(self, context: RobotRunnerContext) -> None:
        """Execute the mission, while profilers measure."""

    @contextmanager
    def rehearsal(
        self, folder: Path, plugin: Plugin, *, run_seed: int = 1
    ) -> Iterator[tuple[RobotRunnerContext, Rehearsal]]:
        """Open a run for the plugin, whose resources are closed at its end."""
        context = self.make_context(folder, plugin, run_seed=run_seed)
        try:
            yield context, Rehearsal(context, plugin)
        finally:
            context.resources.close()

    def execute(self, folder: Path, plugin: Plugin) -> Mapping[str, MeasureValue]:
        """Execute a whole run and return the published values."""
        return self._execute_longer(folder, plugin, missions=1)

    def _execute_longer(self, folder: Path, plugin: Plugin, missions: int) -> Mapping[str, MeasureValue]:
        """Execute a run in which the mission is executed so many times, and return the published values."""
        with self.rehearsal(folder, plugin) as (context, rehearsal):

            def longer() -> None:
                for _ in range(missions):
                    self.mission(context)

            rehearsal.execute(longer)
            return dict(context.measures)

    def test_its_name_can_be_that_of_a_folder(self) -> None:
        """Check that the name is valid for a plugin."""
        plugin = self.make_plugin()
        require(isinstance(plugin, Plugin), f"{plugin!r} does not derive from System or Profiler")
        require(hasattr(plugin, "name"), "the plugin has no name: call super().__init__(name=name) in __init__")
        Plugin(name=plugin.name)

    def test_its_measures_have_names_of_their_own_and_a_description(self) -> None:
        """Check that the run table's schema can be written from the measures."""
        measures: object = self.make_plugin().measures
        is_list = isinstance(measures, Sequence) and all(isinstance(each, Measure) for each in measures)
        require(is_list, f'measures is {measures!r}: give a list, such as [Measure("Energy", "J")]')
        names = [measure.name for measure in self.make_plugin().measures]
        require(len(set(names)) == len(names), f"two measures have one name: {names}")
        for measure in self.make_plugin().measures:
            require(measure.name.strip(), "a measure has an empty name")
            require(measure.description.strip(), f"measure {measure.name!r} has no description")

    def test_its_callbacks_can_be_called(self) -> None:
        """Check that it has a callback, none is misspelt, and each takes a context or nothing."""
        manager, plugin = EventManager(), self.make_plugin()
        manager.subscribe_methods(plugin, owner=plugin.name, kind=OwnerKind.PROFILER)
        called = [event for event in RobotRunnerEvents if manager.subscribers(event)]
        require(called, "the plugin has no callback for an event: name its methods like events")
        misspelt = [str(finding) for finding in misspelt_callbacks(plugin)]
        require(not misspelt, f"methods are nearly called like ours, and nothing calls them: {misspelt}")

    def test_its_check_finds_nothing_wrong_where_it_works(self) -> None:
        """Check that `check` has no findings under the circumstances of these tests, and only findings elsewhere."""
        factors = {name: [treatment] for name, treatment in self.combination.items()}
        found = list(self.make_plugin().check(Circumstances(robot=self.robot, factors=factors)))
        errors = [str(finding) for finding in found if finding.is_error]
        require(not errors, f"the plugin's check refuses the circumstances of these tests: {errors}")
        for finding in self.make_plugin().check(Circumstances()):
            require(isinstance(finding, Finding), f"the plugin's check returned {finding!r}, which is not a Finding")
            require(finding.fix or not finding.is_error, f"a finding offers no fix: {finding}")

    def test_a_good_run_publishes_every_measure(self, tmp_path: Path) -> None:
        """Check that each measure gets a value or None, one of a profiler's a value, and that numbers have a unit."""
        plugin = self.make_plugin()
        folder, published = tmp_path, self.execute(tmp_path, plugin)
        for missions in _LONGER_MISSIONS:
            if not _has_measured_nothing(folder, plugin, published):
                break
            folder, plugin = tmp_path / f"{missions}-missions", self.make_plugin()
            published = self._execute_longer(folder, plugin, missions)
        missing = {measure.name for measure in plugin.measures} - set(published)
        require(not missing, f"the plugin did not publish {sorted(missing)}; publish None where there is no value")
        nothing = _has_measured_nothing(folder, plugin, published)
        require(not nothing, f"the plugin measured nothing in a good run: no value of {', '.join(published)}")
        for measure in plugin.measures:
            value = published[measure.name]
            if isinstance(value, int | float) and not isinstance(value, bool):
                require(math.isfinite(value), f"measure {measure.name!r} is {value}")
                require(measure.unit, f"measure {measure.name!r} is the number {value} and declares no unit")

    def test_it_writes_nothing_outside_its_folder(self, tmp_path: Path, monkeypatch: Any) -> None:
        """Check that raw data are written to `context.raw_data_folder` only."""
        (elsewhere := tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(elsewhere)
        plugin = self.make_plugin()
        self.execute(tmp_path / "experiment", plugin)
        reserved = tmp_path / "experiment" / "runs" / "r_1" / plugin.name
        stray = [path for path in _files(tmp_path) if reserved not in path.parents]
        require(not stray, f"the plugin wrote outside its folder: {[str(path) for path in stray]}")

    def test_two_of_its_kind_keep_their_raw_data_apart(self, tmp_path: Path) -> None:
        """Check that a second instance with another name does not change the files of the first."""
        first, second = self.make_plugin(), self.make_plugin()
        second.name = f"{first.name}-2"
        self.execute(tmp_path, first)
        before = {path: path.read_bytes() for path in _files(tmp_path)}
        self.execute(tmp_path, second)
        changed = [str(path) for path, content in before.items() if path.read_bytes() != content]
        require(not changed, f"an instance named {second.name!r} changed files of {first.name!r}: {changed}")

    def test_closing_what_was_never_opened_does_no_harm(self, tmp_path: Path) -> None:
        """Check that closing events may come without opening events."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (_, rehearsal):
            rehearsal.emit(RobotRunnerEvents.STOP_MEASUREMENT)
            rehearsal.emit(RobotRunnerEvents.STOP_RUN)

    def test_closing_twice_does_no_harm(self, tmp_path: Path) -> None:
        """Check that closing again does not change the results."""
        plugin = self.make_plugin()
        with self.rehearsal(tmp_path / "twice", plugin) as (context, rehearsal):
            for event in (
                RobotRunnerEvents.START_RUN,
                RobotRunnerEvents.START_MEASUREMENT,
                RobotRunnerEvents.LAUNCH_MISSION,
            ):
                rehearsal.emit(event)
            self.mission(context)
            for event in (RobotRunnerEvents.STOP_MEASUREMENT, RobotRunnerEvents.STOP_RUN):
                rehearsal.emit(event)
                context.clock.sleep(_BETWEEN_CLOSINGS)
                rehearsal.emit(event)
            rehearsal.emit(RobotRunnerEvents.POPULATE_RUN_DATA)
            published = dict(context.measures)
        self._require_equal(published, self.execute(tmp_path / "once", self.make_plugin()))

    def test_a_second_run_does_not_depend_on_the_first(self, tmp_path: Path) -> None:
        """Check that an instance that has executed a run has the same values as a new one."""
        used = self.make_plugin()
        with self.rehearsal(tmp_path / "first", used, run_seed=2) as (context, rehearsal):

            def longer() -> None:
                self.mission(context)
                self.mission(context)

            rehearsal.execute(longer)
        second = self.execute(tmp_path / "second", used)
        self._require_equal(second, self.execute(tmp_path / "new", self.make_plugin()))

    def test_a_mission_that_fails_is_closed(self, tmp_path: Path) -> None:
        """Check that the closing events work after an exception, and that the next run succeeds."""
        plugin = self.make_plugin()
        with self.rehearsal(tmp_path / "failed", plugin) as (context, rehearsal):

            def fail() -> None:
                self.mission(context)
                raise MissionFailed

            try:
                rehearsal.execute(fail)
            except MissionFailed as error:
                require(error.__context__ is None, f"closing raised {error.__context__!r}")
        self._require_equal(self.execute(tmp_path / "next", plugin), self.execute(tmp_path / "new", self.make_plugin()))

    def _require_equal(self, ours: Mapping[str, MeasureValue], those: Mapping[str, MeasureValue]) -> None:
        same = ours == those if self.is_repeatable else ours.keys() == those.keys()
        told = f"the plugin published {dict(ours)}, where a new instance published {dict(those)}"
        require(same, f"{told}. {_WHERE_VALUES_VARY}")


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _has_measured_nothing(folder: Path, plugin: Plugin, published: Mapping[str, MeasureValue]) -> bool:
    """Whether a profiler has no value, other than one that it withholds since its samples are too few."""
    if not isinstance(plugin, Profiler) or set(published.values()) != {None}:
        return False
    for path in folder.glob(f"runs/*/{plugin.name}/quality.json"):
        samples = json.loads(path.read_text(encoding="utf-8")).get("samples")
        if samples and samples["got"] and samples["coverage"] < MINIMUM_COVERAGE:
            return False
    return True


def _doubted(context: RobotRunnerContext) -> Iterator[str]:
    """Yield the measures that were doubted in a run."""
    if isinstance(context.broker, RecordingBroker):
        for kind, fields in context.broker.records:
            yield from fields.get("measures", ()) if kind == "finding" else ()


#: By how much the window that a profiler reports may differ from the mission, s.
_SAME_WINDOW = 0.001


class _SlowNeighbour(Profiler):
    """A profiler that measures nothing, but is slow to start and to stop."""

    def __init__(self, seconds: float) -> None:
        super().__init__(name="SlowNeighbour")
        self._seconds = seconds

    def start_measurement(self, context: RobotRunnerContext) -> None:
        context.clock.sleep(self._seconds)

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        context.clock.sleep(self._seconds)


class ProfilerContract(PluginContract):
    """The rules that a profiler must keep to; pytest finds the tests in a subclass whose name begins with `Test`.

    Attributes:
        measuring_seconds: how long each run measures, s on the run's clock.
        neighbour_seconds: how long another profiler takes to start and to stop, s on the run's clock; less where that
            clock is the machine's.
        tolerance: by which share values may differ with the order of the plugins; 0 for not at all, as on simulated
            robots. None, where runs are not repeatable, does not compare values with each other.

    Example:
        >>> from robot_runner.plugins.profilers import PsUtil
        >>> from robot_runner.testing import ProfilerContract
        >>> class TestPsUtil(ProfilerContract):
        ...     measuring_seconds = 2.0
        ...     def make_plugin(self):
        ...         return PsUtil(rate_hz=20.0)
    """

    measuring_seconds: ClassVar[float] = 1.0
    neighbour_seconds: ClassVar[float] = 3.0
    tolerance: ClassVar[float | None] = None

    def mission(self, context: RobotRunnerContext) -> None:
        """Let time pass."""
        context.clock.sleep(self.measuring_seconds)

    def test_it_is_a_profiler(self) -> None:
        """Check that it derives from `Profiler`, so that it is called after the systems."""
        plugin = self.make_plugin()
        require(isinstance(plugin, Profiler), f"{plugin!r} does not derive from Profiler")

    def test_values_are_about_the_mission_alone(self, tmp_path: Path) -> None:
        """Check that a slow profiler, listed before or after, changes no value, or that values are doubted.

        If it is listed after, this profiler samples for some seconds before and after the mission, too.
        """
        short, _ = self._with_neighbour(tmp_path / "before", is_first=True)
        long, doubted = self._with_neighbour(tmp_path / "behind", is_first=False)
        changed = [name for name, value in short.items() if not self._is_same(value, long[name])]
        unsaid = {name: (short[name], long[name]) for name in changed if name not in doubted}
        require(
            not unsaid,
            f"values depend on the order of the plugins, and no doubt says so: {unsaid}. Evaluate over context.window, "
            f"or tell of a window of your own with note_own_window. {_WHERE_VALUES_VARY}",
        )

    def _with_neighbour(self, folder: Path, *, is_first: bool) -> tuple[dict[str, MeasureValue], set[str]]:
        """Return the values published beside a slow profiler, and which of them are doubted."""
        plugin, neighbour = self.make_plugin(), _SlowNeighbour(self.neighbour_seconds)
        context = self.make_context(folder, plugin)
        plugins = (neighbour, plugin) if is_first else (plugin, neighbour)
        try:
            Rehearsal(context, *plugins).execute(lambda: self.mission(context))
            self._require_window(folder, plugin, context)
            return dict(context.measures), set(_doubted(context))
        finally:
            context.resources.close()

    def _is_same(self, ours: MeasureValue, those: MeasureValue) -> bool:
        tolerance = 0.0 if self.tolerance is None and self.is_repeatable else self.tolerance
        if isinstance(ours, int | float) and isinstance(those, int | float):
            return tolerance is None or math.isclose(ours, those, rel_tol=tolerance)
        return (ours is None) == (those is None) if tolerance is None else ours == those

    def _require_window(self, folder: Path, plugin: Plugin, context: RobotRunnerContext) -> None:
        """Check that the window in `quality.json`, where there is one, is the mission."""
        path = folder / "runs" / context.run_id / plugin.name / "quality.json"
        said = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        mission = context.times.window(SystemClock() if said.get("clock") == "machine" else None)
        if said.get("window") is None or mission is None:
            return
        start, end = said["window"]["start"], said["window"]["end"]
        is_same = max(abs(start - mission.start), abs(end - mission.end)) <= _SAME_WINDOW
        told = f"from {start} to {end} s, and the mission was from {mission.start} to {mission.end} s"
        require(is_same, f"its quality.json has a window {told}")

    def test_a_run_that_never_measured_is_closed(self, tmp_path: Path) -> None:
        """Check that a run that fails before its measurement can be closed."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (_, rehearsal):
            rehearsal.emit(RobotRunnerEvents.START_RUN)
            rehearsal.emit(RobotRunnerEvents.STOP_RUN)

    def test_a_measurement_of_no_length_does_no_harm(self, tmp_path: Path) -> None:
        """Check that a mission that fails at once leads to values or None, but to no exception."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (context, rehearsal):
            rehearsal.execute(lambda: None)
            declared = {measure.name for measure in self.make_plugin().measures}
            require(declared <= set(context.measures), f"the plugin published {sorted(context.measures)} only")
