"""Rails of hwmon and IIO, on trees that are laid out as the kernel lays them out, here and over a real sshd."""

from __future__ import annotations

import csv
import json
import re

import pytest
from tests.meters import rail_trees
from tests.meters.fake_sysfs import write
from tests.meters.rail_trees import RailTree
from tests.meters.rehearsed import problems

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring.local_host import LocalHost
from robot_runner.meters.sysfs_rails import find_rails
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import PowerRails
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse


@pytest.fixture
def tree(tmp_path):
    return RailTree(tmp_path / "sys")


@pytest.fixture
def clock():
    return FakeClock(10.0)


def found(tree):
    host = LocalHost(SystemClock())
    return {rail.name: rail for rail in find_rails(host, str(tree.root))}


def reading(rail):
    host = LocalHost(SystemClock())
    paths = [file.path for file in rail.files.values()]
    return rail.read(dict(zip(paths, host.read_files(paths), strict=True)))


# What the drivers show.


def test_a_jetson_shows_its_rails_by_the_names_of_its_schematic(tree):
    tree.hwmon(rail_trees.THERMAL)
    tree.hwmon(rail_trees.JETSON_ORIN, address="1-0040")
    rails = found(tree)
    assert set(rails) == {"VDD_IN", "VDD_CPU_GPU_CV", "VDD_SOC", "ina3221:curr4"}
    assert reading(rails["VDD_IN"])[:3] == pytest.approx((7.6, 5.0, 1.52))
    assert reading(rails["VDD_SOC"])[:3] == pytest.approx((1.248, 4.992, 0.25))


def test_the_voltages_of_shunts_pass_for_no_rail(tree):
    tree.hwmon(rail_trees.JETSON_ORIN)
    shown = {file.path.rpartition("/")[2] for rail in found(tree).values() for file in rail.files.values()}
    assert not shown & {"in4_input", "in5_input", "in6_input", "in7_input"}
    assert not found(tree)["ina3221:curr4"].tells_power


def test_an_earlier_jetson_shows_its_rails_through_iio(tree):
    tree.iio(rail_trees.JETSON_NANO)
    rails = found(tree)
    assert list(rails) == ["POM_5V_IN", "POM_5V_GPU"]
    assert reading(rails["POM_5V_IN"])[:3] == pytest.approx((2.204, 5.104, 0.432))


@pytest.mark.parametrize("files", rail_trees.INA2XX, ids=lambda files: files["name"])
def test_the_siblings_of_the_ina219_are_read_in_si_units(tree, files):
    tree.hwmon(files, address="1-0040")
    (rail,) = found(tree).values()
    assert rail.name == files["name"]
    assert reading(rail)[:3] == pytest.approx((7.6, 12.4, 0.613))


@pytest.mark.parametrize("files", rail_trees.INA2XX, ids=lambda files: files["name"])
def test_power_that_flows_back_is_negative_though_the_chips_power_register_has_no_sign(tree, files):
    tree.hwmon({**files, "curr1_input": "-613"})
    (rail,) = found(tree).values()
    assert reading(rail)[:3] == pytest.approx((-7.6, 12.4, -0.613), rel=1e-3)


def test_the_energy_counter_of_an_ina228_is_found(tree):
    tree.hwmon(rail_trees.INA228)
    assert reading(found(tree)["ina228"]).joules == pytest.approx(123.456789)


@pytest.mark.parametrize(
    ("files", "name", "expected"),
    [
        (rail_trees.INA226_IIO, "ina226", (7.6, 12.4, 0.613, None)),
        (rail_trees.PAC1934, "VBAT", (5.0000298, 5.0, 0.999485, 1000.00596)),
    ],
)
def test_registers_of_iio_are_scaled(tree, files, name, expected):
    tree.iio(files)
    rails = found(tree)
    assert list(rails) == [name]
    assert reading(rails[name])[:4] == pytest.approx(expected)


def test_what_belongs_to_one_rail_of_a_pmbus_supply_is_told_by_its_labels(tree):
    tree.hwmon(rail_trees.PMBUS)
    rails = found(tree)
    assert reading(rails["pout1"])[:3] == pytest.approx((13.2, 12.0, 1.1))
    assert reading(rails["iin"])[:3] == pytest.approx((14.4, 48.0, 0.3))


def test_a_voltage_of_the_same_number_is_not_taken_for_that_of_another_label(tree):
    tree.hwmon(rail_trees.AMDGPU)
    rails = found(tree)
    assert reading(rails["PPT"])[:3] == (pytest.approx(9.0), None, None)
    assert set(rails["vddgfx"].files) == {"voltage"}


