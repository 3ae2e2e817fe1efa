from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path

import pytest
from tests.meters.fake_sysfs import write
from tests.meters.rehearsed import InRealTime

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.meters.command_meters import parse_energibridge
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import EnergiBridge
from robot_runner.testing import ProfilerContract, make_context, rehearse

# Rows of an Apple M1 as EnergiBridge's README shows them, without the columns of eight more cores; the second row's
# time is that of the first and its Delta.
RECORDED = """\
Delta,Time,CPU_TEMP_0,CPU_USAGE_0,CPU_USAGE_1,SYSTEM_POWER (Watts),TOTAL_MEMORY,TOTAL_SWAP,USED_MEMORY,USED_SWAP
0,1697704464320,46.529457092285156,46.37215805053711,45.429779052734375,11.58033275604248,34359738368,0,10188488704,0
104,1697704464424,46.529457092285156,46.37215042114258,45.429771423339844,11.58033275604248,34359738368,0,10189275136,0
"""


def stand_in(folder: Path) -> str:
    """Return the stand-in as a program on its own."""
    path = folder / "bin" / "energibridge"
    path.parent.mkdir()
    source = Path(__file__).with_name("energibridge_program.py")
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{source}" "$@"\n', encoding="utf-8")
    path.chmod(0o755)
    return str(path)


@pytest.fixture
def program(tmp_path):
    return stand_in(tmp_path)


class TestEnergiBridgeOnAStandIn(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.1

    @pytest.fixture(autouse=True)
    def _program(self, tmp_path_factory):
        folder = tmp_path_factory.mktemp("bin")
        self.program = stand_in(folder)
        self.devices = folder / "cpu"
        write(self.devices / "0" / "msr", "")

    def make_plugin(self) -> EnergiBridge:
        plugin = EnergiBridge(program=self.program, interval_ms=100, devices=self.devices)
        plugin.period_s = 0.3  # lets gaps pass, for a machine that is busy with other tests
        return plugin


def test_energy_is_that_of_the_counter_also_where_it_begins_anew(tmp_path, program):
    plugin = EnergiBridge(program=program, interval_ms=100)
    plugin.period_s = 0.3
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: time.sleep(0.5))
    window = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    assert context.measures["Energy"] == pytest.approx(10.0 * (window["end"] - window["start"]), rel=0.02)
    assert context.measures["MeanPower"] == pytest.approx(10.0, rel=0.02)
    assert context.measures["CPU"] == pytest.approx(40.0)
    assert context.measures["Memory"] == pytest.approx(25.0)
    assert not [finding for finding in context.broker.findings if "program" in finding.problem]


def test_apples_power_becomes_energy():
    rows = [row for row in parse_energibridge(RECORDED.splitlines()) if row]
    assert rows[0]["energy_J"] == 0.0
    assert rows[1]["energy_J"] == pytest.approx(11.58033275604248 * 0.104)
    assert rows[1]["cpu_percent"] == pytest.approx(45.9, abs=0.01)
    assert rows[1]["memory_percent"] == pytest.approx(29.65, abs=0.01)


@pytest.mark.parametrize("energy_range", [65_536.0, 262_144.0])
def test_the_range_of_a_counter_is_the_power_of_two_above_it(energy_range):
    records = ["Delta,Time,CPU_ENERGY (J)", f"0,0,{energy_range - 10}", "200,200,5"]
    assert parse_energibridge(records)[-1]["energy_J"] == pytest.approx(15.0)


def test_a_counter_that_was_set_back_near_its_range_has_not_gone_round_without_time_to():
    records = ["Delta,Time,PACKAGE_ENERGY (J)", "0,1000,250000.0", "200,1200,250005.0", "200,1400,3.0"]
    assert math.isnan(parse_energibridge(records)[-1]["energy_J"])


def test_a_counter_that_was_set_back_far_from_its_range_has_not_gone_round():
    records = ["Delta,Time,PACKAGE_ENERGY (J)", "0,0,40000.0", "200,200,40010.0", "200,400,5.0", "200,600,15.0"]
    assert [math.isnan(row["energy_J"]) for row in parse_energibridge(records)[1:]] == [False, False, True, True]


@pytest.mark.parametrize(
    ("heading", "cells", "joules"),
    [("CPU_ENERGY (J)", ("50000", "", "50003"), 3.0), ("SYSTEM_POWER (Watts)", ("5", "", "7.5"), 3.0)],
)
def test_a_row_without_energy_is_bridged_by_the_next(heading, cells, joules):
    rows = [f"200,{200 * number},{cell}" for number, cell in enumerate(cells)]
    told = [row["energy_J"] for row in parse_energibridge([f"Delta,Time,{heading}", *rows])[1:]]
    assert told == [0.0, None, pytest.approx(joules)]


@pytest.fixture
def doubts(tmp_path):
    """Executes a run in which these records came, and returns what is doubtful about its energy."""

    def execute(records):
        program = write(tmp_path / "energibridge", f"#!/bin/sh\ncat >\"$2\" <<'END'\n{records}END\nexec cat")
        program.chmod(0o755)
        plugin = EnergiBridge(program=str(program), cores=tmp_path)
        context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
        rehearse(context, plugin, mission=lambda: time.sleep(0.01))
        return [each.problem for each in context.broker.findings if "reads" in each.problem or "whole" in each.problem]

    return execute


def test_the_power_of_a_whole_mac_is_not_taken_for_the_processors(doubts):
    (problem,) = doubts(RECORDED)
    assert problem.startswith("the power is that of the whole computer (SYSTEM_POWER (Watts))")
    assert doubts(RECORDED.replace("SYSTEM_POWER (Watts)", "CPU_POWER (Watts)")) == []


def test_of_two_processors_one_is_read_and_that_is_told(tmp_path, doubts):
    records = "Delta,Time,PACKAGE_ENERGY (J)\n0,0,10\n200,200,12\n"
    for core, package in enumerate("0011"):
        write(tmp_path / f"cpu{core}" / "topology" / "physical_package_id", package)
    assert doubts(records) == ["EnergiBridge reads one processor, and this machine has 2"]
    for core in (2, 3):
        write(tmp_path / f"cpu{core}" / "topology" / "physical_package_id", 0)
    assert doubts(records) == []


def test_a_machine_without_a_counter_yields_no_energy():
    records = ["Delta,Time,CPU_USAGE_0", "0,0,10"]
    assert parse_energibridge(records)[-1]["energy_J"] is None


@pytest.mark.skipif(sys.platform != "linux", reason="registers are files on Linux")
def test_what_it_needs_is_told(tmp_path):
    program, registers = EnergiBridge(program="no-such-program", devices=tmp_path).check(Circumstances())
    assert "https://github.com/tdurieux/EnergiBridge" in program.fix
    assert "modprobe msr" in registers.fix


def test_an_interval_that_cannot_be_is_refused():
    with pytest.raises(PluginError, match="interval_ms is 0"):
        EnergiBridge(interval_ms=0)
