from __future__ import annotations

import contextlib
import json
import re
import shutil

import pytest

from robot_runner.cli.main import main

pytest.importorskip("mujoco")

CONFIG = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "measured"
    results_output_path = Path("results")
    robot = "simulated"
    plugins = [BasicTurtlebot3(sleep_s=1.0, drive_s=2.0, task_s=2.0, rotate_s=4.0), Ina219(), PsUtil()]

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Computation", "Video", "Network"])], repetitions=2, seed=1, warm_up=1)
"""


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    (folder / "measured.py").write_text(CONFIG)
    with contextlib.chdir(folder):
        assert main(["run", "measured.py"]) == 0
    return folder / "results"


@pytest.fixture
def experiment(executed, tmp_path):
    shutil.copytree(executed, tmp_path / "results")
    return "results/measured"


@pytest.mark.long
def test_a_model_is_fitted_shown_and_written(robot_runner, experiment, tmp_path):
    answer = robot_runner("fit-power-model", experiment, "--out", "model.json")
    assert answer.code == 0
    assert re.search(r"motion:forward +\d\.\d{4}  ± \d", answer.out)
    assert "Fitted on  6 runs" in answer.out
    assert "simulated, not measured" in answer.out
    assert "R²" in answer.out
    model = json.loads((tmp_path / "model.json").read_text())
    assert model["fit"]["experiment"] == "measured"

    refusal = robot_runner("fit-power-model", experiment, "--out", "model.json")
    assert refusal.code == 2
    assert "already" in refusal.err


@pytest.mark.long
def test_a_model_of_one_run_says_that_it_was_tried_on_no_other(robot_runner, experiment):
    assert "no run: there is one run only" in robot_runner("fit-power-model", experiment, "--runs", "r_1").out


@pytest.mark.long
def test_a_run_that_only_warms_up_is_not_fitted_on(robot_runner, experiment):
    assert "w_1" not in robot_runner("fit-power-model", experiment, "--json").json["fit"]["runs"]
    assert robot_runner("fit-power-model", experiment, "--runs", "w_1").code == 2


@pytest.mark.long
def test_doubtful_samples_that_a_model_is_fitted_on_are_told(robot_runner, experiment, tmp_path):
    path = tmp_path / experiment / "run_table.schema.json"
    schema = json.loads(path.read_text())
    for field in schema["fields"]:
        if field["name"] in {"Energy", "MeanPower", "Distance"}:
            field["robot_runner:doubts"] = {"r_2": ["registers stood still for 20 s"], "w_1": ["cold"]}
    path.write_text(json.dumps(schema))
    answer = robot_runner("fit-power-model", experiment, "--phases", "none", "--json")
    assert answer.json["fit"]["runs"] == ["r_1", "r_2", "r_3", "r_4", "r_5", "r_6"]
    said = "warning: Ina219: what it measured in r_2 is doubtful: registers stood still for 20 s fix: Look"
    assert " ".join(answer.err.split()).startswith(said)
    assert answer.err.count("warning") == 1
    assert robot_runner("fit-power-model", experiment, "--runs", "r_1,r_3").err == ""


@pytest.mark.long
def test_terms_and_runs_can_be_chosen_and_json_is_printed(robot_runner, experiment):
    answer = robot_runner(
        "fit-power-model", experiment, "--terms", "constant,motion:forward", "--runs", "r_2", "--json"
    )
    assert list(answer.json["coefficients_W"]) == ["constant", "motion:forward"]
    assert answer.json["fit"]["runs"] == ["r_2"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--runs", "r_9"), "no run 'r_9' is done"),
        (("--power", "Meter"), "no run can be used: there is no such file"),
        (("--terms", "constant,cpu,speed"), "a power model has no term 'speed'"),
    ],
)
def test_what_cannot_be_is_refused_with_a_fix(robot_runner, experiment, options, said):
    answer = robot_runner("fit-power-model", experiment, *options)
    assert answer.code == 2
    assert said in answer.err
    assert "Traceback" not in answer.err


def test_a_folder_without_an_experiment_is_refused(robot_runner, tmp_path):
    (tmp_path / "empty").mkdir()
    assert robot_runner("fit-power-model", "empty").code == 2
