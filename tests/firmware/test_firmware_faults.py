"""What the meter does when something goes wrong, and what the profiler says of it."""

from __future__ import annotations

import csv

import pytest
from tests.firmware.measuring import VOLTS, Steps, measure, metered

from robot_runner.core.errors import LinkError
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import rehearse

STEADY = Steps(((0.0, 0.8),))


def test_unplugging_fails_the_run_and_keeps_the_samples(board, tmp_path):
    with board(load=STEADY.words, volts=VOLTS, seconds=3.0) as meter:
        profiler = Ina219(port=meter.port)
        context = metered(meter, tmp_path, profiler)
        with pytest.raises(LinkError, match="unplugged") as caught:
            rehearse(context, profiler, mission=lambda: meter.clock.sleep(10.0))
        context.resources.close()
    assert meter.port in caught.value.problem
    assert "then repeat the run" in caught.value.fix
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        powers = [float(row["power_W"]) for row in csv.DictReader(file)]
    assert len(powers) > 550
    assert powers[-1] == pytest.approx(0.8 * VOLTS, rel=1e-3)


def test_a_board_that_was_reset_by_opening_its_port_measures_the_next_run(board, tmp_path):
    with board(load=STEADY.words, volts=VOLTS, openings=2) as meter:
        energies = [measure(meter, tmp_path / "first", 2.0).context.measures["Energy"]]
        meter.clock.await_closing(1)
        energies += [measure(meter, tmp_path / "second", 2.0).context.measures["Energy"]]
    assert energies == pytest.approx([0.8 * VOLTS * 2.0] * 2, rel=1e-3)


@pytest.mark.long
def test_samples_that_the_sensor_did_not_give_use_up_their_numbers(board, tmp_path):
    with board(load=STEADY.words, volts=VOLTS, away="3,3.5") as meter:
        measured = measure(meter, tmp_path, 12.0)
    samples = measured.quality["samples"]
    assert 95 <= samples["lost"] <= 102
    assert samples["got"] + samples["lost"] == pytest.approx(2400, abs=2)
    assert abs(measured.error_of("Energy", STEADY)) < 0.005  # a short gap is bridged


def test_a_sensor_that_is_not_connected_yields_no_value_and_is_named(board, tmp_path):
    with board(load=STEADY.words, volts=VOLTS, away="0.001") as meter:
        measured = measure(meter, tmp_path, 2.0)
    assert set(measured.context.measures.values()) == {None}
    assert measured.problems == [
        "no sample arrived in the measured window, where 400 were expected",
        "the power meter answered, its sensor did not: look at the four wires between them",
    ]


@pytest.mark.long
def test_a_sensor_that_lost_its_power_is_configured_again(board, tmp_path):
    with board(load=STEADY.words, volts=VOLTS, faint="2.5") as meter:
        measured = measure(meter, tmp_path, 5.0)
    assert measured.quality["hello"]["configuration"] == 0x19DD
    assert measured.problems == [
        "the sensor was without power for a moment and measured in another range for up to a second"
    ]
    assert abs(measured.error_of("Energy", STEADY)) < 0.005


def test_a_battery_above_16_volts_needs_the_wide_range(board, tmp_path):
    with board(load=STEADY.words, volts=17.0) as meter:
        measured = measure(meter, tmp_path, 1.0)
    assert any("at the end of the sensor's range" in problem for problem in measured.problems)
