from __future__ import annotations

import json
import sys

import pytest
from tests.meters.fake_sysfs import FakePowercap, write
from tests.meters.rehearsed import InRealTime
from tests.python_program import first_lines
from tests.waiting import wait_until

from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.meters.command_meters import parse_powerjoular
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import PowerJoular
from robot_runner.testing import ProfilerContract, make_context, rehearse

# What PowerJoular (built from its source of September 2025) wrote in a virtual machine, with `-m FILE -s watts`.
RECORDED = """\
Date,CPU Utilization,Total Power,CPU Power,GPU Power
2026-11-21 02:20:09,1.00000000000000,12.50000000000000,12.50000000000000,0.00000000000000
2026-11-21 02:20:10,0.50000000000000,7.50000000000000,7.50000000000000,0.00000000000000
"""
# And what it wrote there without, where it found no energy counter.
RECORDED_WITHOUT_COUNTER = """\
Date,CPU Utilization,Total Power,CPU Power,GPU Power
2026-11-21 02:20:16,1.00000000000000,0.00000000000000,0.00000000000000,0.00000000000000
"""

STAND_IN = """\
{first_lines}# Stands in for PowerJoular: writes the recorded rows, a hundred times as fast, until it is interrupted.
import sys, time
output = sys.argv[sys.argv.index("-f") + 1]
heading, *rows = {recorded!r}.splitlines()
try:
    for number in range(1_000_000):
        time.sleep(0.01)
        with open(output, "a", encoding="ascii") as file:
            file.write((heading + "\\n" if number == 0 else "") + rows[number % len(rows)] + "\\n")
except KeyboardInterrupt:
    print("\\n--------------------------\\nTotal energy: 50.00 Joules, including:")
"""


def stand_in(folder, recorded=RECORDED) -> str:
    path = folder / "powerjoular"
    path.write_text(STAND_IN.format(first_lines=first_lines(), recorded=recorded), encoding="ascii")
    path.chmod(0o755)
    return str(path)


