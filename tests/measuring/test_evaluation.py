from __future__ import annotations

import pytest

from robot_runner.core.errors import MeasureError
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.measuring.evaluation import note_own_window, publish_measures
from robot_runner.plugins import Profiler
from robot_runner.testing import FakeClock, make_context

MEASURES = (
    Measure("Energy", "J", "Energy.", over=Over.SUM),
    Measure("MeanPower", "W", "Mean power.", over=Over.MEAN),
    Measure("Peak", "W", "Peak.", over=Over.MAXIMUM),
    Measure("Least", "W", "Least.", over=Over.MINIMUM),
    Measure("Label", "", "A text."),
)


class Scale(Profiler):
    measures = MEASURES


def evaluate(window):
    """The truth: power is t watts at t seconds."""
    return {
        "Energy": (window.end**2 - window.start**2) / 2,
        "MeanPower": (window.end + window.start) / 2,
        "Peak": window.end,
        "Least": window.start,
        "Label": "linear",
    }


def executed(tmp_path, phases, *steps):
    """Execute a mission of phases: names (None for none) and seconds."""
    clock = FakeClock()
    context = make_context(tmp_path, Scale(), robot=None, clock=clock, phases=phases)
    context.times.begin()
    for name, seconds in steps:
        if name is None:
            clock.sleep(seconds)
        else:
            with context.phase(name):
                clock.sleep(seconds)
    context.times.end()
    return context


def test_measures_are_those_of_the_mission(tmp_path):
    context = executed(tmp_path, (), (None, 4.0))
    publish_measures(context, MEASURES, evaluate, origin=Origin.ESTIMATED)
    assert context.measures == {"Energy": 8.0, "MeanPower": 2.0, "Peak": 4.0, "Least": 0.0, "Label": "linear"}
    assert {each.origin for each in context.broker.measures.values()} == {Origin.ESTIMATED}


def test_a_value_under_a_name_that_no_measure_has_is_told_where_a_measure_lacks_one(tmp_path):
    context = executed(tmp_path, (), (None, 4.0))
    publish_measures(context, MEASURES, lambda window: {**evaluate(window), "Own": 1.0})  # more than is asked for
    assert context.broker.findings == ()
    publish_measures(context, MEASURES, lambda _: {"Enrgy": 8.0, "MeanPower": 2.0})
    (finding,) = context.broker.findings
    assert (
        finding.problem
        == "a value of 'Enrgy' was computed, which is no measure, and none of 'Energy', 'Peak', 'Least' and 'Label'"
    )
    assert finding.fix == "Return the values by the names of the measures."
    assert context.broker.records[-1][1]["measures"] == ["Energy", "Peak", "Least", "Label"]


def test_values_without_names_are_refused(tmp_path):
    context = executed(tmp_path, (), (None, 4.0))
    with pytest.raises(MeasureError, match=r"is 8.0, of type float.*Return a mapping from measure to value"):
        publish_measures(context, MEASURES, lambda _: 8.0)


def test_a_phase_that_comes_twice_has_the_sum_the_weighted_mean_and_the_extremes(tmp_path):
    context = executed(tmp_path, ("drive",), ("drive", 1.0), ("rest", 2.0), ("drive", 3.0))
    publish_measures(context, MEASURES, evaluate)
    found = context.measures
    assert found["Energy.drive"] == pytest.approx(0.5 + (36 - 9) / 2)
    assert found["MeanPower.drive"] == pytest.approx(found["Energy.drive"] / 4.0)
    assert (found["Peak.drive"], found["Least.drive"]) == (6.0, 0.0)
    assert "Label.drive" not in found
    assert "Energy.rest" not in found


def test_a_phase_that_did_not_come_has_no_value(tmp_path):
    context = executed(tmp_path, ("dock",), (None, 1.0))
    publish_measures(context, MEASURES, evaluate)
    assert context.measures["Energy.dock"] is None


def test_a_phase_of_which_a_part_is_unknown_has_no_value(tmp_path):
    context = executed(tmp_path, ("drive",), ("drive", 1.0), ("drive", 1.0))
    publish_measures(context, MEASURES, lambda window: evaluate(window) if window.start == 0.0 else {})
    assert context.measures["Energy.drive"] is None


def test_a_mission_of_no_length_has_no_value(tmp_path):
    context = executed(tmp_path, ())
    publish_measures(context, MEASURES, evaluate)
    assert set(context.measures.values()) == {None}


def test_an_own_window_is_doubted_from_one_per_cent_on(tmp_path):
    context = executed(tmp_path, (), (None, 30.0))
    note_own_window(context, Window(0.0, 30.2))
    assert context.broker.findings == ()
    note_own_window(context, Window(-1.0, 30.0), measures=["Energy"])
    [finding] = context.broker.findings
    assert "31.000 s" in finding.problem
    assert "30.000 s" in finding.problem
    assert context.broker.records[-1][1]["measures"] == ["Energy"]


def test_where_the_window_was_narrowed_the_advice_about_an_own_window_is_to_measure_the_whole_mission(tmp_path):
    clock = FakeClock()
    context = make_context(tmp_path, Scale(), robot=None, clock=clock)
    context.times.begin()
    clock.sleep(2.0)
    context.begin_window()  # as PlayBag(by="program") does
    clock.sleep(3.0)
    context.times.end()
    note_own_window(context, Window(0.0, 5.0))
    [finding] = context.broker.findings
    assert "PlayBag(by='program') narrow it" in finding.fix


def test_a_doubt_is_about_all_measures_of_its_owner_where_it_names_none(tmp_path):
    context = executed(tmp_path, ("drive",), ("drive", 1.0))
    context.doubt("the sensor is cold", fix="Warm it.")
    kind, fields = context.broker.records[-1]
    assert kind == "finding"
    assert fields["measures"][:2] == ["Energy", "MeanPower"]
    assert "Energy.drive" in fields["measures"]
    with pytest.raises(MeasureError, match="'Enrgy' was not declared"):
        context.doubt("odd", measures=["Enrgy"])
