"""The INA219 behind a kernel driver, on a fake /sys that is laid out as the drivers lay it out."""

from __future__ import annotations

import csv
import itertools
import json

import pytest
from tests.meters.rehearsed import InRealTime, problems
from tests.meters.scripted_driver import HWMON, ScriptedFiles, ScriptedSampler, measured

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring.host import SamplingReport
from robot_runner.measuring.local_host import LocalHost
from robot_runner.meters.ina219 import sysfs
from robot_runner.meters.ina219.sysfs import SysfsMeter, find_sensor
from robot_runner.plugins import Window
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

IIO = {
    "name": "ina219",
    "in_voltage0_raw": "6130",
    "in_voltage0_scale": "0.010000000",
    "in_voltage1_raw": "3100",
    "in_voltage1_scale": "4.000000000",
    "in_power2_raw": "3800",
    "in_power2_scale": "2.000000000",
    "in_current3_raw": "6130",
    "in_current3_scale": "0.100000000",
    "in_shunt_resistor": "0.100000000",
}


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Return what lays out a device in a fake /sys; `auto` looks there."""
    patterns = (f"{tmp_path}/hwmon/hwmon*/name", f"{tmp_path}/iio/iio:device*/name")
    monkeypatch.setattr(sysfs, "_PATTERNS", patterns)

    def lay_out(where, files):
        folder = tmp_path / where
        folder.mkdir(parents=True)
        for name, content in files.items():
            (folder / name).write_text(content + "\n")
        return folder

    return lay_out


@pytest.fixture
def host():
    host = LocalHost(SystemClock())
    yield host
    host.close()


def found(host, folder="auto"):
    return find_sensor(host, str(folder), where="test")


@pytest.mark.parametrize(
    ("where", "files", "driver"), [("hwmon/hwmon3", HWMON, "hwmon"), ("iio/iio:device0", IIO, "iio")]
)
def test_the_only_sensor_is_found_and_read_in_si_units(tree, host, where, files, driver):
    folder = tree(where, files)
    tree("hwmon/hwmon0", {"name": "cpu_thermal", "temp1_input": "45000"})
    sensor = found(host)
    assert (sensor.folder, sensor.chip, sensor.driver, sensor.shunt_ohm) == (
        str(folder),
        "ina219",
        driver,
        pytest.approx(0.1),
    )
    reading = sensor.read(host.read_files(sensor.paths), shunt_ohm=0.1)
    assert reading == pytest.approx((0.613, 12.4, 7.6), rel=1e-3)


@pytest.mark.parametrize(("where", "files"), [("hwmon/hwmon3", HWMON), ("iio/iio:device0", IIO)])
def test_a_driver_that_was_told_of_another_shunt_is_mended(tree, host, where, files):
    # Unconfigured, both drivers take a shunt of 10 milliohm: they show ten times the current there is.
    wrong = {**files, "shunt_resistor": "10000", "curr1_input": "6130", "power1_input": "76000000"}
    tree(where, {name: value for name, value in {**wrong, "in_shunt_resistor": "0.010000000"}.items() if name in files})
    sensor = found(host)
    reading = sensor.read(host.read_files(sensor.paths), shunt_ohm=0.1)
    assert reading == pytest.approx((0.613, 12.4, 7.6), rel=1e-3)


@pytest.mark.parametrize(
    ("where", "files"),
    [
        ("hwmon/hwmon3", {**HWMON, "curr1_input": "-613"}),
        ("iio/iio:device0", {**IIO, "in_voltage0_raw": "-6130"}),
    ],
)
def test_power_that_flows_back_is_negative_though_the_chips_power_register_has_no_sign(tree, host, where, files):
    tree(where, files)
    sensor = found(host)
    reading = sensor.read(host.read_files(sensor.paths), shunt_ohm=0.1)
    assert reading == pytest.approx((-0.613, 12.4, -7.6), rel=1e-3)


def test_the_cpu_time_of_sampling_is_told_of_the_window_and_not_of_all_that_was_sampled():
    clock = FakeClock()
    host = ScriptedFiles(clock, HWMON, lambda _: ("7600000", "613", "12400"))
    host.sample_files = lambda rate, paths: BusySampler(host, clock.now(), rate)
    meter = SysfsMeter(host, clock, folder="auto", shunt_ohm=None, rate_hz=None, where="test")
    meter.begin()
    clock.sleep(60.0)
    meter.end()
    quality = meter.evaluate(Window(50.0, 60.0)).quality
    assert quality.cpu_seconds == pytest.approx(0.1)
    assert not any("of one core busy" in warning for warning in quality.warnings())


class BusySampler(ScriptedSampler):
    def report(self):
        return SamplingReport(rate=self.rate, cpu_seconds=0.6)


def test_of_several_sensors_one_must_be_named(tree, host):
    folders = [tree("hwmon/hwmon1", HWMON), tree("hwmon/hwmon2", HWMON)]
    with pytest.raises(LinkError, match="there are 2 sensors") as caught:
        found(host)
    assert all(repr(str(folder)) in caught.value.fix for folder in folders)
    assert found(host, folders[1]).folder == str(folders[1])


def test_without_a_sensor_the_fix_is_to_load_the_driver(tree, host):
    tree("hwmon/hwmon0", {"name": "cpu_thermal"})
    with pytest.raises(LinkError, match="no driver in /sys shows an INA219") as caught:
        found(host)
    assert "ina2xx" in caught.value.fix


def test_a_folder_of_something_else_is_refused_with_what_it_lacks(tree, host):
    folder = tree("hwmon/hwmon0", {"name": "cpu_thermal", "temp1_input": "45000"})
    with pytest.raises(LinkError, match=r"shows no INA219: it has no .*power1_input"):
        found(host, folder)


def test_a_file_that_is_no_number_is_refused_when_it_is_opened(tree, host):
    folder = tree("hwmon/hwmon0", {**HWMON, "shunt_resistor": "lots"})
    with pytest.raises(LinkError, match="lots"):
        found(host, folder)


@pytest.mark.parametrize("lines", [("1", "2"), ("1", None, "3"), ("1", "2", "x")])
def test_a_sample_that_lacks_something_is_none(tree, host, lines):
    tree("hwmon/hwmon0", HWMON)
    assert found(host).read(lines, shunt_ohm=0.1) is None


def watts(value):
    return str(round(value * 1e6)), "613", "12400"


def test_a_run_integrates_what_the_driver_on_another_computer_shows(tmp_path):
    noise = itertools.cycle((0.0, 0.002, 0.0, -0.002))
    context, host = measured(tmp_path, lambda moment: watts((8.0 if moment < 55.0 else 10.0) + next(noise)))
    assert context.measures["Energy"] == pytest.approx(90.0, rel=1e-3)
    assert problems(context) == []
    assert host.rate == 50.0
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert list(next(csv.DictReader(file))) == ["time_s", "current_A", "voltage_V", "power_W"]
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["sensor"]["driver"] == "hwmon"


def test_readings_that_failed_are_counted_and_bridged(tmp_path):
    context, _ = measured(tmp_path, lambda moment: (None, None, None) if 52.0 < moment < 52.05 else watts(8.0))
    assert context.measures["Energy"] == pytest.approx(80.0, rel=1e-3)
    assert any("readings failed" in problem for problem in problems(context))


def test_a_sensor_that_fell_silent_yields_no_value(tmp_path):
    context, _ = measured(tmp_path, lambda moment: watts(8.0) if moment < 53.0 else (None, None, None))
    assert set(context.measures.values()) == {None}


def test_a_driver_that_was_never_told_of_the_shunt_is_told_of(tmp_path):
    context, _ = measured(tmp_path, lambda _: watts(80.0), files={**HWMON, "shunt_resistor": "10000"}, shunt_ohm=0.1)
    assert context.measures["MeanPower"] == pytest.approx(8.0)
    assert any("told of a shunt of 0.01 ohm, not 0.1 ohm" in problem for problem in problems(context))


def test_a_driver_on_this_machine_is_read_in_a_thread(tree, tmp_path):
    tree("hwmon/hwmon0", HWMON)
    clock, profiler = SystemClock(), Ina219(sysfs="auto", rate_hz=10.0)  # slow: a busy machine may pause us
    context = make_context(tmp_path, profiler, robot=None, clock=clock)
    shown = context.raw_data_folder / ".samples.csv.live"
    seen = []

    def mission():
        clock.sleep(0.3)
        deadline = clock.now() + 20.0
        while not any(row.endswith(",7.6") for row in seen) and clock.now() < deadline:
            clock.sleep(0.05)
            seen[:] = shown.read_text().splitlines() if shown.exists() else []

    begun = clock.now()
    measures = dict(rehearse(context, profiler, mission=mission))
    assert (seen[0], not shown.exists()) == ("time_s,power_W", True)
    context.resources.close()
    assert measures["MeanPower"] == pytest.approx(7.6)
    assert 7.6 * 0.3 <= measures["Energy"] <= 7.6 * (clock.now() - begun)


def test_a_driver_on_the_robot_is_read_over_ssh(tree, tmp_path, server):
    folder = tree("hwmon/hwmon0", HWMON)
    clock = SystemClock()
    for attempt in range(20):  # samples that a busy machine delays give no value
        profiler = Ina219(sysfs=str(folder), host="robot", ssh_config=server.config)
        context = make_context(tmp_path / str(attempt), profiler, robot=None, clock=clock)
        measures = dict(rehearse(context, profiler, mission=lambda: clock.sleep(1.0)))
        context.resources.close()
        if measures["MeanPower"] is not None:
            break
    assert measures["MeanPower"] == pytest.approx(7.6)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    seconds = facts["window"]["end"] - facts["window"]["start"]  # a busy machine sleeps longer
    assert measures["Energy"] == pytest.approx(7.6 * seconds, rel=0.02)
    assert facts["samples"]["clock_uncertainty"] < 0.5
    assert facts["rate_hz"] == 50.0
    (noted,) = (fields for kind, fields in context.broker.records if kind == "clock")
    assert noted == {"owner": profiler.name, **facts["host_clock"]}
    assert (noted["host"], noted["after"]["exchanges"] > 0) == ("robot", True)


def test_a_sensor_that_the_robot_does_not_have_fails_the_run_before_its_mission(tree, tmp_path, server):
    folder = tree("hwmon/hwmon0", {"name": "cpu_thermal"})
    profiler = Ina219(sysfs=str(folder), host="robot", ssh_config=server.config)
    context = make_context(tmp_path, profiler, robot=None, clock=SystemClock())
    with pytest.raises(LinkError, match="shows no INA219"):
        rehearse(context, profiler)
    context.resources.close()


class TestIna219BehindADriver(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False

    @pytest.fixture(autouse=True)
    def _sensor(self, tmp_path_factory, monkeypatch):
        folder = tmp_path_factory.mktemp("sys") / "hwmon0"
        folder.mkdir()
        for name, content in HWMON.items():
            (folder / name).write_text(content)
        monkeypatch.setattr(sysfs, "_PATTERNS", (f"{folder}/name",))

    def make_plugin(self) -> Ina219:
        return Ina219(sysfs="auto", rate_hz=100.0)


@pytest.mark.parametrize("micro_ohm", ["2000", "100000"])
def test_an_ina226_at_the_end_of_its_range_is_clipped_whatever_its_shunt(tmp_path, micro_ohm):
    # The last step of its register is 32767 x 2.5 uV = 81.9175 mV, which the driver tells in whole mA.
    milli_ampere = str(round(81917.5 / float(micro_ohm) * 1000))
    files = {**HWMON, "name": "ina226", "shunt_resistor": micro_ohm}
    context, _ = measured(tmp_path, lambda _: ("500000000", milli_ampere, "12400"), files=files)
    assert any("100.0 % of the samples were clipped" in problem for problem in problems(context))
