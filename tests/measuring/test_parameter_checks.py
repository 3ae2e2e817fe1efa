"""What cannot be is refused by each profiler in the same words, whatever its type."""

from __future__ import annotations

import math

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.plugins import Circumstances, Measure
from robot_runner.plugins.profilers import (
    CodeCarbon,
    CommandColumn,
    CommandProfiler,
    EnergiBridge,
    Ina219,
    LabCamera,
    LinuxThermal,
    Nvml,
    PerfStat,
    PsUtil,
    Rapl,
    Scpi,
    SmartPlug,
)

COLUMNS = [CommandColumn("watts", Measure("Power", "W", "Power."))]


@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf, "10", True, None])
def test_a_number_is_finite_above_0_and_no_text(value):
    with pytest.raises(PluginError) as refusal:
        PsUtil(rate_hz=value)
    assert (refusal.value.problem, refusal.value.fix) == (f"rate_hz is {value!r}", "Give rate_hz a number above 0.")


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: EnergiBridge(interval_ms="200"), "interval_ms"),
        (lambda: PerfStat(interval_ms=math.inf), "interval_ms"),
        (lambda: CommandProfiler(command=["meter"], columns=COLUMNS, period_s=math.inf), "period_s"),
        (lambda: Ina219(shunt_ohm=math.inf), "shunt_ohm"),
        (lambda: Ina219(rate_hz="200"), "rate_hz"),
        (lambda: CodeCarbon(country="NLD", interval_s=math.inf), "interval_s"),
        (lambda: LabCamera("/dev/video0", rate_hz=math.inf), "rate_hz"),
        (lambda: SmartPlug("tasmota", url="http://plug", timeout_s="2"), "timeout_s"),
    ],
)
def test_each_profiler_refuses_a_number_that_cannot_be(make, name):
    with pytest.raises(PluginError, match=f"Give {name} a number above 0"):
        make()


@pytest.mark.parametrize(
    ("make", "fix"),
    [
        (lambda: LinuxThermal(zones="cpu-thermal"), "zones=['cpu-thermal']"),
        (lambda: Rapl(domains="dram"), "domains=['dram']"),
        (lambda: Nvml(gpus=0), "gpus=[0]"),
        (lambda: PsUtil(host="localhost", cores=1), "cores=[1]"),
        (lambda: Scpi("TCPIP::lab", setup=None), "setup=[]"),
        (lambda: CommandProfiler(command="meter --csv", columns=COLUMNS), "command=['meter', '--csv']"),
    ],
)
def test_a_text_or_a_number_is_not_taken_for_a_list(make, fix):
    with pytest.raises(PluginError) as refusal:
        make()
    assert refusal.value.fix == f"Give a list: {fix}."


def test_a_folder_may_be_a_text(tmp_path):
    (tmp_path / "class" / "thermal").mkdir(parents=True)
    assert next(iter(LinuxThermal(root=str(tmp_path)).check(Circumstances()))).is_error
