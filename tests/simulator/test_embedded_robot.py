"""The embedded robot is made of what its name says."""

from __future__ import annotations

import csv
import subprocess

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import open_clock
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.simulator.embedded_robot import simulation_options
from robot_runner.testing import make_context, rehearse


def test_values_have_the_type_of_their_parameter():
    parameters = simulation_options({"meter_rate": "100", "task_power_factor": "2"}).parameters
    assert (parameters.meter_rate, parameters.task_power_factor) == (100, 2.0)
    assert isinstance(parameters.meter_rate, int)


def test_the_simulation_is_made_with_the_options():
    resources = Resources()
    open_clock("simulated:task_power_factor=1.1", resources, 1)
    simulation = resources.open("simulation", lambda: None)
    assert simulation.parameters.task_power_factor == 1.1
    resources.close()


def test_the_simulation_can_go_in_real_time():
    assert simulation_options({"real_time_factor": "2"}).real_time_factor == 2.0
    assert simulation_options({}).real_time_factor is None


@pytest.mark.parametrize("pace", ["0", "-1", "inf", "nan"])
def test_a_pace_that_no_clock_can_keep_is_refused(pace):
    with pytest.raises(LinkError, match="real_time_factor"):
        simulation_options({"real_time_factor": pace})


@pytest.mark.long
def test_the_simulator_is_imported_once_for_all_forked_runs(program, tmp_path):
    """Each run's process is forked from the orchestrator, which has imported MuJoCo before the first."""
    config = tmp_path / "imports.py"
    config.write_text(_IMPORTS, encoding="utf-8")
    subprocess.run([program, config], check=True, capture_output=True, timeout=60)
    [folder] = tmp_path.glob("out/imports")
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        assert [(row["Before"], row["Anew"]) for row in csv.DictReader(file)] == [("True", "none")] * 2


_IMPORTS = """
import sys
from pathlib import Path
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "imports"
    results_output_path = Path(__file__).parent / "out"
    robot = "simulated"
    plugins = [BasicTurtlebot3()]

    def create_run_table(self):
        return RunTableModel(factors=[Factor("Task", ["Video", "Network"])], data_columns=["Before", "Anew"])

    def before_run(self, context):
        self.imported = set(sys.modules)

    def populate_run_data(self, context):
        anew = [name for name in sys.modules if name not in self.imported]
        anew = [name for name in anew if name.startswith(("mujoco", "numpy", "robot_runner.simulator"))]
        return {"Before": "mujoco" in self.imported, "Anew": " ".join(anew) or "none"}
"""


@pytest.mark.long
@pytest.mark.parametrize("drive_s", [1.5, 2.0, 4.0])
def test_a_short_mission_whose_way_is_free_is_not_doubted(tmp_path, drive_s):
    plugin = BasicTurtlebot3(sleep_s=0.3, drive_s=drive_s, task_s=0.5, rotate_s=3.0)
    context = make_context(tmp_path, plugin, combination={"Task": "Video"})
    try:
        rehearse(context, plugin)
    finally:
        context.resources.close()
    assert not context.broker.findings
