"""Known currents into the sensor, joules out of the profiler; between them the firmware and a serial line."""

from __future__ import annotations

import json
import time

import pytest
from tests.firmware.measuring import MISSION, SWING, VOLTS, Steps, measure
from tests.long_cases import soak_but

from robot_runner.core.events.context import SystemClock
from robot_runner.plugins import Profiler
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import make_context, rehearse

WATTS = 0.865 * VOLTS  # 9.6 W
PROMISED_OF_ORDER = 0.0005  # parts of one
PROMISED = 0.005  # parts of one
PROMISED_WHEN_CORRUPT = 0.01


@pytest.mark.parametrize(("load", "seconds"), [(MISSION, 17), (SWING, 5)], ids=["stepped", "sinusoidal"])
def test_energy_is_right_and_no_sample_is_lost(board, tmp_path, load, seconds):
    with board(load=load.words, volts=VOLTS) as meter:
        measured = measure(meter, tmp_path, seconds)
    assert abs(measured.error_of("Energy", load)) < PROMISED / 5
    assert abs(measured.error_of("EnergyPt", load)) < PROMISED / 5
    assert measured.quality["samples"]["got"] == pytest.approx(200 * seconds, abs=2)
    assert measured.quality["samples"]["lost"] == 0
    assert measured.problems == []


@pytest.mark.long
@pytest.mark.parametrize("skew", soak_but([0.005], [-0.005, 0.005]))
def test_a_resonator_that_is_half_a_percent_off_hardly_matters(board, tmp_path, skew):
    with board(load=MISSION.words, volts=VOLTS, skew=skew) as meter:
        measured = measure(meter, tmp_path, 17.0)
    assert abs(measured.error_of("Energy", MISSION)) < PROMISED / 5
    assert measured.problems == []


@pytest.mark.long
@pytest.mark.parametrize("load", soak_but([MISSION], [MISSION, SWING]), ids=["stepped", "sinusoidal"])
def test_energy_is_right_where_one_byte_in_a_hundred_is_corrupt(board, tmp_path, load):
    with board(load=load.words, volts=VOLTS, corrupt=0.01, seed=7) as meter:
        measured = measure(meter, tmp_path, 8.0)
    assert abs(measured.error_of("Energy", load)) < PROMISED_WHEN_CORRUPT
    assert any("lost" in problem for problem in measured.problems)


def test_a_current_beyond_the_range_is_told_and_one_within_it_is_not(board, tmp_path):
    with board(load=Steps(((0.0, 3.1), (1.5, 3.3))).words, volts=VOLTS) as meter:
        measured = measure(meter, tmp_path, 2.0)
    saturated = measured.quality["samples"]["saturated"]
    assert 90 < saturated < 120
    assert any(f"{saturated} samples were at the end of the sensor's range" in each for each in measured.problems)


@pytest.mark.long
def test_another_shunt_is_reckoned_with(board, tmp_path):
    with board(load=MISSION.words, volts=VOLTS, shunt=0.05) as meter:
        measured = measure(meter, tmp_path, 6.0, shunt_ohm=0.05)
    assert abs(measured.error_of("Energy", MISSION)) < PROMISED
    assert measured.problems == ["the power meter reports that its shunt has 0.1 ohm, not 0.05 ohm"]


def test_it_measures_in_real_time_as_a_real_meter_does(free_board, tmp_path):
    load = Steps(((0.0, 0.8),))
    with free_board(load=load.words, volts=VOLTS, pace=1) as meter:
        profiler, clock = Ina219(port=meter.port), SystemClock()
        context = make_context(tmp_path, profiler, robot=None, clock=clock)
        begun = time.monotonic()
        measures = dict(rehearse(context, profiler, mission=lambda: clock.sleep(2.0)))
        took = time.monotonic() - begun
        context.resources.close()
    assert measures["MeanPower"] == pytest.approx(0.8 * VOLTS, rel=PROMISED)
    assert measures["Energy"] == pytest.approx(0.8 * VOLTS * 2.0, rel=0.05)
    assert took < 30


class Late(Profiler):
    """Needs 3 s to start and 1 s to stop."""

    def start_measurement(self, context):
        context.clock.sleep(3.0)

    def stop_measurement(self, context):
        context.clock.sleep(1.0)


@pytest.mark.long
@pytest.mark.parametrize("is_late_first", [True, False], ids=["before", "behind"])
def test_a_profiler_that_starts_late_changes_no_energy_in_real_time(free_board, tmp_path, is_late_first):
    with free_board(load=Steps(((0.0, 0.865),)).words, volts=VOLTS, pace=1) as meter:
        profiler, clock = Ina219(port=meter.port), SystemClock()
        plugins = [Late(), profiler] if is_late_first else [profiler, Late()]
        context = make_context(tmp_path, profiler, robot=None, clock=clock)
        measures = dict(rehearse(context, *plugins, mission=lambda: clock.sleep(2.0)))
        context.resources.close()
    told = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    assert context.window is not None
    assert context.window.duration == pytest.approx(2.0, abs=0.5)  # a busy machine sleeps longer
    assert told["start"] == pytest.approx(context.window.start, abs=0.001)
    assert told["end"] == pytest.approx(context.window.end, abs=0.001)
    for name in ("Energy", "EnergyPt"):
        assert measures[name] == pytest.approx(WATTS * context.window.duration, rel=PROMISED_OF_ORDER)
