"""A contract is worth something only if a plugin that breaks it fails: here is one for each fact."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import ClassVar

import pytest

from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.connect import connect_robot
from robot_runner.plugins import Profiler, System, Window, note_own_window, quality_of, report_quality
from robot_runner.testing import FakeClock, FakeLinks, FakeTurtlebot3Link, ProfilerContract, SystemContract
from robot_runner.testing.plugin_contract import MissionFailed

TWIST = "geometry_msgs/Twist"


class Stopwatch(Profiler):
    """A profiler that keeps to the contract."""

    measures: ClassVar = (Measure("Seconds", "s", "Time between start and stop of the measurement."),)
    began = None
    seconds = None

    def start_measurement(self, context):
        self.began, self.seconds = context.clock.now(), None

    def stop_measurement(self, context):
        if self.began is not None and self.seconds is None:
            self.seconds = context.clock.now() - self.began
            (context.raw_data_folder / "seconds.txt").write_text(f"{self.name} {self.seconds}\n")

    def populate_run_data(self, context):
        if self.began is not None and self.seconds is not None:
            note_own_window(context, Window(self.began, self.began + self.seconds))
        context.publish("Seconds", self.seconds)


class Waggon(System):
    """A system that keeps to the contract: it drives for a second, twice."""

    measures: ClassVar = (Measure("Drives", "1", "How often the robot drove."),)
    drives = 0

    def start_run(self, context):
        del context
        self.drives = 0

    def launch_mission(self, context):
        for _ in range(2):
            try:
                self.tell(context, 0.1)
                context.clock.sleep(1.0)
            finally:
                self.tell(context, 0.0)
            self.drives += 1

    def populate_run_data(self, context):
        context.publish("Drives", self.drives)

    def make_safe(self, context):
        self.tell(context, 0.0)

    @staticmethod
    def tell(context, speed):
        connect_robot(context).publish("cmd_vel", TWIST, {"linear": {"x": speed}})


def profiler_facts(plugin_class: type) -> ProfilerContract:
    class Facts(ProfilerContract):
        robot = None

        def make_plugin(self):
            return plugin_class()

    return Facts()


def system_facts(plugin_class: type) -> SystemContract:
    class Facts(SystemContract):
        def make_plugin(self):
            return plugin_class()

        def make_links(self, clock: FakeClock) -> FakeLinks:
            return FakeLinks(robot=FakeTurtlebot3Link(clock))

    return Facts()


class TestStopwatch(ProfilerContract):
    robot = None

    def make_plugin(self):
        return Stopwatch()


class TestWaggon(SystemContract):
    def make_plugin(self):
        return Waggon()

    def make_links(self, clock):
        return FakeLinks(robot=FakeTurtlebot3Link(clock))


class TestWaggonOnTheSimulatedRobot(SystemContract):
    def make_plugin(self):
        return Waggon()


class Nameless(Stopwatch):
    def __init__(self):
        pass


class NotAPlugin:
    name = "impostor"
    measures = ()

    def start_run(self, context): ...


class Commaless(Stopwatch):
    measures: ClassVar = Measure("Seconds", "s", "Time between start and stop of the measurement.")


class Named(Stopwatch):
    measures: ClassVar = ("Seconds",)


class Twins(Stopwatch):
    measures: ClassVar = (Measure("Seconds", "s", "One."), Measure("Seconds", "s", "Two."))


class Undescribed(Stopwatch):
    measures: ClassVar = (Measure("Seconds", "s"),)


class Deaf(Profiler):
    pass


class OddCallback(Stopwatch):
    def start_measurement(self, context, extra): ...


class Misspelt(Stopwatch):
    def stop_runs(self, context): ...


class Refusing(Stopwatch):
    def check(self, circumstances):
        return [Finding.error("here", "never content", "Give up.")]


class Unhelpful(Stopwatch):
    def check(self, circumstances):
        return [] if circumstances.factors else ["something is wrong"]


class Silent(Stopwatch):
    def populate_run_data(self, context): ...


class Blind(Stopwatch):
    def populate_run_data(self, context):
        for measure in self.measures:
            context.publish(measure.name, None)


class LateToStart(Stopwatch):
    """It has its first reading only after some seconds, as a program that is started on a busy computer."""

    def populate_run_data(self, context):
        context.publish("Seconds", self.seconds if self.seconds > 20.0 else None)


class Starved(Stopwatch):
    """It samples, but too seldom for a value, as on a busy computer, and withholds it with a doubt."""

    times: ClassVar = (0.1, 0.2)

    def populate_run_data(self, context):
        quality = quality_of([self.began + time for time in self.times], context.window, 10.0)
        report_quality(context, quality, context.window)
        context.publish("Seconds", None)


class Unread(Starved):
    times: ClassVar = ()


class Unevaluated(Starved):
    times: ClassVar = tuple(number / 10 for number in range(300))


class Unitless(Stopwatch):
    measures: ClassVar = (Measure("Seconds", "", "Time between start and stop of the measurement."),)


class Undeclared(Stopwatch):
    def populate_run_data(self, context):
        context.publish("Minutes", 1.0)


class Litterer(Stopwatch):
    def stop_measurement(self, context):
        super().stop_measurement(context)
        Path("seconds.txt").write_text("here")


class Intruder(Stopwatch):
    def stop_measurement(self, context):
        super().stop_measurement(context)
        (context.run_folder / "Stopwatch").mkdir(exist_ok=True, parents=True)
        (context.run_folder / "Stopwatch" / "seconds.txt").write_text(self.name)


class Presumptuous(Stopwatch):
    def stop_measurement(self, context):
        self.seconds = context.clock.now() - self.began


class Forgetful(Stopwatch):
    def stop_measurement(self, context):
        super().stop_measurement(context)
        self.began = None

    def populate_run_data(self, context):
        context.publish("Seconds", self.seconds)
        self.seconds = None

    def stop_run(self, context):
        self.seconds = None if self.seconds is None else self.seconds / 2


class Hoarder(Stopwatch):
    total = 0.0

    def populate_run_data(self, context):
        self.total += self.seconds
        context.publish("Seconds", self.total)


class Stale(Stopwatch):
    def start_measurement(self, context):
        self.began = context.clock.now()


class Restless(Stopwatch):
    def stop_measurement(self, context):
        self.seconds = context.clock.now() - (self.began or 0.0)


class Fluctuating(Stopwatch):
    readings = count()

    def populate_run_data(self, context):
        context.publish("Seconds", float(next(self.readings)))


class Crashing(Stopwatch):
    def stop_run(self, context):
        raise RuntimeError("cannot close")


class OrderBound(Stopwatch):
    def populate_run_data(self, context):
        context.publish("Seconds", self.seconds)


class Misdated(Stopwatch):
    def populate_run_data(self, context):
        own = Window(self.began, self.began + self.seconds)
        report_quality(context, quality_of([], own, 1.0), own)
        context.publish("Seconds", self.seconds)


class Dividing(Stopwatch):
    def populate_run_data(self, context):
        context.publish("Seconds", 1.0 / self.seconds)


@pytest.mark.parametrize(
    ("broken", "fact", "complaint"),
    [
        (Nameless, "its_name_can_be_that_of_a_folder", "the plugin has no name"),
        (NotAPlugin, "its_name_can_be_that_of_a_folder", "does not derive from"),
        (Waggon, "it_is_a_profiler", "does not derive from Profiler"),
        (Twins, "its_measures_have_names_of_their_own_and_a_description", "two measures have one name"),
        (Commaless, "its_measures_have_names_of_their_own_and_a_description", r"give a list, such as \[Measure"),
        (Named, "its_measures_have_names_of_their_own_and_a_description", r"give a list, such as \[Measure"),
        (Undescribed, "its_measures_have_names_of_their_own_and_a_description", "has no description"),
        (Deaf, "its_callbacks_can_be_called", "the plugin has no callback"),
        (OddCallback, "its_callbacks_can_be_called", "cannot be called with a context"),
        (Misspelt, "its_callbacks_can_be_called", "Did you mean 'stop_run'"),
        (Refusing, "its_check_finds_nothing_wrong_where_it_works", "refuses the circumstances"),
    ],
)
def test_a_profiler_that_is_made_wrong_breaks_its_contract(broken, fact, complaint):
    with pytest.raises(Exception, match=complaint):
        getattr(profiler_facts(broken), f"test_{fact}")()


def test_a_check_that_returns_no_findings_breaks_the_contract():
    class Facts(ProfilerContract):
        robot = None
        combination: ClassVar = {"Task": "Video"}

        def make_plugin(self):
            return Unhelpful()

    with pytest.raises(AssertionError, match="which is not a Finding"):
        Facts().test_its_check_finds_nothing_wrong_where_it_works()


def test_a_profiler_whose_first_reading_comes_late_keeps_its_contract_on_a_busy_computer(tmp_path):
    profiler_facts(LateToStart).test_a_good_run_publishes_every_measure(tmp_path)


def test_a_profiler_that_withholds_the_value_of_too_few_samples_keeps_its_contract(tmp_path):
    profiler_facts(Starved).test_a_good_run_publishes_every_measure(tmp_path)


@pytest.mark.parametrize(
    ("broken", "fact", "complaint"),
    [
        (Silent, "a_good_run_publishes_every_measure", r"did not publish \['Seconds'\]"),
        (Blind, "a_good_run_publishes_every_measure", "measured nothing in a good run: no value of Seconds"),
        (Unread, "a_good_run_publishes_every_measure", "measured nothing in a good run: no value of Seconds"),
        (Unevaluated, "a_good_run_publishes_every_measure", "measured nothing in a good run: no value of Seconds"),
        (Unitless, "a_good_run_publishes_every_measure", "declares no unit"),
        (Undeclared, "a_good_run_publishes_every_measure", "was not declared"),
        (Intruder, "two_of_its_kind_keep_their_raw_data_apart", "changed files of"),
        (Presumptuous, "closing_what_was_never_opened_does_no_harm", "unsupported operand"),
        (Forgetful, "closing_twice_does_no_harm", "the plugin published"),
        (Restless, "closing_twice_does_no_harm", "the plugin published"),
        (Fluctuating, "closing_twice_does_no_harm", "Where equal runs have other values, .* is_repeatable"),
        (Fluctuating, "values_are_about_the_mission_alone", "Where equal runs have other values, .* is_repeatable"),
        (Stale, "a_second_run_does_not_depend_on_the_first", "the plugin published"),
        (Hoarder, "a_second_run_does_not_depend_on_the_first", "the plugin published"),
        (Crashing, "a_mission_that_fails_is_closed", "cannot close"),
        (Crashing, "a_run_that_never_measured_is_closed", "cannot close"),
        (OrderBound, "values_are_about_the_mission_alone", "depend on the order of the plugins"),
        (Misdated, "values_are_about_the_mission_alone", "has a window from 0.0 to 7.0 s"),
        (Dividing, "a_measurement_of_no_length_does_no_harm", "division by zero"),
        (Silent, "a_measurement_of_no_length_does_no_harm", "the plugin published"),
    ],
)
def test_a_profiler_that_behaves_badly_breaks_its_contract(tmp_path, broken, fact, complaint):
    test = getattr(profiler_facts(broken), f"test_{fact}")
    with pytest.raises(Exception, match=complaint):
        test(tmp_path)


def test_a_profiler_that_writes_elsewhere_breaks_its_contract(tmp_path, monkeypatch):
    with pytest.raises(AssertionError, match="wrote outside its folder"):
        profiler_facts(Litterer).test_it_writes_nothing_outside_its_folder(tmp_path, monkeypatch)


class Runaway(Waggon):
    """It stops at the end of its mission only if nothing fails."""

    def launch_mission(self, context):
        for _ in range(2):
            self.tell(context, 0.1)
            context.clock.sleep(1.0)
            self.drives += 1
        self.tell(context, 0.0)

    def make_safe(self, context): ...


class Unstoppable(Waggon):
    def launch_mission(self, context):
        self.tell(context, 0.1)
        context.clock.sleep(1.0)


class Timeless(Waggon):
    """It has the robot drive as long as others measure, takes no time itself, and cannot be made safe."""

    def launch_mission(self, context):
        self.tell(context, 0.1)

    def stop_measurement(self, context):
        self.tell(context, 0.0)

    def make_safe(self, context): ...


class Stubborn(Waggon):
    """It swallows what breaks its mission off."""

    def launch_mission(self, context):
        try:
            context.clock.sleep(1.0)
        except MissionFailed:
            self.drives = 0


class Fragile(Waggon):
    link = None

    def start_run(self, context):
        self.link = connect_robot(context)
        super().start_run(context)

    def make_safe(self, context):
        self.link.publish("cmd_vel", TWIST, {})


@pytest.mark.parametrize(
    ("broken", "fact", "complaint"),
    [
        (Runaway, "the_robot_stands_still_whenever_the_mission_breaks_off", "still moves after an exception 0.12 s"),
        (Timeless, "the_robot_is_stopped_by_a_process_that_did_not_move_it", "still moves where the run died"),
        (Unstoppable, "the_robot_stands_still_after_a_good_run", "still moves after a good run"),
        (Stubborn, "the_robot_stands_still_whenever_the_mission_breaks_off", "did not end it"),
        (Fragile, "it_can_be_made_safe_at_any_time_and_twice", "has no attribute 'publish'"),
    ],
)
@pytest.mark.parametrize("is_simulated", [False, True])
def test_a_system_that_behaves_badly_breaks_its_contract(tmp_path, broken, fact, complaint, is_simulated):
    facts = system_facts(broken)
    if is_simulated:
        facts.make_links = lambda _: None
    with pytest.raises(Exception, match=complaint):
        getattr(facts, f"test_{fact}")(tmp_path)


def test_a_profiler_is_no_system():
    with pytest.raises(AssertionError, match="does not derive from System"):
        system_facts(Stopwatch).test_it_is_a_system()


def test_the_plugin_that_the_author_has_to_give_is_asked_for():
    with pytest.raises(NotImplementedError, match="write make_plugin"):
        ProfilerContract().make_plugin()
