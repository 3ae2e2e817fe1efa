from __future__ import annotations

import json

import pytest
from tests.meters.rehearsed import InRealTime
from tests.python_program import first_lines

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.meters.command_meters import parse_powermetrics
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Powermetrics
from robot_runner.testing import ProfilerContract, make_context, rehearse

# Written by hand after what powermetrics prints on an Apple M-series and on an Intel Mac (`--format plist`).
APPLE = """\
<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE plist PUBLIC "-//Apple//DTD PLIST 1.0//EN" "http://www.apple.com/DTDs/PropertyList-1.0.dtd">
<plist version="1.0">
<dict>
<key>is_delta</key><true/>
<key>elapsed_ns</key><integer>100000000</integer>
<key>hw_model</key><string>Mac14,12</string>
<key>processor</key>
<dict>
<key>cpu_power</key><real>2978.45</real>
<key>gpu_power</key><real>269.614</real>
<key>ane_power</key><real>0</real>
<key>combined_power</key><real>3248.07</real>
</dict>
</dict>
</plist>
"""
INTEL = (
    '<plist version="1.0"><dict><key>elapsed_ns</key><integer>1000000000</integer>'
    "<key>processor</key><dict><key>package_watts</key><real>12.5</real></dict></dict></plist>"
)

STAND_IN = """\
{first_lines}
# Stands in for powermetrics: writes a property list each 100 ms, with a NUL between two, until it is interrupted.
import sys, time
output = sys.argv[sys.argv.index("--output-file") + 1]
with open(output, "w", encoding="ascii") as file:
    try:
        while True:
            time.sleep(0.1)
            file.write({record!r} + "\\0")
            file.flush()
    except KeyboardInterrupt:
        pass
"""


def stand_in(folder) -> str:
    path = folder / "powermetrics"
    path.write_text(STAND_IN.format(first_lines=first_lines(), record=APPLE), encoding="ascii")
    path.chmod(0o755)
    return str(path)


class TestPowermetricsOnAStandIn(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.1

    @pytest.fixture(autouse=True)
    def _program(self, tmp_path_factory):
        self.program = stand_in(tmp_path_factory.mktemp("bin"))

    def make_plugin(self) -> Powermetrics:
        plugin = Powermetrics(command=[self.program], interval_ms=100)
        plugin.period_s = 0.3  # lets gaps pass, for a machine that is busy with other tests
        return plugin


def test_property_lists_become_energy(tmp_path):
    plugin = Powermetrics(command=[stand_in(tmp_path)], interval_ms=100)
    plugin.period_s = 0.3
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: SystemClock().sleep(0.5))
    window = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    assert context.measures["MeanPower"] == pytest.approx(3.24807)
    assert context.measures["Energy"] == pytest.approx(3.24807 * (window["end"] - window["start"]))
    assert {each.origin for each in context.broker.measures.values()} == {Origin.ESTIMATED}


def test_the_parts_of_an_apple_processor_are_told_apart():
    (row,) = parse_powermetrics([APPLE])
    assert row == pytest.approx({"seconds": 0.1, "power_W": 3.24807, "cpu_W": 2.97845, "gpu_W": 0.269614})


def test_an_intel_mac_tells_its_package_in_watts():
    assert parse_powermetrics([INTEL])[0]["power_W"] == 12.5


def test_a_list_that_was_torn_when_the_program_ended_is_no_row():
    assert parse_powermetrics([APPLE, APPLE[:200], ""])[1:] == [None, None]


def test_a_machine_that_is_no_mac_is_refused():
    findings = list(Powermetrics(command=["no-such-sudo", "-n", "no-such-powermetrics"]).check(Circumstances()))
    assert [finding.problem for finding in findings] == [
        "the program 'no-such-sudo' is not there",
        "the program 'no-such-powermetrics' is not there",
    ]
    assert "macOS" in findings[0].fix


def test_an_interval_that_cannot_be_is_refused():
    with pytest.raises(PluginError, match="interval_ms is -1"):
        Powermetrics(interval_ms=-1)