class TestPowerJoularOnAStandIn(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.05

    @pytest.fixture(autouse=True)
    def _machine(self, tmp_path_factory):
        self.folder = tmp_path_factory.mktemp("machine")
        self.program = stand_in(self.folder)
        FakePowercap(self.folder / "powercap")

    def make_plugin(self) -> PowerJoular:
        plugin = PowerJoular(program=self.program, powercap=self.folder / "powercap")
        plugin.period_s = 0.3
        return plugin


@pytest.fixture
def measure(tmp_path):
    def execute(recorded):
        plugin = PowerJoular(program=stand_in(tmp_path, recorded))
        plugin.period_s = 6.0  # a machine that is busy for seconds costs no value
        context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
        output = context.raw_data_folder / "powerjoular.csv"

        def mission():
            begun = output.read_text().count("\n")
            wait_until(lambda: output.read_text().count("\n") > begun + 20, "rows of both kinds are there")

        rehearse(context, plugin, mission=mission)
        return context

    return execute


def test_power_and_utilisation_are_means_over_the_window(measure):
    context = measure(RECORDED)
    power = context.measures["MeanPower"]
    window = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    assert 7.5 < power < 12.5
    assert context.measures["CPU"] == pytest.approx(50.0 + 10.0 * (power - 7.5))  # both rows weigh alike in both
    assert context.measures["Energy"] == pytest.approx(power * (window["end"] - window["start"]))


def test_zero_watts_are_no_power_but_a_counter_that_was_not_found(measure):
    context = measure(RECORDED_WITHOUT_COUNTER)
    assert context.measures["Energy"] is None
    assert context.measures["MeanPower"] is None
    assert context.measures["CPU"] == pytest.approx(100.0)
    assert any("reported 0 W" in finding.problem for finding in context.broker.findings)


# Version 0.7.3 does not notice that a counter of 2^32 x 61 uJ has wrapped; 1.1.0 adds that range where the one of the
# memory, 2^32 x 15.3 uJ, has (powerjoular.adb).
@pytest.mark.parametrize("watts", ["-262131.83500000000000", "196608.50000000000000"])
def test_a_counter_that_wrapped_unnoticed_is_no_power(measure, watts):
    context = measure(RECORDED.replace("7.50000000000000", watts))
    assert context.measures["MeanPower"] == pytest.approx(12.5)
    (problem,) = {finding.problem for finding in context.broker.findings if "draws" in finding.problem}
    assert f"rows hold no number in column 'Total Power', the first '{watts} W, which no computer draws'" in problem


@pytest.fixture
def doubts(tmp_path):
    """Executes a run in which these records came, and returns what is doubtful about its energy."""

    def execute(records=RECORDED):
        plugin = PowerJoular(program=stand_in(tmp_path, records), powercap=tmp_path)
        plugin.period_s = 0.3
        context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
        written = context.raw_data_folder / "powerjoular.csv"
        rehearse(context, plugin, mission=lambda: wait_until(lambda: written.read_text().count("\n") > 4))
        return [
            finding.problem
            for finding in context.broker.findings
            if "reads" in finding.problem or "lack" in finding.problem
        ]

    return execute


def found_with_second_counter(tmp_path, name):
    FakePowercap(tmp_path)
    for file, content in (("name", name), ("energy_uj", 0), ("max_energy_range_uj", 10**12)):
        write(tmp_path / "intel-rapl:1" / file, content)
    (finding,) = PowerJoular(program=sys.executable, powercap=tmp_path).check(Circumstances())
    return finding


# What it reads: intel_rapl_sysfs.adb of PowerJoular 1.1.1.
def test_a_counter_of_the_whole_platform_is_not_taken_for_the_processors(tmp_path, doubts):
    finding = found_with_second_counter(tmp_path, "psys")
    assert not finding.is_error
    assert "the whole platform (psys)" in finding.problem
    assert doubts() == [finding.problem]


def test_of_two_processors_one_is_read_and_that_is_told(tmp_path, doubts):
    finding = found_with_second_counter(tmp_path, "package-1")
    assert "package-0 alone, and this machine has 2 packages" in finding.problem
    assert doubts() == [finding.problem]


def test_a_machine_with_one_processor_is_not_doubted(tmp_path, doubts):
    FakePowercap(tmp_path)
    assert doubts() == []


def test_rows_in_which_the_gpu_was_silent_are_doubted(tmp_path, doubts):
    # nvidia_smi.adb: where nvidia-smi fails or answers no number, PowerJoular adds 0 W.
    FakePowercap(tmp_path)
    (problem,) = doubts(RECORDED.replace("12.50000000000000,0.00000000000000", "12.50000000000000,30.00000000000000"))
    assert problem.startswith("the GPU reported no power in ")


def test_recorded_rows_are_read():
    rows = parse_powerjoular(RECORDED.splitlines())
    assert rows[0] is None
    assert rows[2]["Total Power"] == "7.50000000000000"


def test_on_a_raspberry_pi_its_values_are_estimates(tmp_path):
    board = write(tmp_path / "model", "Raspberry Pi 4 Model B Rev 1.2")
    assert PowerJoular(board=board).origin is Origin.ESTIMATED
    assert PowerJoular(board=tmp_path / "none").origin is Origin.MEASURED


def test_what_it_needs_is_told(tmp_path):
    program, counters = PowerJoular(program="no-such-program", powercap=tmp_path).check(Circumstances())
    assert "https://github.com/joular/powerjoular" in program.fix
    assert "no energy counter" in counters.problem


def test_power_of_a_virtual_machine_needs_no_counter(tmp_path):
    plugin = PowerJoular(program=sys.executable, arguments=["-m", "power.txt"], powercap=tmp_path)
    assert list(plugin.check(Circumstances())) == []
