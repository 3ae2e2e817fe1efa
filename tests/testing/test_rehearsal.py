from __future__ import annotations

import threading

import pytest

from robot_runner.core.errors import ConfigError, MeasureError, PluginError
from robot_runner.core.events.early_end import RunFailed
from robot_runner.core.events.measure import Measure
from robot_runner.plugins import Profiler, System, treatment
from robot_runner.testing import make_context, rehearse

EVENTS = ("start_run", "start_measurement", "launch_mission", "stop_measurement", "stop_run", "populate_run_data")


def recorder(kind, name, journal, fails_at=None):
    """Return a plugin that notes each event that it hears, and may fail at one."""

    def callback(event):
        def hear(self, context):
            journal.append((self.name, event))
            if event == fails_at:
                raise RuntimeError(event)

        return hear

    methods = {event: callback(event) for event in EVENTS}
    if kind is System:
        methods["make_safe"] = lambda self, context: journal.append((self.name, "make_safe"))
    return type(name.title(), (kind,), methods)(name=name)


def test_events_come_in_order_and_closing_ones_in_reverse(tmp_path):
    journal = []
    profiler, system = recorder(Profiler, "meter", journal), recorder(System, "robot", journal)
    rehearse(make_context(tmp_path, profiler, system, robot=None), profiler, system)
    assert [event for name, event in journal if name == "robot"] == list(EVENTS)
    assert [name for name, event in journal if event == "start_run"] == ["robot", "meter"]
    assert [name for name, event in journal if event == "stop_run"] == ["meter", "robot"]


@pytest.mark.parametrize("event", EVENTS[:3])
def test_whatever_fails_is_closed_and_made_safe_before_it_is_raised(tmp_path, event):
    journal = []
    robot = recorder(System, "robot", journal, fails_at=event)
    with pytest.raises(RuntimeError, match=event):
        rehearse(make_context(tmp_path, robot, robot=None), robot)
    heard = [each for _, each in journal]
    assert heard[-2:] == ["stop_run", "make_safe"]
    assert ("stop_measurement" in heard) == (event != "start_run")
    assert "populate_run_data" not in heard


def test_the_mission_happens_between_start_and_stop_of_the_measurement(tmp_path):
    journal = []
    meter = recorder(Profiler, "meter", journal)
    context = make_context(tmp_path, meter, robot=None)
    rehearse(context, meter, mission=lambda: journal.append(("mission", "mission")))
    assert [event for _, event in journal][1:5] == [
        "start_measurement",
        "launch_mission",
        "mission",
        "stop_measurement",
    ]


def test_what_was_published_is_returned(tmp_path):
    class Publishing(Profiler):
        measures = (Measure("Mass", "kg", "Mass of the robot."),)

        def populate_run_data(self, context):
            context.publish("Mass", 1.0)

    scale = Publishing()
    assert dict(rehearse(make_context(tmp_path, scale, robot=None), scale)) == {"Mass": 1.0}


class Scale(Profiler):
    measures = (Measure("Mass", "kg", "Mass of the robot."),)

    def __init__(self, mass):
        super().__init__()
        self.mass = mass

    def populate_run_data(self, context):
        return self.mass


def test_what_populating_returns_is_published_as_in_a_run(tmp_path):
    scale = Scale({"Mass": 1.0})
    assert dict(rehearse(make_context(tmp_path, scale, robot=None), scale)) == {"Mass": 1.0}
    for wrong, problem in (({"Mas": 1.0}, "Mas"), (3, "returned 3")):
        scale = Scale(wrong)
        with pytest.raises(MeasureError, match=problem):
            rehearse(make_context(tmp_path, scale, robot=None), scale)


def test_a_mission_that_is_stopped_early_is_no_failure(tmp_path):
    journal = []
    robot, scale = recorder(System, "robot", journal), Scale({"Mass": 1.0})
    context = make_context(tmp_path, robot, scale, robot=None)
    measures = rehearse(context, robot, scale, mission=lambda: context.stop_mission("it is there"))
    assert measures == {"Mass": 1.0}
    assert [event for _, event in journal][-3:] == ["stop_run", "make_safe", "populate_run_data"]


class Polling(Profiler):
    """A profiler with a thread of its own, which does something during the mission, or while it is ended."""

    measures = (Measure("Mass", "kg", "Mass of the robot."),)

    def __init__(self, act, *, is_late=False):
        super().__init__()
        self.act, self.is_late = act, is_late

    def start_measurement(self, context):
        self.may_act = threading.Event()
        self.thread = threading.Thread(target=self.poll, args=(context,), name="poll")
        self.thread.start()

    def poll(self, context):
        self.may_act.wait()
        self.act(context)

    def launch_mission(self):
        if not self.is_late:
            self.end()

    def stop_measurement(self):
        self.end()

    def end(self):
        self.may_act.set()
        self.thread.join()

    def populate_run_data(self):
        return {"Mass": 1.0}


