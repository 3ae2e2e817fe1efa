"""The demo is equivalent to itself under another seed, and differs where its tasks draw more power."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.analysis.comparison.compared import Verdict
from robot_runner.analysis.comparison.comparing import compare

DEMO = Path("robot-runner-demo", "basic_experiment")


@pytest.fixture
def executed_again(executed_demo, tmp_path, robot_runner):
    """Return what executes the demo under another name with settings; three repetitions show it as well as five do."""

    def execute(name, seed, *settings):
        text = (executed_demo / DEMO.parent / "demo.py").read_text().replace("range(1, 6)", "range(1, 4)")
        config = tmp_path / f"{name}.py"
        config.write_text(text.replace("seed=2021", f"seed={seed}"))
        words = [word for each in (f"experiment_name={name}", *settings) for word in ("--set", each)]
        assert robot_runner("run", config, "--plain", *words).code == 0
        return tmp_path / name

    return execute


@pytest.mark.soak
def test_the_demo_is_equivalent_to_itself_under_another_seed(executed_demo, executed_again):
    again = executed_again("again", 77)
    assert compare(executed_demo / DEMO, again, bound=["10%", "Energy=2%"]).verdict is Verdict.EQUIVALENT


@pytest.mark.long
def test_the_demo_differs_from_that_of_a_hungrier_robot_in_its_energy_alone(executed_demo, executed_again):
    hungrier = executed_again("hungrier", 2021, "robot=simulated:task_power_factor=1.1")
    found = compare(executed_demo / DEMO, hungrier, bound=["2%"])
    energy = found.measure("Energy")
    assert [each.verdict for each in energy.differences] == [Verdict.DIFFERENT] * 3
    assert found.verdict is Verdict.DIFFERENT
    assert found.measure("Memory").verdict is not Verdict.DIFFERENT
    assert ("Robot", "simulated", "simulated:task_power_factor=1.1") in found.differing
    # Half a minute of tasks at 8 to 9.5 W, and a tenth more: 25 to 29 J of some 850 J.
    assert all(20.0 < each.difference < 35.0 for each in energy.differences)