def test_voltages_and_currents_that_are_each_numbered_by_themselves_make_no_power(tree):
    for files in (rail_trees.LTC4261, rail_trees.LTC4222):
        tree.hwmon(files)
    tree.iio(rail_trees.AXP209)
    rails = found(tree)
    assert rails
    assert not [name for name, rail in rails.items() if rail.tells_power]


def test_power_does_not_get_the_voltage_of_another_supply_that_has_its_number(tree):
    tree.hwmon(rail_trees.LTC2992)
    rails = found(tree)
    assert reading(rails["ltc2992:power1"])[:3] == (pytest.approx(12.0), None, 1.0)
    assert reading(rails["ltc2992:power2"])[:3] == (pytest.approx(10.0), None, 2.0)


def test_a_chip_that_numbers_voltage_and_current_of_a_rail_alike_has_power(tree):
    tree.hwmon(rail_trees.LTC4151)
    (rail,) = (rail for rail in found(tree).values() if rail.tells_power)
    assert reading(rail)[:3] == pytest.approx((12.0, 24.0, 0.5))


def test_an_average_stands_in_where_there_is_no_power_of_the_moment(tree):
    tree.hwmon(rail_trees.ACPI_METER)
    assert reading(found(tree)["power_meter"]).power == pytest.approx(184.0)


def test_alike_chips_are_told_apart_by_their_address_on_the_bus(tree):
    tree.hwmon(rail_trees.INA226, address="1-0040")
    tree.hwmon(rail_trees.INA226, address="1-0041")
    assert list(found(tree)) == ["ina226@1-0040", "ina226@1-0041"]


def test_rails_of_one_label_on_one_chip_are_told_apart_by_their_number(tree):
    labels = {"power1_label": "total", "power1_input": "1000000", "power2_label": "total", "power2_input": "2000000"}
    tree.hwmon({"name": "corsairpsu", **labels})
    rails = found(tree)
    assert {name: reading(rail).power for name, rail in rails.items()} == pytest.approx(
        {"total@hwmon0:power1": 1.0, "total@hwmon0:power2": 2.0}
    )


def test_a_scale_that_is_no_number_is_told(tree):
    tree.iio({**rail_trees.INA226_IIO, "in_power2_scale": "lots"})
    with pytest.raises(LinkError, match="in_power2_scale holds 'lots'"):
        found(tree)


# What check says.


def check(tree, *rails, **settings):
    return list(PowerRails(list(rails) or None, root=tree.root, **settings).check(Circumstances()))


def test_an_unknown_rail_is_answered_with_the_nearest_and_all_there_are(tree):
    tree.hwmon(rail_trees.JETSON_ORIN)
    (finding,) = check(tree, "VDD_CPU", "VDD_INN")
    assert finding.problem == "there is no rail 'VDD_CPU', 'VDD_INN'"
    assert "'VDD_IN'?" in finding.fix
    assert "'VDD_SOC'" in finding.fix


def test_of_several_rails_those_to_measure_must_be_named(tree):
    tree.hwmon(rail_trees.JETSON_ORIN)
    (finding,) = check(tree)
    assert finding.problem == "there are 3 rails"
    assert "'VDD_IN', 'VDD_CPU_GPU_CV', 'VDD_SOC'" in finding.fix


def test_a_computer_without_any_is_told_to_load_a_driver(tree):
    tree.hwmon(rail_trees.THERMAL)
    (finding,) = check(tree)
    assert "no driver in /sys shows a rail" in finding.problem
    assert "driver" in finding.fix


def test_a_rail_without_power_is_warned_of(tree):
    tree.hwmon(rail_trees.AMDGPU)
    (finding,) = check(tree, "vddgfx")
    assert not finding.is_error
    assert "reports its voltage only" in finding.problem


def test_the_only_rail_needs_no_name(tree):
    tree.hwmon(rail_trees.THERMAL)
    tree.hwmon(rail_trees.INA226)
    assert check(tree) == []


@pytest.mark.parametrize("rails", ["VDD_IN", [], ["A B", "A-B"], ["A", "A"]])
def test_rails_that_cannot_be_are_refused(rails):
    with pytest.raises(PluginError):
        PowerRails(rails)


# What is measured.


def measured(tmp_path, tree, clock, rails=None, seconds=10.0, **settings):
    plugin = PowerRails(rails, root=tree.root, **settings)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
    context.resources.close()
    return context


