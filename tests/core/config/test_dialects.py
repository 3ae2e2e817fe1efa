"""What is loaded from a config file is there for the processes that `multiprocessing` starts anew, too."""

from __future__ import annotations

import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from robot_runner.core.config.dialects import LOADED_VARIABLE
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

OWN = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from robot_runner import ExperimentConfig, Factor, RunTableModel

class Point:
    def __init__(self, x):
        self.x = x

def scaled(point):
    return Point(point.x * RobotRunnerConfig.gain)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "pooled"
    gain = 2

    def create_run_table(self):
        return RunTableModel([Factor("Start", ["spawn", "forkserver"])], data_columns=["Sum"])

    def populate_run_data(self, context):
        started = multiprocessing.get_context(context.combination["Start"])
        with ProcessPoolExecutor(1, mp_context=started) as pool:
            return {"Sum": sum(each.x for each in pool.map(scaled, map(Point, range(4))))}
"""

EARLIER = """
import multiprocessing
from EventManager.Models.RunnerEvents import RunnerEvents
from EventManager.EventSubscriptionController import EventSubscriptionController
from ConfigValidator.Config.Models.RunTableModel import RunTableModel
from ConfigValidator.Config.Models.FactorModel import FactorModel
from pathlib import Path

def squared(number):
    return number**2

class RunnerConfig:
    name = "pooled"
    results_output_path = Path(__file__).parent / "experiments"

    def __init__(self):
        EventSubscriptionController.subscribe_to_multiple_events([(RunnerEvents.POPULATE_RUN_DATA, self.populate)])

    def create_run_table_model(self):
        self.run_table_model = RunTableModel([FactorModel("Start", ["spawn"])], data_columns=["Sum"])
        return self.run_table_model

    def populate(self, context):
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            return {"Sum": sum(pool.map(squared, range(4)))}
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "settings", "sums"),
    [(OWN, {"gain": "5"}, [30, 30]), (EARLIER, {}, [14])],
    ids=["a config of ours, with what was set", "a config of an earlier tool"],
)
def test_processes_that_are_started_anew_know_the_functions_and_classes_of_the_config(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, settings: dict[str, str], sums: list[int]
) -> None:
    config = tmp_path / "its name is no name of a module.py"
    config.write_text(text, encoding="utf-8")
    with TemporaryDirectory() as folder:  # for the socket of a forkserver, whose path has to be short
        monkeypatch.setattr("tempfile.tempdir", folder)
        finished = execute_experiment(prepare_or_refuse(config, settings), SilentObserver())
    assert finished.failures == ()
    journal = (tmp_path / "experiments" / "pooled" / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    ended = [each for each in map(json.loads, journal) if each["kind"] == "attempt_finished"]
    assert [each["measures"]["Sum"]["value"] for each in ended] == sums


def test_what_is_secret_is_not_told_to_programs_that_callbacks_start(tmp_path: Path) -> None:
    config = tmp_path / "secret.py"
    config.write_text(OWN.replace("gain = 2", "gain, api_token = 2, ''"), encoding="utf-8")
    prepare_or_refuse(config, {"gain": "5", "api_token": "s3cret-0f-mine"})
    assert json.loads(os.environ[LOADED_VARIABLE]) == {"file": str(config), "set": {"gain": "5"}}
