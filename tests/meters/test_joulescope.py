"""The maker's own driver as far as it goes without an instrument, and a fake one with its methods."""

from __future__ import annotations

import inspect
import json

import pytest
from tests.meters.fake_joulescope import FakeDriver
from tests.meters.rehearsed import measured, only_finding, problems

from robot_runner.core.errors import PluginError
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Joulescope
from robot_runner.testing import FakeClock, ProfilerContract

real = pytest.importorskip("pyjoulescope_driver", reason="pyjoulescope_driver is not installed")


@pytest.fixture
def clock():
    return FakeClock(10.0)


@pytest.fixture
def connect(monkeypatch, clock):
    def install(*paths, **settings):
        driver = FakeDriver(clock, list(paths), **settings)
        monkeypatch.setattr(real, "Driver", lambda: driver)
        return driver

    return install


@pytest.mark.parametrize("name", ["device_paths", "open", "close", "publish", "subscribe", "finalize"])
def test_the_fake_driver_has_the_methods_of_the_real_one(name):
    real_ones, fake_ones = (
        list(inspect.signature(getattr(each, name)).parameters) for each in (real.Driver, FakeDriver)
    )
    # Later versions of the driver take more of them, in between.
    assert [parameter for parameter in real_ones if parameter in fake_ones] == fake_ones


def test_the_real_driver_finds_no_instrument_here():
    with real.Driver() as driver:
        if driver.device_paths():
            pytest.skip("a Joulescope is connected")
    (finding,) = Joulescope().check(Circumstances())
    assert finding.is_error
    assert finding.problem == "no Joulescope is connected"
    assert "udev" in finding.fix


@pytest.mark.parametrize("path", ["u/js220/000415", "u/js110/002557", "u/js320/8W2A"])
def test_energy_is_that_of_the_instruments_own_counter(tmp_path, clock, connect, path):
    driver = connect(path, watts=lambda time: 8.0 if time < 15.0 else 20.0)
    context = measured(tmp_path, Joulescope(), clock, seconds=10)
    assert context.measures["Energy"] == pytest.approx(140.0, rel=0.02)
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert problems(context) == []
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert (facts["device"], facts["energy_from"]) == (path, {"": "counter"})
    assert driver.is_finalized
    assert driver.opened == set()


def test_what_happens_between_two_readings_is_in_the_counter(tmp_path, clock, connect):
    # Every second 0.1 s of 100 W, which readings of power at 1 Hz see each time or never.
    connect("u/js220/000415", watts=lambda time: 100.0 if time % 1 < 0.1 else 2.0)
    context = measured(tmp_path, Joulescope(rate_hz=1.0), clock, seconds=20.0)
    assert context.measures["Energy"] == pytest.approx(20 * (0.1 * 100.0 + 0.9 * 2.0), rel=0.03)
    assert problems(context) == []


def test_current_and_voltage_are_means_over_all_of_the_time_between_two_readings(tmp_path, clock, connect):
    # The load is on while those statistics are made that no reading of the last one sees.
    connect("u/js220/000415", watts=lambda time: 100.0 if 0.6 < time % 1 < 0.7 else 2.0)
    context = measured(tmp_path, Joulescope(rate_hz=1.0), clock, seconds=20.0)
    assert context.measures["MeanCurrent"] == pytest.approx((0.1 * 100.0 + 0.9 * 2.0) / 12.0, rel=0.03)
    assert problems(context) == []


@pytest.mark.parametrize(
    "counted",
    [
        lambda joules: min(joules, 560.0),  # it stands still
        lambda joules: joules + 400.0 * (joules > 560.0),  # another program has set it
        lambda joules: joules / 3.6,  # in mWh
    ],
)
def test_a_counter_that_power_contradicts_is_doubted(tmp_path, clock, connect, counted):
    driver = connect("u/js220/000415", watts=lambda time: 8.0 + 0.1 * (time % 0.7))
    driver.counted = counted
    (problem,) = problems(measured(tmp_path, Joulescope(), clock, seconds=10))
    assert problem.startswith("the energy counter rose by ")
    assert ", and its power amounts to 80.3" in problem


def test_power_before_a_short_mission_does_not_contradict_the_counter(tmp_path, clock, connect):
    connect("u/js220/000415", watts=lambda time: 8.0 if time < 10.0 else 40.0)
    context = measured(tmp_path, Joulescope(), clock, seconds=0.2)
    assert (context.measures["Energy"], context.measures["MeanCurrent"]) == pytest.approx((8.0, 40.0 / 12.0))
    assert problems(context) == []


def test_an_instrument_that_falls_silent_costs_the_values_and_not_the_run(tmp_path, clock, connect):
    driver = connect("u/js220/000415")
    clock.at(13.0, lambda: setattr(driver, "is_silent", True))
    context = measured(tmp_path, Joulescope(), clock, seconds=10)
    assert set(context.measures.values()) == {None}
    assert any("has reported nothing for" in problem for problem in problems(context))


def test_an_instrument_that_sends_nothing_fails_the_run_before_its_mission(tmp_path, clock, connect):
    driver = connect("u/js220/000415")
    driver.is_silent = True
    with pytest.raises(PluginError, match="sends no statistics"):
        measured(tmp_path, Joulescope(), clock, seconds=10)
    assert driver.is_finalized


def test_of_several_one_must_be_named(connect):
    connect("u/js220/000415", "u/js220/000416", "u/mb/0001")
    finding = only_finding(Joulescope())
    assert finding.problem == "there are 2 Joulescopes"
    assert "device='u/js220/000415'" in finding.fix
    assert list(Joulescope(device="000416").check(Circumstances())) == []


def test_one_that_is_not_there_is_answered_with_those_that_are(connect):
    connect("u/js220/000415")
    finding = only_finding(Joulescope(device="u/js220/000414"))
    assert "u/js220/000415" in finding.fix


def test_one_that_cannot_be_opened_fails_the_run_before_its_mission(tmp_path, clock, connect, monkeypatch):
    driver = connect("u/js220/000415")

    def refuse(*_: object) -> None:
        raise RuntimeError("jsdrv_open timed out")

    monkeypatch.setattr(driver, "open", refuse)
    with pytest.raises(PluginError, match="cannot be opened: jsdrv_open timed out"):
        measured(tmp_path, Joulescope(), clock, seconds=10)
    assert driver.is_finalized


def test_a_machine_without_the_driver_is_told_which_extra_brings_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "robot-runner[joulescope]" in only_finding(Joulescope()).fix


@pytest.mark.parametrize("rate", [0.0, -1.0, 1000.0])
def test_a_rate_that_cannot_be_is_refused(rate):
    with pytest.raises(PluginError):
        Joulescope(rate_hz=rate)


class TestJoulescopeOnAFakeDriver(ProfilerContract):
    robot = None
    measuring_seconds = 5.0

    @pytest.fixture(autouse=True)
    def _driver(self, monkeypatch):
        self.monkeypatch = monkeypatch
        monkeypatch.setattr(real, "Driver", lambda: FakeDriver(FakeClock(), ["u/js220/000415"]))

    def make_plugin(self) -> Joulescope:
        return Joulescope()

    def make_context(self, folder, plugin, *, run_seed=1):
        context = super().make_context(folder, plugin, run_seed=run_seed)
        self.monkeypatch.setattr(real, "Driver", lambda: FakeDriver(context.clock, ["u/js220/000415"]))
        return context
