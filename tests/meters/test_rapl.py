from __future__ import annotations

import csv
import itertools
import json
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meters.fake_sysfs import FakePowercap, write
from tests.meters.rehearsed import measured, problems

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.meters.counters import unwrapped
from robot_runner.meters.rapl import find_domains
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Rapl
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse


class TestRaplOnAFakeSysfs(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def _powercap(self, tmp_path_factory):
        self.powercap = FakePowercap(tmp_path_factory.mktemp("powercap"))

    def make_plugin(self) -> Rapl:
        return Rapl(domains=["dram"], root=self.powercap.root)

    def make_context(self, folder, plugin, *, run_seed=1):
        clock = FakeClock()
        clock.every(0.05, lambda: self.powercap.draw(package=0.4, core=0.1, dram=0.05))
        clock.sleep(0.025)  # so that no edge of a mission is where the counters step
        return make_context(folder, plugin, robot=None, clock=clock, run_seed=run_seed)


@pytest.fixture
def clock():
    return FakeClock(10.0)


@pytest.fixture
def measure(tmp_path, clock):
    def execute(powercap, *, seconds=20.0, watts=8.0, **settings):
        plugin = Rapl(root=powercap.root, **settings)
        clock.every(0.05, lambda: powercap.draw(package=watts * 0.05, core=0.1, dram=0.05))
        context = make_context(tmp_path, plugin, robot=None, clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context

    return execute


class WatchedRapl(Rapl):
    """Tells when it has read."""

    def open(self, context):
        meter = super().open(context)
        read, self.has_read = meter.read, threading.Semaphore(0)

        def read_and_tell():
            reading = read()
            self.has_read.release()
            return reading

        meter.read = read_and_tell
        return meter

    def wait_for_readings(self, count):
        while self.has_read.acquire(blocking=False):
            pass
        for _ in range(count):
            assert self.has_read.acquire(timeout=60)


def test_energy_is_what_the_packages_have_counted(measure, tmp_path):
    context = measure(FakePowercap(tmp_path / "powercap"))
    assert context.measures["Energy"] == pytest.approx(160.0, rel=3e-3)
    assert context.measures["MeanPower"] == pytest.approx(8.0, rel=3e-3)
    assert problems(context) == []
    assert context.broker.measures["Energy"].origin is Origin.MEASURED


def test_domains_within_the_package_have_measures_of_their_own(measure, tmp_path):
    cpuinfo = write(tmp_path / "cpuinfo", "processor\t: 0\nvendor_id\t: GenuineIntel")
    context = measure(FakePowercap(tmp_path / "powercap"), domains=["core", "dram"], cpuinfo=cpuinfo)
    assert context.measures["CoreEnergy"] == pytest.approx(40.0, rel=3e-3)
    assert context.measures["DramEnergy"] == pytest.approx(20.0, rel=3e-3)
    assert context.measures["Energy"] == pytest.approx(160.0, rel=3e-3)


def test_the_counter_of_one_core_is_not_taken_for_that_of_all(measure, tmp_path):
    # MSR_AMD_CORE_ENERGY_STATUS is each core's own, and Linux reads that of one core of the package.
    cpuinfo = write(tmp_path / "cpuinfo", "processor\t: 0\nvendor_id\t: AuthenticAMD")
    powercap = FakePowercap(tmp_path / "powercap")
    (finding,) = Rapl(domains=["core"], root=powercap.root, cpuinfo=cpuinfo).check(Circumstances())
    assert finding.problem == "the counter `core` of an AMD processor is that of one of its cores: no value"
    assert not finding.is_error
    context = measure(powercap, domains=["core", "dram"], cpuinfo=cpuinfo, seconds=2.0)
    assert context.measures["CoreEnergy"] is None
    assert context.measures["DramEnergy"] == pytest.approx(2.0, rel=0.03)
    assert context.measures["Energy"] == pytest.approx(16.0, rel=0.03)
    assert finding.problem in [each.problem for each in context.broker.findings]
    assert list(Rapl(domains=["dram"], root=powercap.root, cpuinfo=cpuinfo).check(Circumstances())) == []


def test_a_counter_that_begins_anew_several_times_is_followed(measure, tmp_path):
    powercap = FakePowercap(tmp_path / "powercap", package=29_000_000, wraps_at=30_000_000)
    assert measure(powercap).measures["Energy"] == pytest.approx(160.0, rel=3e-3)


@given(steps=st.lists(st.integers(0, 499), max_size=50), start=st.integers(0, 999))
def test_an_unwrapped_counter_never_falls_and_agrees_with_the_true_one(steps, start):
    true = list(itertools.accumulate(steps, initial=start))
    assert unwrapped([count % 1000 for count in true], wraps_at=1000) == [count - start for count in true]


@pytest.mark.parametrize("package", [90_000_000_000, 200_000_000_000, 260_000_000_000])
def test_a_counter_that_is_set_back_is_not_taken_for_one_that_went_round(measure, tmp_path, clock, package):
    # As where the computer was suspended meanwhile, which its clock does not tell of.
    powercap = FakePowercap(tmp_path / "powercap", package=package, wraps_at=262_143_000_000)

    def suspend():
        powercap.counts["intel-rapl:0"] = 0

    clock.at(20.0, suspend)
    context = measure(powercap)
    assert context.measures["Energy"] == pytest.approx(160.0, rel=0.01)
    assert "the counter of package-0 was set back: what it counted shortly before that is lost" in problems(context)


def test_a_counter_that_jumps_ahead_is_doubted(measure, tmp_path, clock):
    powercap = FakePowercap(tmp_path / "powercap")
    clock.at(20.0, lambda: powercap.draw(package=2_000.0))
    told = "the counter of package-0 jumped ahead by more than can have been drawn"
    assert told in problems(measure(powercap))


@pytest.mark.parametrize(
    ("before", "misread"), [(90_000_000_000, 0), (90_000_000_000, 89_999_999_000), (240_000_000_000, 0)]
)
def test_a_count_that_is_misread_once_is_passed_over_and_told(measure, tmp_path, clock, before, misread):
    powercap = FakePowercap(tmp_path / "powercap", package=before, wraps_at=262_143_000_000)
    clock.at(20.06, lambda: write(powercap.root / "intel-rapl:0" / "energy_uj", misread))
    draw = powercap.draw

    def draw_but_then(**joules):
        draw(**joules)
        if 20.06 < clock.now() < 20.14:
            write(powercap.root / "intel-rapl:0" / "energy_uj", misread)

    powercap.draw = draw_but_then
    context = measure(powercap)
    assert context.measures["Energy"] == pytest.approx(160.0, rel=0.01)
    assert any("was set back" in problem for problem in problems(context))


def test_a_counter_that_stands_still_has_not_counted_0_joules(measure, tmp_path):
    context = measure(FakePowercap(tmp_path / "powercap", package=5_000_000), watts=0.0, domains=["dram"])
    assert context.measures["Energy"] is None
    assert context.measures["MeanPower"] is None
    assert context.measures["DramEnergy"] == pytest.approx(20.0, rel=0.01)
    assert [finding.problem for finding in context.broker.findings] == [
        "the counter of package-0 stood still at 5000000 uJ: no value"
    ]


def test_a_counter_that_stands_still_for_a_part_of_the_mission_is_doubted(measure, tmp_path, clock):
    powercap = FakePowercap(tmp_path / "powercap")

    def freeze():
        powercap.draw = lambda **_: None

    clock.at(22.02, freeze)
    context = measure(powercap)
    assert context.measures["Energy"] == pytest.approx(0.6 * 160.0, rel=0.01)  # of 20 s
    assert problems(context) == [
        "the counter of package-0 stood still for 7.9 s: its energy may lack what was used then"
    ]


def test_a_counter_that_vanishes_half_way_costs_its_values_and_not_the_run(measure, tmp_path, clock):
    powercap = FakePowercap(tmp_path / "powercap")
    counter = powercap.root / "intel-rapl:0" / "energy_uj"

    def vanish():
        powercap.draw = lambda **_: None
        counter.unlink()

    clock.at(20.0, vanish)
    context = measure(powercap)
    assert set(context.measures.values()) == {None}
    assert any("readings failed, the first with: FileNotFoundError" in problem for problem in problems(context))


def test_raw_counters_are_kept_as_they_were_read(measure, tmp_path):
    context = measure(FakePowercap(tmp_path / "powercap", package=123), domains=["dram"], seconds=1.0)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "package-0_uJ", "package-0/dram_uJ"]
    assert rows[0]["package-0_uJ"] == "123"
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["domains"][0] == {"label": "package-0", "wraps_at_uJ": 262_143_328_850}
    assert facts["clock"] == "run"


def test_two_sockets_are_added_up(measure, tmp_path, clock):
    powercap = FakePowercap(tmp_path / "powercap")
    for file, content in {"name": "package-1", "energy_uj": 30_000_000, "max_energy_range_uj": 10**10}.items():
        write(powercap.root / "intel-rapl:1" / file, content)
    assert [domain.label for domain in find_domains(powercap.root)] == [
        "package-0",
        "package-0/core",
        "package-0/dram",
        "package-1",
    ]
    clock.every(0.05, lambda: write(powercap.root / "intel-rapl:1" / "energy_uj", round(3e6 * clock.now())))
    assert measure(powercap).measures["Energy"] == pytest.approx(160.0 + 60.0, rel=3e-3)


def dies(root, count):
    """Lay out a package of so many dies, whose counters agree; the kernel numbers them in hexadecimal."""
    for number in range(count):
        files = {"name": f"package-0-die-{number}", "energy_uj": 0, "max_energy_range_uj": 65_532_610_987}
        for file, content in files.items():
            write(root / f"intel-rapl:{number:x}" / file, content)


# Linux before 6.12 has a package of an AMD processor once for each of its dies, which all show its one counter.
# (drivers/powercap/intel_rapl_common.c, rapl_msrs_are_pkg_scope).
@pytest.mark.parametrize(("vendor", "packages"), [("AuthenticAMD", 1), ("HygonGenuine", 1), ("GenuineIntel", 12)])
def test_the_counter_of_an_amd_package_is_not_counted_once_for_each_of_its_dies(tmp_path, clock, vendor, packages):
    root, cpuinfo = tmp_path / "powercap", write(tmp_path / "cpuinfo", f"processor\t: 0\nvendor_id\t: {vendor}")
    dies(root, 12)

    def draw() -> None:
        for number in range(12):
            write(root / f"intel-rapl:{number:x}" / "energy_uj", round(68e6 * (clock.now() - 10.0)))

    clock.every(0.1, draw)
    context = measured(tmp_path, Rapl(root=root, cpuinfo=cpuinfo), clock, 2.0)
    assert context.measures["Energy"] == pytest.approx(packages * 136.0, rel=0.01)


def test_on_a_simulated_robot_power_is_that_of_real_time(tmp_path):
    pytest.importorskip("mujoco")
    powercap = FakePowercap(tmp_path / "powercap")
    plugin = WatchedRapl(root=powercap.root, rate_hz=20.0)
    context = make_context(tmp_path, plugin, robot="simulated")

    def mission():
        context.clock.sleep(60.0)  # takes a moment of real time
        # What is drawn between two readings is spread over both: these lie within the mission, however late they come.
        plugin.wait_for_readings(2)
        powercap.draw(package=6.0)
        plugin.wait_for_readings(2)
        SystemClock().sleep(0.3)

    rehearse(context, plugin, mission=mission)
    context.resources.close()
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    seconds = facts["window"]["end"] - facts["window"]["start"]
    assert 0.3 < seconds < 60.0
    assert context.measures["Energy"] == pytest.approx(6.0)
    assert context.measures["MeanPower"] == pytest.approx(context.measures["Energy"] / seconds)
    assert facts["clock"] == "machine"


def test_the_check_warns_that_this_machine_is_not_the_simulated_robot(tmp_path):
    powercap = FakePowercap(tmp_path)
    (finding,) = Rapl(root=powercap.root).check(Circumstances(robot="simulated"))
    assert not finding.is_error
    assert "the machine that simulates it" in finding.problem


def test_a_machine_without_counters_is_refused_with_what_it_takes(tmp_path):
    (finding,) = Rapl(root=tmp_path).check(Circumstances())
    assert finding.is_error
    assert "no energy counter" in finding.problem
    assert "modprobe intel_rapl_msr" in finding.fix


def test_counters_that_may_not_be_read_are_told_with_the_command_that_mends_it(tmp_path):
    powercap = FakePowercap(tmp_path)
    counter = powercap.root / "intel-rapl:0" / "energy_uj"
    counter.unlink()
    counter.mkdir()  # cannot be read by anybody, not even by root, who executes the tests in a container
    (finding,) = Rapl(root=powercap.root).check(Circumstances())
    assert "energy_uj cannot be read" in finding.problem
    assert "sudo chmod a+r" in finding.fix


def test_a_domain_that_the_machine_lacks_is_told_with_those_that_it_has(tmp_path):
    (finding,) = Rapl(domains=["psys"], root=FakePowercap(tmp_path).root).check(Circumstances())
    assert "'psys'" in finding.problem
    assert "'dram'" in finding.fix


def test_a_machine_without_counters_fails_the_run(tmp_path):
    plugin = Rapl(root=tmp_path / "nothing")
    with pytest.raises(PluginError, match="no energy counter"):
        rehearse(make_context(tmp_path, plugin, robot=None), plugin)


def test_a_domain_that_cannot_be_is_refused_with_the_nearest():
    with pytest.raises(PluginError, match="'dramm'") as refusal:
        Rapl(domains=["dramm"])
    assert refusal.value.fix == "Did you mean 'dram'?"


@pytest.mark.skipif(sys.platform != "linux" or list(Rapl().check(Circumstances())) != [], reason="needs a real RAPL")
def test_the_counters_of_this_machine_count(tmp_path):
    plugin = Rapl()
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: SystemClock().sleep(0.5))
    assert 0.1 < context.measures["MeanPower"] < 2000.0
