"""The demo is equivalent to itself under another seed, and differs where its tasks draw more power."""

from __future__ import annotations

import subprocess

from tests.analysis.conftest import PROGRAM

from robot_runner.analysis.comparison.compared import Verdict
from robot_runner.analysis.comparison.comparing import compare


def execute(*words):
    subprocess.run([PROGRAM, *words], check=True, capture_output=True, timeout=200)


def test_the_demo_compared_with_itself_and_with_a_hungrier_robot(executed_demo, tmp_path):
    text = (executed_demo / "robot-runner-demo" / "demo.py").read_text()
    again, hungrier = tmp_path / "again.py", tmp_path / "hungrier.py"
    again.write_text(text.replace("seed=2021", "seed=77"))
    hungrier.write_text(text.replace("range(1, 6)", "range(1, 4)"))  # three repetitions show it as well as five do
    execute("run", again, "--set", "experiment_name=again")
    execute("run", hungrier, "--set", "experiment_name=hungrier", "--set", "robot=simulated:task_power_factor=1.1")
    original = executed_demo / "robot-runner-demo" / "basic_experiment"
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
