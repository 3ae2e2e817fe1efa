"""The demo is equivalent to itself under another seed, and differs where its tasks draw more power."""

from __future__ import annotations

import pytest

from robot_runner.analysis.comparison.compared import Verdict
from robot_runner.analysis.comparison.comparing import compare


@pytest.mark.long
def test_the_demo_compared_with_itself_and_with_a_hungrier_robot(executed_demo, tmp_path, robot_runner):
    text = (executed_demo / "robot-runner-demo" / "demo.py").read_text().replace("range(1, 6)", "range(1, 4)")
    again, hungrier = tmp_path / "again.py", tmp_path / "hungrier.py"  # three repetitions show it as well as five do
    again.write_text(text.replace("seed=2021", "seed=77"))
    hungrier.write_text(text)
    named = ("--plain", "--set")
    assert robot_runner("run", again, *named, "experiment_name=again").code == 0
    words = ("experiment_name=hungrier", "--set", "robot=simulated:task_power_factor=1.1")
    assert robot_runner("run", hungrier, *named, *words).code == 0
    original = executed_demo / "robot-runner-demo" / "basic_experiment"
    assert compare(original, tmp_path / "again", bound=["10%", "Energy=2%"]).verdict is Verdict.EQUIVALENT
    found = compare(original, tmp_path / "hungrier", bound=["2%"])
    energy = found.measure("Energy")
    assert [each.verdict for each in energy.differences] == [Verdict.DIFFERENT] * 3
    assert found.verdict is Verdict.DIFFERENT
    assert found.measure("Memory").verdict is not Verdict.DIFFERENT
    assert ("Robot", "simulated", "simulated:task_power_factor=1.1") in found.differing
    # Half a minute of tasks at 8 to 9.5 W, and a tenth more: 25 to 29 J of some 850 J.
    assert all(20.0 < each.difference < 35.0 for each in energy.differences)
