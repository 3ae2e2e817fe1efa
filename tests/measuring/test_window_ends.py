from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise

import pytest

from robot_runner.core.events.context import PROBE
from robot_runner.core.events.measure import Measure, Over
from robot_runner.core.events.window import Window
from robot_runner.measuring.evaluation import WindowEnds, publish_measures
from robot_runner.measuring.series import Series, growth, mean_of_intervals
from robot_runner.plugins import Profiler
from robot_runner.testing import FakeClock, make_context

ENERGY = Measure("Energy", "J", "Energy.", over=Over.SUM)
POWER = Measure("MeanPower", "W", "Mean power.", over=Over.MEAN)
PEAK = Measure("Peak", "W", "Peak.", over=Over.MAXIMUM)
CPU = Measure("CPU", "%", "Utilisation.", over=Over.MEAN)
MEASURES = (ENERGY, POWER, PEAK)


class Load:
    """A load of steps, its exact counter that is read now and then, and what a profiler makes of the readings."""

    def __init__(self, *steps, times):
        self.steps, self.times = steps, times  # each step: until when, s, and W

    def joules(self, time):
        total = begun = 0.0
        for until, watts in self.steps:
            total += watts * max(0.0, min(time, until) - begun)
            begun = until
        return total

    def evaluate(self, window):
        joules = growth(Series(self.times, [self.joules(time) for time in self.times]), window)
        return {"Energy": joules, "MeanPower": joules / window.duration, "Peak": 25.0}

    def off(self, window):
        truth = self.joules(window.end) - self.joules(window.start)
        return abs(self.evaluate(window)["Energy"] / truth - 1)

    def doubts(self, *windows):
        return list(WindowEnds(self.times, self.evaluate, MEASURES).doubts_about_phase("lift", windows))


def every(seconds, first=-0.4, last=60.0):
    return [first + seconds * number for number in range(int((last - first) / seconds) + 1)]


BURST = (10.0, 5.0), (14.0, 25.0), (60.0, 5.0)
LIFT = Window(10.0, 14.0)


def test_a_phase_is_doubted_where_power_changes_at_ends_that_lie_between_samples():
    load = Load(*BURST, times=every(1.0))
    assert load.off(LIFT) > 0.05
    [(problem, names)] = load.doubts(LIFT)
    assert names == ["Energy", "MeanPower"]
    assert problem == (
        "phase 'lift' begins and ends between samples that are 1 s apart, and much changes there: "
        "values may be off by 17 %"
    )


@pytest.mark.parametrize(
    "load",
    [
        Load(*BURST, times=every(0.1)),
        Load((60.0, 25.0), times=every(1.0)),
        Load((9.0, 24.0), (60.0, 25.0), times=every(1.0)),
    ],
    ids=["sampled often", "nothing changes", "little changes"],
)
def test_a_phase_is_not_doubted_where_its_ends_hide_little(load):
    assert load.off(LIFT) < 0.05
    assert load.doubts(LIFT) == []


def test_a_phase_between_two_samples_is_doubted_whatever_it_is_said_to_be():
    load = Load((60.0, 5.0), times=every(1.0))
    [(problem, names)] = load.doubts(Window(10.7, 11.5))
    assert problem == "phase 'lift' took 0.8 s, with 0 samples in it: its values are also those of what is beside it"
    assert names == ["Energy", "MeanPower", "Peak"]


def test_one_short_visit_of_a_long_phase_is_no_reason_to_doubt_it():
    load = Load((60.0, 5.0), times=every(1.0))
    assert load.doubts(Window(2.0, 32.0), Window(40.7, 41.5)) == []
    assert len(load.doubts(Window(2.0, 6.0), Window(40.7, 41.5))) == 1


def test_what_draws_nothing_beside_what_draws_much_is_doubted():
    load = Load((10.0, 0.0), (60.0, 25.0), times=every(1.0))
    [(problem, _)] = load.doubts(Window(6.0, 10.0))
    assert problem.endswith("values may be off by 100 %")


def test_a_phase_that_has_no_value_is_not_said_to_be_off():
    load = Load(*BURST, times=every(0.1))
    ends = WindowEnds(load.times, lambda window: {} if window == LIFT else load.evaluate(window), MEASURES)
    told = [("samples leave out too much of phase 'lift' for a value", ["Energy", "MeanPower"])]
    assert list(ends.doubts_about_phase("lift", [LIFT])) == told


