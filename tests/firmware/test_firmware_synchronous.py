"""Loads that beat in step with something: with the samples, with the sensor's own conversions, or faster than both."""

from __future__ import annotations

import pytest
from tests.firmware.measuring import OWN_HERTZ, VOLTS, Pulses, Sine, measure
from tests.long_cases import soak_but

PROMISED = 0.025  # parts of one

IN_STEP_WITH_THE_SAMPLES = [
    *(Sine(0.8, 0.4, 200.0, phase) for phase in (0.0, 0.25, 0.5, 0.75)),
    *(Pulses(0.0, 1.0, 200.0, 0.1, phase) for phase in (0.0, 0.2, 0.4, 0.6, 0.8)),
    *(Pulses(0.2, 1.4, 400.0, 0.5, phase) for phase in (0.0, 0.25, 0.5, 0.75)),
]
#: In step with the conversions, with the beat between them and the samples, and with neither.
IN_STEP_WITH_THE_SENSOR = [
    Pulses(0.0, 1.0, hertz, 0.1, phase)
    for hertz in (OWN_HERTZ, OWN_HERTZ / 2, OWN_HERTZ - 200.0, 8 * OWN_HERTZ)
    for phase in (0.0, 0.5)
]
FAST = [Pulses(0.0, 2.0, hertz, 0.1) for hertz in (40.0, 100.0, 617.3, 1000.0, 1880.0, 20_000.0)]
EVERY = [*IN_STEP_WITH_THE_SAMPLES, *IN_STEP_WITH_THE_SENSOR, *FAST]


def name(load) -> str:
    return f"{type(load).__name__}-{load.hertz:.1f}Hz-{load.phase}"


def error(board, tmp_path, load, **settings) -> float:
    seconds = 2.0 if load.hertz >= 200.0 else 5.0  # a pulse at the window's edge must not matter
    with board(load=load.words, volts=VOLTS, **settings) as meter:
        measured = measure(meter, tmp_path, seconds)
    assert measured.problems == []
    return measured.error_of("Energy", load)


@pytest.mark.long
@pytest.mark.parametrize("load", soak_but(EVERY[::2], EVERY), ids=name)
def test_a_synchronous_load_is_measured_right(board, tmp_path, load):
    assert abs(error(board, tmp_path, load)) <= PROMISED


@pytest.mark.long
@pytest.mark.parametrize("slowness", [-0.1, 0.1])
@pytest.mark.parametrize("load", [IN_STEP_WITH_THE_SAMPLES[4], IN_STEP_WITH_THE_SAMPLES[9]], ids=name)
def test_it_holds_for_the_slowest_and_the_quickest_sensor(board, tmp_path, load, slowness):
    assert abs(error(board, tmp_path, load, slowness=slowness)) <= PROMISED
