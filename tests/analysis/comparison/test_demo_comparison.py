"""The demo is equivalent to itself under another seed, and differs where its tasks draw more power."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from robot_runner.analysis.comparison.compared import Verdict
from robot_runner.analysis.comparison.comparing import compare

PROGRAM = Path(sys.executable).with_name("robot-runner")


def execute(*words):
    subprocess.run([PROGRAM, *words], check=True, capture_output=True, timeout=60)


def test_the_demo_compared_with_itself_and_with_a_hungrier_robot(tmp_path):
    execute("demo", "--folder", tmp_path)
    config = tmp_path / "other.py"
    config.write_text((tmp_path / "demo.py").read_text().replace("seed=2021", "seed=77"))
    execute("run", config, "--set", "experiment_name=again")
    execute("run", config, "--set", "experiment_name=hungrier", "--set", "robot=simulated:task_power_factor=1.1")
    original = tmp_path / "basic_experiment"
    assert compare(original, tmp_path / "again", bound="5%").verdict is Verdict.EQUIVALENT
    energy = compare(original, tmp_path / "again", bound=["Energy=2%"]).measure("Energy")
    assert energy.verdict is Verdict.EQUIVALENT
    found = compare(original, tmp_path / "hungrier", bound=["2%"])
    energy = found.measure("Energy")
    assert [each.verdict for each in energy.differences] == [Verdict.DIFFERENT] * 3
    assert found.verdict is Verdict.DIFFERENT
    assert found.measure("Memory").verdict is not Verdict.DIFFERENT
    assert ("Robot", "simulated", "simulated:task_power_factor=1.1") in found.differing
    # Half a minute of tasks at 8 to 9.5 W, and a tenth more: 25 to 29 J of some 850 J.
    assert all(20.0 < each.difference < 35.0 for each in energy.differences)
