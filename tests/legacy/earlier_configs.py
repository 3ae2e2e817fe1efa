"""Configs as people wrote them for the earlier tools, and what is asked of them; written for these tests."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.config.preparation import Preparation
    from robot_runner.core.execution.notices import ExperimentFinished

#: What a config for Experiment Runner begins with.
RUNNER = """\
from EventManager.Models.RunnerEvents import RunnerEvents
from EventManager.EventSubscriptionController import EventSubscriptionController
from ConfigValidator.Config.Models.RunTableModel import RunTableModel
from ConfigValidator.Config.Models.FactorModel import FactorModel
from ConfigValidator.Config.Models.RunnerContext import RunnerContext
from ConfigValidator.Config.Models.OperationType import OperationType
from pathlib import Path
from os.path import dirname, realpath


class RunnerConfig:
    ROOT_DIR = Path(dirname(realpath(__file__)))
    name: str = "sorting"
    results_output_path: Path = ROOT_DIR / "experiments"
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 0
"""

#: And one for Robot Runner.
ROBOT = """\
from EventManager.Models.RobotRunnerEvents import RobotRunnerEvents
from EventManager.EventSubscriptionController import EventSubscriptionController
from ConfigValidator.Config.Models.RunTableModel import RunTableModel
from ConfigValidator.Config.Models.FactorModel import FactorModel
from ConfigValidator.Config.Models.RobotRunnerContext import RobotRunnerContext
from ConfigValidator.Config.Models.OperationType import OperationType
from pathlib import Path
from typing import Dict, List


class RobotRunnerConfig:
    name: str = "patrol"
    required_ros_version: int = None
    required_ros_distro: str = None
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 0
    results_output_path: Path = Path(__file__).parent / "results"
"""

RUNNER_TABLE = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel(
            factors=[FactorModel("size", [10, 20]), FactorModel("language", ["c", "py"])],
            repetitions=2,
            data_columns=["seconds"],
        )
        return self.run_table_model
"""

#: Two runs, where more would show the same.
SHORT_TABLE = RUNNER_TABLE.replace(', FactorModel("language", ["c", "py"])', "").replace("=2,", "=1,")

ROBOT_TABLE = """\
    def create_run_table(self) -> List[Dict]:
        run_table = RunTableModel(
            factors=[FactorModel("task", ["scan", "map"]), FactorModel("speed", [0.1, 0.2])],
            data_columns=["energy"],
        )
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()
"""

EVENTS = (
    "before_experiment",
    "before_run",
    "start_run",
    "start_measurement",
    "launch_mission",
    "interact",
    "stop_measurement",
    "stop_run",
    "populate_run_data",
    "after_experiment",
)


class Executed:
    """An experiment that was executed, and what it left on disk."""

    def __init__(self, experiment: Experiment, finished: ExperimentFinished) -> None:
        self.experiment = experiment
        self.finished = finished
        self.folder = finished.folder

    @property
    def text(self) -> str:
        return (self.folder / "run_table.csv").read_text(encoding="utf-8")

    @property
    def table(self) -> list[dict[str, str]]:
        with (self.folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    @property
    def by_id(self) -> dict[str, dict[str, str]]:
        return {row["__run_id"]: row for row in self.table}

    @property
    def warnings(self) -> list[str]:
        return [str(finding) for finding in self.finished.findings]

    def log(self, run_id: str) -> str:
        return ExperimentFolder.found_at(self.folder).log(run_id).read_text(encoding="utf-8")


def planned(preparation: Preparation) -> list[tuple[str, dict[str, Any]]]:
    assert preparation.experiment is not None, preparation.findings
    return [(run.run_id, dict(run.combination)) for run in preparation.experiment.model.plan()]


def problems(preparation: Preparation) -> list[str]:
    return [str(finding) for finding in preparation.findings if finding.is_error]
