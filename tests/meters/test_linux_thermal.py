from __future__ import annotations

import csv
import json

import pytest
from tests.meters.fake_sysfs import write
from tests.meters.rehearsed import problems

from robot_runner.core.errors import PluginError
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import LinuxThermal
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse


class FakeBoard:
    """The thermal zones, frequencies and throttling of a computer with two cores, in a sysfs of a test."""

    def __init__(self, root) -> None:
        self.root = root
        self.zone("thermal_zone0", "acpitz", 30.0)
        self.zone("thermal_zone1", "cpu-thermal", 45.0)
        for cpu in (0, 1):
            self.frequency(cpu, 1_500_000)

    def zone(self, folder, kind, celsius):
        write(self.root / "class" / "thermal" / folder / "type", kind)
        write(self.root / "class" / "thermal" / folder / "temp", round(celsius * 1000))

    def frequency(self, cpu, kilohertz):
        write(self.root / f"devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq", kilohertz)

    def throttled(self, count):
        for cpu in (0, 1):
            write(self.root / f"devices/system/cpu/cpu{cpu}/thermal_throttle/core_throttle_count", count)

    def cooler(self, place, kind, state):
        write(self.root / f"class/thermal/cooling_device{place}/type", kind)
        write(self.root / f"class/thermal/cooling_device{place}/cur_state", state)

    def firmware(self, flags):
        write(self.root / "devices/platform/soc/soc:firmware/get_throttled", f"{flags:x}")