def read_nothing(_context):
    raise OSError("the sensor is gone")


@pytest.mark.parametrize(
    ("act", "problem"), [(read_nothing, "the sensor is gone"), (lambda context: context.fail("too warm"), "too warm")]
)
def test_a_thread_fails_a_rehearsal_as_it_fails_a_run(tmp_path, act, problem):
    profiler, hook = Polling(act), threading.excepthook
    context = make_context(tmp_path, profiler, robot=None)
    with pytest.raises((OSError, RunFailed), match=problem):
        rehearse(context, profiler)
    assert (dict(context.measures), threading.excepthook) == ({}, hook)


def test_a_thread_of_an_earlier_run_fails_no_rehearsal(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(threading, "excepthook", lambda raised: told.append(raised.exc_value))
    earlier, profiler = Polling(read_nothing), Polling(lambda context: None)
    earlier.start_measurement(None)
    context = make_context(tmp_path, profiler, robot=None)
    assert dict(rehearse(context, profiler, mission=earlier.end)) == {"Mass": 1.0}
    assert ([str(each) for each in told], context.broker.findings) == (["the sensor is gone"], ())


def test_a_thread_ends_a_mission_early(tmp_path):
    profiler = Polling(lambda context: context.stop_mission("arrived"))
    context = make_context(tmp_path, profiler, robot=None)
    assert dict(rehearse(context, profiler)) == {"Mass": 1.0}


def test_a_thread_that_fails_while_it_is_closed_is_a_finding_as_in_a_run(tmp_path):
    profiler = Polling(read_nothing, is_late=True)
    context = make_context(tmp_path, profiler, robot=None)
    assert dict(rehearse(context, profiler)) == {"Mass": 1.0}
    (finding,) = context.broker.findings
    assert finding.problem == "thread poll raised OSError: the sensor is gone"


def test_who_was_not_reached_by_an_opening_event_is_not_closed(tmp_path):
    journal = []
    first = recorder(System, "first", journal, fails_at="start_run")
    second = recorder(System, "second", journal)
    with pytest.raises(RuntimeError, match="start_run"):
        rehearse(make_context(tmp_path, first, second, robot=None), first, second)
    assert ("first", "stop_run") in journal
    assert [event for name, event in journal if name == "second"] == ["make_safe"]


def test_all_systems_are_made_safe_although_one_cannot_be(tmp_path):
    class Stuck(System):
        def make_safe(self, context):
            raise OSError("stuck")

    journal = []
    robot = recorder(System, "robot", journal, fails_at="populate_run_data")
    with pytest.raises(OSError, match="stuck"):
        rehearse(make_context(tmp_path, robot, robot=None), robot, Stuck())
    assert journal[-1] == ("robot", "make_safe")


def test_a_callback_with_a_wrong_signature_is_refused(tmp_path):
    class Odd(Profiler):
        def start_run(self, context, extra): ...

    with pytest.raises(ConfigError, match="cannot be called with a context"):
        rehearse(make_context(tmp_path, Odd(), robot=None), Odd())


class Lamp(System):
    """Has the power that it was built with, and reads nothing."""

    def __init__(self, power):
        super().__init__()
        self.power = power

    def launch_mission(self, context):
        context.share(power=self.power)


def test_bound_parameters_have_the_treatments_of_the_context(tmp_path):
    lamp = Lamp(treatment("Power"))
    for power in (1, 2):
        context = make_context(tmp_path, lamp, robot=None, combination={"Power": power})
        rehearse(context, lamp)
        assert context.plugin_data["Lamp"]["power"] == power
        assert context.broker.findings == ()


def test_a_combination_without_a_bound_factor_is_refused_with_the_nearest(tmp_path):
    with pytest.raises(PluginError, match=r"the run has no treatment of the factor 'Power'.*'power'"):
        make_context(tmp_path, Lamp(treatment("Power")), robot=None, combination={"power": 1})


def test_a_factor_that_nobody_looks_at_is_found(tmp_path):
    lamp = Lamp(1)
    context = make_context(tmp_path, lamp, robot=None, combination={"Power": 2, "Floor": "wood"})
    rehearse(context, lamp, mission=lambda: context.combination["Floor"])
    (finding,) = context.broker.findings
    assert finding.problem == "no callback and no plugin looked at Power: its treatments may never have been applied"
    assert "treatment('Power')" in finding.fix


def test_a_phase_that_the_mission_did_not_have_is_warned_of_as_in_a_run(tmp_path):
    class Driver(System):
        def launch_mission(self, context):
            with context.phase("navigate"):
                context.clock.sleep(1.0)

    driver = Driver()
    context = make_context(tmp_path, driver, robot=None, phases=("navigate", "navigat"))
    rehearse(context, driver)
    warned = [fields for kind, fields in context.broker.records if kind == "finding"]
    assert [each["problem"] for each in warned] == ["the mission had no phase 'navigat'"]
    assert warned[0]["fix"] == "Did you mean 'navigate'?"
