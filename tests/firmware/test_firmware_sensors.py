"""Several sensors on one bus: each has its frames, its profiler and its columns."""

from __future__ import annotations

import pytest
from tests.firmware.card_image import make_card
from tests.firmware.measuring import VOLTS, Pulses, metered
from tests.firmware.simulated_board import BoardClock, Build, build_firmware, executed

from robot_runner.meters.ina219.card import read_card
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import rehearse

LOAD = Pulses(0.3, 1.5, 200.0, 0.3)


@pytest.fixture(scope="module")
def three(built, tmp_path_factory) -> Build:
    """A firmware for three sensors, of which the second and the third see a half and a third of the load."""
    flags = "-DSENSOR_ADDRESSES=0x40,0x41,0x42"
    return Build(build_firmware(tmp_path_factory.mktemp("three"), flags=flags), built.board)


def profilers(**way) -> list[Ina219]:
    addresses = {"board": None, "motors": 0x41, "arm": 0x42}
    return [Ina219(name=name, address=address, **way) for name, address in addresses.items()]


@pytest.mark.long
def test_each_sensor_has_its_own_energy(three, tmp_path):
    with executed(three, clock=BoardClock(tmp_path / "clock"), load=LOAD.words, volts=VOLTS, sensors=3) as meter:
        plugins = profilers(port=meter.port)
        context = metered(meter, tmp_path, *plugins)
        measures = rehearse(context, *plugins, mission=lambda: meter.clock.sleep(3.0))
        context.resources.close()
    joules = LOAD.joules(context.window)
    assert context.broker.findings == ()
    for share, name in enumerate(("board", "motors", "arm"), 1):
        assert measures[f"{name}.Energy"] == pytest.approx(joules / share, rel=0.025)


@pytest.mark.long
def test_a_sensor_that_is_not_there_is_told_and_the_others_go_on(three, tmp_path):
    with executed(three, clock=BoardClock(tmp_path / "clock"), load=LOAD.words, volts=VOLTS, sensors=2) as meter:
        plugins = profilers(port=meter.port)
        context = metered(meter, tmp_path, *plugins)
        measures = rehearse(context, *plugins, mission=lambda: meter.clock.sleep(1.5))
        context.resources.close()
    assert measures["motors.Energy"] == pytest.approx(LOAD.joules(context.window) / 2, rel=0.025)
    assert measures["arm.Energy"] is None
    problems = [finding.problem for finding in context.broker.findings]
    assert "the power meter answered, its sensor did not: look at the four wires between them" in problems


@pytest.mark.long
def test_the_card_holds_each_sensor(three, tmp_path):
    card = make_card(tmp_path / "card")
    clock = BoardClock(tmp_path / "clock")
    with executed(three, clock=clock, load="0:0.8", volts=VOLTS, sensors=3, card=card.path) as meter:
        (first, *_) = plugins = profilers(port=meter.port)
        context = metered(meter, tmp_path, *plugins)
        rehearse(context, first, mission=lambda: meter.clock.sleep(2.0))
        context.resources.close()
    file = card.copy_to(tmp_path / "INA219.BIN")
    for share, address in enumerate((0x40, 0x41, 0x42), 1):
        (recording,) = read_card(file, address=address)
        assert recording.evaluate().values()["MeanPower"] == pytest.approx(0.8 * VOLTS / share, rel=1e-3)


@pytest.mark.usefixtures("built")
def test_more_samples_than_the_line_carries_are_refused_by_the_compiler(tmp_path):
    with pytest.raises(AssertionError, match="lower SAMPLE_RATE_HZ"):
        build_firmware(tmp_path / "four", flags="-DSENSOR_ADDRESSES=0x40,0x41,0x42,0x43")