def test_energy_is_the_integral_of_a_power_that_changes(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA226)

    def load() -> None:
        write(folder / "power1_input", round((7.6 + 0.5 * (clock.now() - 10.0)) * 1e6))

    clock.every(0.05, load)
    context = measured(tmp_path, tree, clock)
    assert context.measures["Energy"] == pytest.approx(76.0 + 25.0, rel=0.01)
    assert context.measures["MeanPower"] == pytest.approx(10.1, rel=0.01)
    assert context.measures["MeanVoltage"] == pytest.approx(12.4)
    assert context.measures["MeanCurrent"] == pytest.approx(0.613)
    assert problems(context) == []
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert list(next(csv.DictReader(file))) == ["time_s", "power_W", "voltage_V", "current_A"]


def test_each_of_several_rails_has_measures_of_its_own(tmp_path, tree, clock):
    tree.hwmon(rail_trees.JETSON_ORIN)
    context = measured(tmp_path, tree, clock, rails=["VDD_IN", "VDD_SOC"])
    assert context.measures["MeanPower_VDD_IN"] == pytest.approx(7.6)
    assert context.measures["Energy_VDD_SOC"] == pytest.approx(12.48)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["rails"]["VDD_IN"]["chip"] == "ina3221"
    assert facts["energy_from"] == {"VDD_IN": "power", "VDD_SOC": "power"}


@pytest.mark.parametrize("status", ["Charging", "Full", "Not charging"])
def test_the_power_of_a_battery_that_is_charged_is_not_taken_for_what_is_drawn(tmp_path, tree, clock, status):
    folder = tree.hwmon(rail_trees.BATTERY)
    clock.at(15.0, lambda: write(folder / "device" / "status", status))
    context = measured(tmp_path, tree, clock, seconds=1.0)
    assert context.measures["MeanPower"] == pytest.approx(14.8)
    assert problems(context) == []
    (doubt,) = (each for each in problems(measured(tmp_path, tree, clock, seconds=5.0)) if "battery" in each)
    assert doubt.startswith(f"rail 'BAT0:power1' is that of a battery whose status was {status!r}")


def test_what_is_no_battery_has_no_status(tmp_path, tree, clock):
    tree.hwmon({**rail_trees.ACPI_METER, "device/status": "15"})  # as each device of ACPI
    assert problems(measured(tmp_path, tree, clock, seconds=1.0)) == []


def counting(clock, folder, watts, *, first=500.0):
    """Have the counter of a device rise by so many watts from now on."""
    start = clock.now()

    def show() -> None:
        write(folder / "energy1_input", round((first + watts * (clock.now() - start)) * 1e6))

    show()
    clock.every(0.01, show)


@pytest.mark.long
def test_a_counter_of_the_sensor_itself_is_preferred_to_the_integral(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA228)
    counting(clock, folder, 7.7)
    context = measured(tmp_path, tree, clock)
    assert context.measures["Energy"] == pytest.approx(77.0, rel=1e-3)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["energy_from"] == {"": "counter"}


@pytest.mark.long
def test_a_counter_that_power_contradicts_is_doubted(tmp_path, tree, clock):
    counting(clock, tree.hwmon(rail_trees.INA228), 3.8)
    context = measured(tmp_path, tree, clock)
    (problem,) = problems(context)
    assert re.search(r"counter rose by 3[78]\.?\d* J, and its power amounts to 76 J", problem)


@pytest.mark.long
def test_a_counter_that_was_set_back_is_told_and_power_takes_its_place(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA228)
    counting(clock, folder, 7.7, first=500.0)
    clock.at(15.0, lambda: counting(clock, folder, 7.7, first=-538.5))
    context = measured(tmp_path, tree, clock)
    assert context.measures["Energy"] == pytest.approx(76.0)
    assert any("energy counter was set back" in problem for problem in problems(context))


def test_a_counter_without_a_sign_does_not_count_what_flows_back_as_drawn(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA228)
    counting(clock, folder, 7.6)
    clock.at(18.0, lambda: write(folder / "curr1_input", -613))
    context = measured(tmp_path, tree, clock)
    assert context.measures["Energy"] == pytest.approx(8 * 7.6 - 2 * 7.6, rel=0.01)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["energy_from"] == {"": "power"}


@pytest.mark.parametrize(
    ("files", "rail", "milli_ampere", "largest"),
    [(rail_trees.INA226, None, 8192, "8.19 A"), (rail_trees.JETSON_ORIN, "VDD_IN", 32760, "32.8 A")],
)
def test_a_current_at_the_end_of_the_sensors_range_is_told(tmp_path, tree, clock, files, rail, milli_ampere, largest):
    folder = tree.hwmon(files)
    clock.at(14.02, lambda: write(folder / "curr1_input", milli_ampere))
    context = measured(tmp_path, tree, clock, rails=rail and [rail])
    (problem,) = [each for each in problems(context) if "range" in each]
    assert problem.endswith(
        f"was at the end of its sensor's range, {largest}, in 120 of 201 readings: what was drawn is more"
    )


