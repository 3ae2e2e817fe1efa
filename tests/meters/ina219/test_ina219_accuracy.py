from __future__ import annotations

import math

import pytest
from tests.meters.scripted_meter import ScriptedMeter

from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import FakeClock, FakeLinks, FakeSerialLine, make_context, rehearse

SECONDS = 95.0
BEGUN = 100.0


def constant(_: float) -> float:
    return 9.2


def stepped(time: float) -> float:
    return 7.6 if time < BEGUN + 15.2 else 10.5 if time < BEGUN + 40.1 else 8.25


def waved(time: float) -> float:
    return 9.0 + 1.5 * math.sin(2 * math.pi * 3.0 * (time - BEGUN))


def measured(tmp_path, meter: ScriptedMeter, seconds: float = SECONDS, **parameters):
    """Measure for `seconds` from a little after BEGUN, and return the context and the window's start."""
    clock = FakeClock(BEGUN)
    line = FakeSerialLine(clock, meter.chunks(start=BEGUN - 1.0, end=BEGUN + seconds + 1.0))
    profiler = Ina219(**parameters)
    context = make_context(tmp_path, profiler, links=FakeLinks(serial=line), clock=clock)
    rehearse(context, profiler, mission=lambda: clock.sleep(seconds))
    return context


@pytest.mark.long
@pytest.mark.parametrize(
    ("power", "joules"),
    [
        (constant, 9.2 * SECONDS),
        (stepped, 7.6 * 15.2 + 10.5 * 24.9 + 8.25 * 54.9),
        (waved, 9.0 * SECONDS),
    ],
)
@pytest.mark.parametrize("skew", [0.0, 0.005])
def test_energy_is_right_within_a_thousandth(tmp_path, power, joules, skew):
    context = measured(tmp_path, ScriptedMeter(power, skew=skew))
    assert context.measures["Energy"] == pytest.approx(joules, rel=1e-3)
    assert context.measures["EnergyPt"] == pytest.approx(joules, rel=1e-3)
    assert context.measures["MeanPower"] == pytest.approx(joules / SECONDS, rel=1e-3)
    assert context.broker.findings == ()


@pytest.mark.parametrize("seconds", [1.0, 1.0021, 1.0049])
def test_the_edges_of_the_window_are_not_rounded_to_samples(tmp_path, seconds):
    context = measured(tmp_path, ScriptedMeter(constant), seconds)
    assert context.measures["Energy"] == pytest.approx(9.2 * seconds, rel=1e-4)


def test_single_lost_samples_are_told_and_hardly_matter(tmp_path):
    lost, damaged = {500, 900, 901}, {700, 5000}
    context = measured(tmp_path, ScriptedMeter(constant, left_out=lost, damaged=damaged))
    assert context.measures["Energy"] == pytest.approx(9.2 * SECONDS, rel=1e-4)
    assert [finding.problem for finding in context.broker.findings] == [
        "5 samples were lost",
        "2 samples were damaged and left out",
    ]


def test_energy_by_the_paper_differs_where_samples_are_missing_and_the_integral_does_not(tmp_path):
    quiet = set(range(4000, 4600))  # three seconds of 10.5 W unseen
    context = measured(tmp_path, ScriptedMeter(stepped, left_out=quiet))
    exact = 7.6 * 15.2 + 10.5 * 24.9 + 8.25 * 54.9
    assert context.measures["Energy"] == pytest.approx(exact, rel=1e-3)
    assert context.measures["EnergyPt"] != pytest.approx(exact, rel=1e-3)


def test_the_shunt_that_the_device_tells_of_is_reckoned_with(tmp_path):
    twice = measured(tmp_path, ScriptedMeter(constant, micro_ohm=50_000), 2.0)
    assert twice.measures["MeanPower"] == pytest.approx(2 * 9.2, rel=1e-3)


def test_without_a_hello_the_papers_figures_hold(tmp_path):
    context = measured(tmp_path, ScriptedMeter(constant, says_hello=False), 2.0)
    assert context.measures["MeanPower"] == pytest.approx(9.2, rel=1e-3)