class TestLinuxThermalOnAFakeSysfs(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def _board(self, tmp_path_factory):
        self.board = FakeBoard(tmp_path_factory.mktemp("sys"))
        self.board.throttled(0)

    def make_plugin(self) -> LinuxThermal:
        return LinuxThermal(root=self.board.root)


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def board(tmp_path):
    return FakeBoard(tmp_path / "sys")


@pytest.fixture
def measure(tmp_path, clock, board):
    def execute(*, seconds=10.0, **settings):
        plugin = LinuxThermal(root=board.root, **settings)
        context = make_context(tmp_path, plugin, robot=None, clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context

    return execute


def test_the_hottest_zone_and_the_mean_frequency_are_told(measure, board, clock):
    board.frequency(1, 1_000_000)
    clock.at(5.25, lambda: board.zone("thermal_zone1", "cpu-thermal", 65.0))
    context = measure()
    assert context.measures["MaxTemperature"] == pytest.approx(65.0)
    assert context.measures["MeanTemperature"] == pytest.approx(55.0, abs=1.1)
    assert context.measures["MeanFrequency"] == pytest.approx(1.25e9)


def test_frequencies_are_kept_under_the_numbers_of_their_cores(measure, board):
    board.frequency(5, 2_000_000)  # 2 to 4 are switched off
    context = measure()
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    assert {name: cell for name, cell in first.items() if name.startswith("frequency_cpu")} == {
        "frequency_cpu0_Hz": "1500000000",
        "frequency_cpu1_Hz": "1500000000",
        "frequency_cpu5_Hz": "2000000000",
    }


def test_the_processor_of_amd_is_no_zone_and_is_told_all_the_same(measure, board):
    # It tells its temperature in hwmon alone (Linux, Documentation/hwmon/k10temp.rst); acpitz is a place on the board.
    write(board.root / "class/hwmon/hwmon2/name", "k10temp")
    write(board.root / "class/hwmon/hwmon2/temp1_input", 71500)
    write(board.root / "class/hwmon/hwmon3/name", "nvme")
    write(board.root / "class/hwmon/hwmon3/temp1_input", 90000)
    assert measure().measures["MaxTemperature"] == pytest.approx(71.5)
    context = measure(zones=["k10temp"], name="Chosen")
    assert context.measures["MeanTemperature"] == pytest.approx(71.5)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["zones"] == ["k10temp"]


def test_zones_can_be_chosen(measure):
    assert measure(zones=["acpitz"]).measures["MaxTemperature"] == pytest.approx(30.0)


def test_a_core_that_is_switched_off_and_on_was_not_throttled(measure, board, clock):
    board.throttled(100)
    counter = board.root / "devices/system/cpu/cpu1/thermal_throttle/core_throttle_count"
    clock.at(3.25, counter.unlink)
    clock.at(6.25, lambda: board.throttled(100))
    context = measure()
    assert context.measures["Throttled"] == 0.0
    assert problems(context) == []


def test_the_firmware_of_a_raspberry_pi_5_tells_too(measure, board):
    # Its bus has an address in its name (raspberrypi/linux, bcm2712.dtsi).
    write(board.root / "devices/platform/soc@107c000000/soc@107c000000:firmware/get_throttled", "50005")
    context = measure()
    assert context.measures["Throttled"] == 100.0
    assert "the supply voltage of the computer was too low for a time" in problems(context)


def test_a_firmware_that_cannot_be_read_does_not_say_that_all_is_well(measure, board, clock):
    board.firmware(0)
    clock.at(5.25, (board.root / "devices/platform/soc/soc:firmware/get_throttled").unlink)
    clock.at(8.25, lambda: board.firmware(0b0100))
    assert measure().measures["Throttled"] == pytest.approx(100 * 4 / 15)


def test_a_count_of_throttling_that_grows_is_warned_of(measure, board, clock):
    board.throttled(100)
    clock.at(5.25, lambda: board.throttled(103))
    context = measure()
    assert context.measures["Throttled"] == pytest.approx(100 / 21)
    assert "the processor was held back in 1 of 21 samples, at up to 45 °C" in problems(context)


def test_a_jetson_that_is_throttled_for_its_current_is_warned_of(measure, board, clock):
    # NVIDIA, Jetson Linux Developer Guide, Platform Power and Performance: Over-Current Event Status from Sysfs.
    count = board.root / "class/hwmon/hwmon3/oc3_event_cnt"
    write(count, 27)
    clock.at(5.25, lambda: write(count, 28))
    assert measure().measures["Throttled"] == pytest.approx(100 / 21)


@pytest.mark.parametrize(
    ("kind", "is_processor"),
    [
        ("Processor", True),
        ("cpufreq-cpu0", True),
        ("thermal-cpufreq-0", True),
        ("idle-cpu0", True),
        ("intel_powerclamp", True),
        ("pwm-fan", False),
    ],
)
def test_a_cooling_device_of_the_processor_tells_of_throttling_and_a_fan_does_not(measure, board, kind, is_processor):
    board.cooler(0, kind, 2)
    context = measure()
    assert context.measures["Throttled"] == (100.0 if is_processor else None)
    assert any("held back" in problem for problem in problems(context)) == is_processor


def test_a_cooling_device_that_does_nothing_throttles_nothing(measure, board):
    board.cooler(0, "intel_powerclamp", -1)  # as drivers/thermal/intel/intel_powerclamp.c says it
    assert measure().measures["Throttled"] == 0.0


@pytest.mark.parametrize(
    ("flags", "throttled", "said"),
    [
        (0x0, 0.0, ""),
        (0x70000, 0.0, ""),  # it has happened since the start of the board, and does not happen now
        (0x4, 100.0, "held back"),
        (0x8, 100.0, "held back"),
        (0x1, 0.0, "supply voltage"),
    ],
)
def test_the_firmware_of_a_raspberry_pi_is_understood(measure, board, flags, throttled, said):
    board.firmware(flags)
    context = measure()
    assert context.measures["Throttled"] == throttled
    assert bool(problems(context)) == bool(said)
    assert all(said in problem for problem in problems(context))


def test_what_a_raspberry_pi_says_to_have_happened_between_two_samples_is_told(measure, board, clock):
    board.firmware(0x20000)  # its frequency was capped once, before
    clock.at(4.1, lambda: board.firmware(0x50005 | 0x20000))
    clock.at(4.3, lambda: board.firmware(0x50000 | 0x20000))
    context = measure()
    assert context.measures["Throttled"] == pytest.approx(100 / 21)
    assert problems(context) == [
        "the processor was held back in 1 of 21 samples, at up to 45 °C",
        "the supply voltage of the computer was too low for a time",
    ]


def test_what_happened_before_is_not_new_where_the_firmware_could_not_be_asked_in_between(measure, board, clock):
    board.firmware(0x50000)
    board.cooler(0, "cpufreq-cpu0", 0)
    clock.at(4.1, (board.root / "devices/platform/soc/soc:firmware/get_throttled").unlink)
    clock.at(5.1, lambda: board.firmware(0x50000))
    context = measure()
    assert context.measures["Throttled"] == 0.0
    assert problems(context) == []


def test_a_zone_that_tells_whole_degrees_is_doubted(measure, board, clock):
    told = (
        "a thermal zone reported temperatures below 0.15 °C in 10 of 21 samples: "
        "it may report whole degrees, not thousandths"
    )
    board.zone("thermal_zone0", "acpitz", 0.0)
    board.zone("thermal_zone1", "cpu-thermal", 0.0)
    assert problems(measure()) == []  # in a cold lab
    board.zone("thermal_zone1", "cpu-thermal", 45.0)
    clock.at(clock.now() + 5.25, lambda: board.zone("thermal_zone1", "cpu-thermal", 0.045))
    assert told in problems(measure())


def test_a_core_at_0_hz_does_not_tell_its_frequency(measure, board, clock):
    clock.at(5.25, lambda: board.frequency(1, 0))
    assert measure().measures["MeanFrequency"] == pytest.approx(1.5e9)


def test_what_a_machine_does_not_tell_is_missing_and_told_by_the_check(measure, board):
    for cpu in (0, 1):
        (board.root / f"devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq").unlink()
    context = measure()
    assert context.measures["MeanFrequency"] is None
    assert context.measures["Throttled"] is None
    assert context.measures["MaxTemperature"] is not None
    findings = list(LinuxThermal(root=board.root).check(Circumstances()))
    assert [finding.is_error for finding in findings] == [False, False]
    assert "MeanFrequency" in findings[0].problem


def test_a_sensor_that_falls_asleep_leaves_its_cell_empty(measure, board, clock):
    clock.at(9.25, lambda: write(board.root / "class/thermal/thermal_zone1/temp", ""))
    context = measure(zones=["cpu-thermal"])
    assert context.measures["MaxTemperature"] == pytest.approx(45.0)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert (rows[0]["temperature_degC"], rows[-1]["temperature_degC"]) == ("45.000", "")


def test_zones_that_measure_nothing_are_left_out(measure, board):
    board.zone("thermal_zone2", "PMIC-Die", 100.0)  # a Jetson's, which shows that and nothing else
    board.zone("thermal_zone3", "gpu-thermal", -256.0)  # of a GPU that sleeps
    board.zone("thermal_zone4", "broken", 200.0)
    context = measure()
    assert context.measures["MaxTemperature"] == pytest.approx(45.0)
    assert not problems(context)


def test_a_zone_that_shows_no_temperature_for_a_time_is_told(measure, board, clock):
    clock.at(5.25, lambda: board.zone("thermal_zone1", "cpu-thermal", -256.0))
    assert any(problem.startswith("a thermal zone could not be read in 10 of 21") for problem in problems(measure()))


def test_a_hottest_zone_that_falls_asleep_is_told_for_the_others_stand_for_it(measure, board, clock):
    clock.at(5.25, (board.root / "class/thermal/thermal_zone1/temp").unlink)
    told = "a thermal zone could not be read in 10 of 21 samples: where it is the hottest, the temperatures are too low"
    assert told in problems(measure())


def test_a_temperature_that_is_told_for_a_part_of_the_window_is_not_that_of_the_whole(measure, board, clock):
    clock.at(4.25, (board.root / "class/thermal/thermal_zone1/temp").unlink)
    context = measure(zones=["cpu-thermal"])
    assert (context.measures["MaxTemperature"], context.measures["MeanTemperature"]) == (None, None)
    assert context.measures["MeanFrequency"] == pytest.approx(1.5e9)
    assert "the temperature was reported in 9 of 21 samples only: no value" in problems(context)


def test_a_machine_that_tells_nothing_is_refused(tmp_path):
    plugin = LinuxThermal(root=tmp_path)
    (finding,) = plugin.check(Circumstances())
    assert finding.is_error
    with pytest.raises(PluginError, match="neither temperature nor frequency"):
        rehearse(make_context(tmp_path, plugin, robot=None), plugin)


def test_zones_that_are_not_there_are_answered_with_those_that_are(tmp_path):
    board = FakeBoard(tmp_path)
    for cpu in (0, 1):
        (board.root / f"devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq").unlink()
    (finding,) = LinuxThermal(zones=["gpu"], root=tmp_path).check(Circumstances())
    assert finding.fix == "Choose zones among: 'acpitz', 'cpu-thermal'."
