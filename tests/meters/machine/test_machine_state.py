"""What is read of a copy of /proc and /sys, as Linux lays them out."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

import pytest
from tests.meters.machine.computer_copy import ComputerCopy

from robot_runner.meters.machine.machine_state import MachineFiles, ProcessTimes, SystemFiles

if TYPE_CHECKING:
    from pathlib import Path


def test_a_whole_computer_is_understood(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    copy.process(1, "systemd", ticks=500)
    copy.process(4711, "Web Content (a b)", ticks=1234, parent=1)
    state = MachineFiles(SystemFiles(tmp_path)).state()
    assert state.processes[4711].name == "Web Content (a b)"
    assert state.processes[4711].own == pytest.approx(12.34)
    assert state.busy == pytest.approx(60.0)
    assert state.stolen == pytest.approx(0.5)
    assert state.swapped == 30
    assert state.stalled == pytest.approx(0.25)
    found = state.conditions
    assert found.governors == ("powersave",)
    assert found.is_turbo is True
    assert found.frequency == pytest.approx(1.5e9)
    assert found.limit == pytest.approx(2.4e9)
    assert found.temperature == pytest.approx(61.5)
    assert found.throttle_counts == (1, 2)
    assert found.is_held_back is False
    assert found.is_under_voltage is None  # no firmware tells


def test_a_frequency_counts_for_as_many_cores_as_share_it(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    cpu = tmp_path / "sys/devices/system/cpu"
    for policy, cores, frequency in ((0, range(4), 1_400_000), (4, (4, 5), 2_000_000)):
        for name in ("cur_freq", "max_freq"):
            copy.write(f"sys/devices/system/cpu/cpufreq/policy{policy}/scaling_{name}", frequency)
        for core in cores:  # as Linux lays it out: each core has a link to its policy
            shutil.rmtree(cpu / f"cpu{core}" / "cpufreq", ignore_errors=True)
            (cpu / f"cpu{core}").mkdir(exist_ok=True)
            (cpu / f"cpu{core}" / "cpufreq").symlink_to(f"../cpufreq/policy{policy}")
    conditions = MachineFiles(SystemFiles(tmp_path)).conditions()
    assert conditions.frequency == pytest.approx((4 * 1.4e9 + 2 * 2.0e9) / 6)
    assert conditions.limit == pytest.approx((4 * 1.4e9 + 2 * 2.0e9) / 6)


def test_a_zone_that_measures_nothing_is_not_the_hottest(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    copy.write("sys/class/thermal/thermal_zone2/temp", 100000)
    copy.write("sys/class/thermal/thermal_zone2/type", "PMIC-Die")
    assert MachineFiles(SystemFiles(tmp_path)).conditions().temperature == pytest.approx(61.5)


def test_the_processor_of_amd_is_no_zone_and_is_watched_all_the_same(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    for number, chip, shown in ((2, "k10temp", 81500), (3, "nvme", 90000)):
        copy.write(f"sys/class/hwmon/hwmon{number}/name", chip)
        copy.write(f"sys/class/hwmon/hwmon{number}/temp1_input", shown)
    assert MachineFiles(SystemFiles(tmp_path)).conditions().temperature == pytest.approx(81.5)


def test_a_fan_does_not_hold_the_processor_back_and_a_cooling_device_of_the_processor_does(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    copy.write("sys/class/thermal/cooling_device1/cur_state", 3)  # the fan
    assert MachineFiles(SystemFiles(tmp_path)).conditions().is_held_back is False
    copy.write("sys/class/thermal/cooling_device0/cur_state", 1)
    assert MachineFiles(SystemFiles(tmp_path)).conditions().is_held_back is True
    copy.write("sys/class/thermal/cooling_device0/cur_state", -1)  # that of intel_powerclamp, while it does nothing
    assert MachineFiles(SystemFiles(tmp_path)).conditions().is_held_back is False


#: A Raspberry Pi up to 4, and a Raspberry Pi 5 (raspberrypi/linux, bcm2712.dtsi).
@pytest.mark.parametrize("bus", ["soc", "soc@107c000000"])
@pytest.mark.parametrize(
    ("shown", "now", "ever"), [("0", False, 0), ("50005", True, 0b0101), ("80000", False, 0b1000), ("damaged", None, 0)]
)
def test_the_flags_of_a_raspberry_pi_are_understood(
    tmp_path: Path, bus: str, shown: str, now: object, ever: int
) -> None:
    copy = ComputerCopy(tmp_path)
    copy.write(f"sys/devices/platform/{bus}/{bus}:firmware/get_throttled", shown)
    files = MachineFiles(SystemFiles(tmp_path))
    assert files.processor.has_firmware
    conditions = files.conditions()
    assert conditions.is_under_voltage is now
    assert conditions.firmware_flags == ever


def test_over_currents_of_a_jetson_are_counted(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    assert MachineFiles(SystemFiles(tmp_path)).conditions().over_currents is None
    for number, count in ((1, 0), (2, 15), (3, 37)):
        copy.write(f"sys/class/hwmon/hwmon3/oc{number}_event_cnt", count)
    assert MachineFiles(SystemFiles(tmp_path)).conditions().over_currents == 52


def test_an_empty_folder_tells_nothing(tmp_path: Path) -> None:
    files = MachineFiles(SystemFiles(tmp_path))
    state = files.state()
    assert (state.busy, state.stolen, state.swapped, state.stalled) == (None, None, None, None)
    assert not state.processes
    assert not files.processor.changing


@pytest.mark.parametrize("text", ["", "no line", "12 (cut) S 1 2 3", "cpu"])
def test_what_is_no_line_of_a_process_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - whatever it says, the process is passed over
        ProcessTimes.of_stat(text)


def test_this_machine_knows_this_process() -> None:
    state = MachineFiles(SystemFiles()).state()
    assert state.reader == os.getpid()
    assert state.processes[os.getpid()].parent == os.getppid()
    assert state.busy is not None