def test_a_percentage_is_doubted_from_a_point_on():
    def doubts(busy, end=11.05):
        times = every(0.1)
        shares = Series(times, [busy if 10.0 < time <= 11.1 else 0.2 for time in times])
        ends = WindowEnds(times, lambda window: {"CPU": mean_of_intervals(shares, window)}, [CPU])
        return list(ends.doubts_about_phase("plan", [Window(10.02, end)]))

    assert doubts(10.0) == []
    assert len(doubts(80.0)) == 1
    assert len(doubts(40.0, end=10.45)) == 1  # 1.6 %·s are 3.7 points of so short a phase


def test_a_mission_whose_ends_were_read_is_not_doubted_and_one_between_two_readings_is():
    load, window = Load((10.0, 5.0), (13.0, 50.0), (60.0, 5.0), times=every(1.0)), Window(10.0, 13.0)
    read = Load(*load.steps, times=sorted([*load.times, window.start - 0.001, window.end + 0.001]))
    assert load.off(window) > 0.05
    assert read.off(window) < 0.01
    [(problem, _)] = WindowEnds(load.times, load.evaluate, MEASURES).doubts_about_mission(window)
    assert problem.startswith("the mission begins and ends between samples")
    assert list(WindowEnds(read.times, read.evaluate, MEASURES).doubts_about_mission(window)) == []


@pytest.mark.parametrize("times", [[], [10.5], [3.0, 4.0], [12.0, 12.0]], ids=["none", "one", "before", "at once"])
def test_samples_that_tell_nothing_of_an_end_fail_nothing(times):
    load = Load(*BURST, times=times)
    ends = WindowEnds(times, lambda window: {"Energy": None, "MeanPower": True, "Peak": "high"}, MEASURES)
    assert list(ends.doubts_about_mission(LIFT)) == []
    assert len(load.times) < 3


@pytest.mark.long
def test_drawn_phases_that_are_off_are_doubted():
    draw = random.Random(7)  # noqa: S311 - no secret
    unnoticed, noticed = [], 0
    for _ in range(20):
        steps = [(3.0 + draw.random(), 6.0)]
        for _ in range(8):
            steps.append((steps[-1][0] + draw.uniform(1.0, 8.0), draw.uniform(5.0, 25.0)))
        load = Load(*steps, (200.0, 6.0), times=every(1.0, last=199.0))
        for (start, _), (end, _) in pairwise(steps):
            off, is_doubted = load.off(Window(start, end)), bool(load.doubts(Window(start, end)))
            noticed += off > 0.05 and is_doubted
            unnoticed += [off] if off > 0.05 and not is_doubted else []
    assert noticed > 30
    assert max(unnoticed, default=0.0) < 0.08


class Meter(Profiler):
    measures = MEASURES


def test_doubts_about_a_phase_are_kept_with_its_values_alone(tmp_path):
    load, clock = Load(*BURST, times=every(1.0)), FakeClock()
    context = make_context(tmp_path, Meter(), robot=None, clock=clock, phases=["lift", "dock"])
    context.times.begin()
    clock.sleep(10.0)
    with context.phase("lift"):
        clock.sleep(4.0)
    clock.sleep(20.0)
    context.times.end()
    publish_measures(context, MEASURES, load.evaluate, times=load.times)
    [finding] = [fields for kind, fields in context.broker.records if kind == "finding"]
    assert finding["measures"] == ["Energy.lift", "MeanPower.lift"]
    assert finding["fix"] == "Have the meter sample more often, or what is measured last longer."


def test_a_probe_has_no_mission_at_whose_ends_anything_changes(tmp_path):
    load, clock = Load((10.0, 5.0), (13.0, 50.0), (60.0, 5.0), times=every(1.0)), FakeClock()
    context = make_context(tmp_path, Meter(), robot=None, clock=clock)
    clock.sleep(10.0)
    context.times.begin()
    clock.sleep(3.0)
    context.times.end()
    publish_measures(replace(context, run_id=PROBE), MEASURES, load.evaluate, times=load.times)
    assert context.broker.findings == ()
    publish_measures(context, MEASURES, load.evaluate, times=load.times)
    assert len(context.broker.findings) == 1