def test_a_sensor_that_is_stuck_is_noticed(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA226)

    def load() -> None:
        if clock.now() < 16.0:
            write(folder / "power1_input", round(7.6e6 + 1e5 * (clock.now() % 1)))

    clock.every(0.05, load)
    context = measured(tmp_path, tree, clock)
    (problem,) = problems(context)
    assert "reported the same value" in problem
    assert "it may be stuck" in problem


def test_files_that_fail_for_a_moment_are_counted_and_bridged(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA226)
    clock.at(12.0, (folder / "power1_input").unlink)
    clock.at(12.1, lambda: write(folder / "power1_input", 7600000))
    context = measured(tmp_path, tree, clock)
    assert context.measures["Energy"] == pytest.approx(76.0)
    assert any("power1_input could not be read" in problem for problem in problems(context))


def test_a_sensor_that_vanishes_costs_the_values_and_not_the_run(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA226)
    clock.at(13.0, (folder / "power1_input").unlink)
    context = measured(tmp_path, tree, clock)
    assert set(context.measures.values()) == {None}


def test_a_sensor_that_is_not_there_fails_the_run_before_its_mission(tmp_path, tree, clock):
    with pytest.raises(LinkError, match="no driver in /sys shows a rail"):
        measured(tmp_path, tree, clock)


def test_a_jetson_is_read_over_ssh(tmp_path, tree, server):
    tree.hwmon(rail_trees.JETSON_ORIN, address="1-0040")
    settings = {"host": "robot", "ssh_config": server.config}
    assert check(tree, "VDD_IN", **settings) == []
    (finding,) = check(tree, "VDD_OUT", **settings)
    assert "'VDD_IN'" in finding.fix
    context = measured(tmp_path, tree, SystemClock(), rails=["VDD_IN"], seconds=1.0, **settings)
    assert context.measures["MeanPower"] == pytest.approx(7.6)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    (noted,) = (fields for kind, fields in context.broker.records if kind == "clock")
    assert noted == {"owner": "PowerRails", **facts["host_clock"]}
    seconds = facts["window"]["end"] - facts["window"]["start"]  # a busy machine sleeps longer
    assert context.measures["Energy"] == pytest.approx(7.6 * seconds, rel=0.02)
    assert facts["host"] == "robot"


def test_a_connection_that_was_cut_is_told_and_its_samples_recovered(tmp_path, tree, server):
    tree.hwmon(rail_trees.INA226)
    plugin, clock = PowerRails(root=tree.root, host="robot", ssh_config=server.config), SystemClock()
    context = make_context(tmp_path, plugin, robot=None, clock=clock)

    def mission() -> None:
        clock.sleep(1.0)
        server.cut()

    rehearse(context, plugin, mission=mission)
    context.resources.close()
    assert any("recovered over a second connection" in problem for problem in problems(context))
    assert context.measures["MeanPower"] == pytest.approx(7.6)


def test_each_phase_of_a_mission_has_its_energy(tmp_path, tree, clock):
    folder = tree.hwmon(rail_trees.INA226)
    plugin = PowerRails(root=tree.root)
    context = make_context(tmp_path, plugin, robot=None, clock=clock, phases=["drive"])

    def mission() -> None:
        clock.sleep(2.0)
        write(folder / "power1_input", 10_000_000)
        with context.phase("drive"):
            clock.sleep(5.0)
        write(folder / "power1_input", 7_600_000)
        clock.sleep(3.0)

    rehearse(context, plugin, mission=mission)
    assert context.measures["Energy.drive"] == pytest.approx(50.0, rel=0.01)
    assert context.measures["Energy"] == pytest.approx(50.0 + 5 * 7.6, rel=0.01)


def test_a_computer_that_cannot_be_reached_is_told_without_asking_for_rails(tree, server):
    (finding,) = check(tree, "VDD_IN", host="nobody.invalid", ssh_config=server.config)
    assert "nobody.invalid cannot be reached" in finding.problem


class TestPowerRails(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def _tree(self, tmp_path_factory):
        self.tree = RailTree(tmp_path_factory.mktemp("sys"))
        self.tree.hwmon(rail_trees.INA228)

    def make_plugin(self) -> PowerRails:
        return PowerRails(root=self.tree.root)
