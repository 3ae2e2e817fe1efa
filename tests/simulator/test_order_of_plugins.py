"""The order of plugins, and what others do before and after the mission, changes no value: to the last digit."""

from __future__ import annotations

import json
from itertools import permutations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robot_runner.plugins import Profiler
from robot_runner.plugins.profilers import Battery, Ina219, PowerModel, PsUtil, RosTopics
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.testing import make_context, rehearse

PHASES = ("forward", "task")


class Slow(Profiler):
    """Takes its time to start and to stop, and measures nothing."""

    def __init__(self, name: str | None = None, before: float = 3.0, after: float = 3.0) -> None:
        super().__init__(name=name)
        self.before, self.after = before, after

    def start_measurement(self, context):
        context.clock.sleep(self.before)

    def stop_measurement(self, context):
        context.clock.sleep(self.after)


def turtlebot3():
    return BasicTurtlebot3(sleep_s=0.3, drive_s=1.5, task_s=1.0, rotate_s=3.0)


def values(folder, profilers):
    """Execute a short mission on the embedded robot; return its values and the windows that the profilers told of."""
    plugins = [turtlebot3(), *profilers]
    context = make_context(folder, *plugins, combination={"Task": "Video"}, phases=PHASES)
    try:
        published = dict(rehearse(context, *plugins))
    finally:
        context.resources.close()
    notes = [context.run_path / each.name / "quality.json" for each in profilers]
    told = [json.loads(note.read_text())["window"] for note in notes if note.exists()]
    assert context.window is not None
    return published, told, context.window


@pytest.mark.long
def test_the_order_of_plugins_changes_no_value(tmp_path):
    model = {"constant": 7.6, "cpu": 0.02, "motion:forward": 2.5}
    makers = (Ina219, PsUtil, Battery, lambda: RosTopics({"odom": 30.0}), lambda: PowerModel(coefficients=model))
    orders = [makers, makers[::-1], makers[2:] + makers[:2]]
    found = [values(tmp_path / str(place), [make() for make in order])[0] for place, order in enumerate(orders)]
    assert all(value is not None for name, value in found[0].items() if "Jitter" not in name)
    assert found[1] == found[0]
    assert found[2] == found[0]


@pytest.mark.long
def test_a_slow_neighbour_changes_no_value_wherever_it_is_listed(tmp_path):
    orders = list(permutations((Ina219, PsUtil, Slow)))
    found = [values(tmp_path / str(place), [make() for make in order]) for place, order in enumerate(orders)]
    for published, told, window in found:
        assert published == found[0][0]
        assert len(told) == 2
        for each in told:
            assert each == {"start": window.start, "end": window.end}
    assert found[0][0]["Energy.task"] > 0


@pytest.mark.long
def test_what_a_neighbour_does_after_the_mission_changes_no_value(tmp_path):
    quick, _, _ = values(tmp_path / "quick", [Ina219(), PsUtil(), Battery(), Slow(after=0.0)])
    slow, _, _ = values(tmp_path / "slow", [Ina219(), PsUtil(), Battery(), Slow(after=7.3)])
    assert slow == quick


def test_a_later_mission_is_another_one_of_the_same_energy(tmp_path):
    """Its moments are others, so that noise differs, and its battery is emptier: that is physics, not the window."""
    at_once, _, _ = values(tmp_path / "at once", [Ina219(), PsUtil()])
    later, _, _ = values(tmp_path / "later", [Slow(), Ina219(), PsUtil()])
    for name in ("Energy", "EnergyPt", "MeanPower"):
        assert later[name] == pytest.approx(at_once[name], rel=0.01)
    assert later["Duration"] == pytest.approx(at_once["Duration"], abs=0.01)


@pytest.mark.long
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 4_000_000))
def test_it_does_not_matter_at_which_microsecond_a_meter_is_opened(tmp_path, microseconds):
    """A mission at one and the same moment, with meters that were opened at any moment before it."""
    seconds = microseconds / 1e6

    def measured(before):
        plugins = [Ina219(), PsUtil()]
        context = make_context(tmp_path, *plugins)
        order = [Slow("Before", before, 0.0), *plugins, Slow("Behind", 5.0 - before, 0.0)]
        try:
            return dict(rehearse(context, *order, mission=lambda: context.clock.sleep(1.0)))
        finally:
            context.resources.close()

    assert measured(seconds) == measured(0.0)
