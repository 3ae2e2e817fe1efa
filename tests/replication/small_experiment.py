"""A small experiment on the embedded robot, executed once, with everything in it that must not leave the house."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SECRET = "swordfish-7"  # noqa: S105 - what the tests look for
RUNS = 4

CONFIG = f"""\
from pathlib import Path

from packed_paces import SLEEP_S
from robot_runner import Author, ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "small"
    results_output_path = Path("results")
    robot = "simulated"
    authors = [
        Author(
            "Josiah Carberry",
            orcid="0000-0002-1825-0097",
            affiliation="Vrije Universiteit Amsterdam",
            affiliation_url="https://ror.org/008xxew50",
        )
    ]
    licence = "CC-BY-4.0"
    citation = "https://doi.org/10.1109/ICSE-Companion52605.2021.00029"
    wifi_password = "{SECRET}"
    map_file = "/home/ada/maps/lab.pgm"

    def __init__(self):
        self.plugins = [BasicTurtlebot3(sleep_s=SLEEP_S, drive_s=1, task_s=1), Ina219(), PsUtil()]

    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["Video", "Network"])],
            repetitions=2,
            shuffle=True,
            data_columns=["CPU", "Memory", "Energy", "Phases"],
        )

    def launch_mission(self, context):
        print("joined the network with", self.wifi_password, "to write to", context.run_folder)

    def populate_run_data(self, context):
        return {{"Phases": context.plugin_data["BasicTurtlebot3"]["phase_count"]}}
"""


def write_config(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "packed_paces.py").write_text("SLEEP_S = 1.0\n", encoding="utf-8")
    path = folder / "small.py"
    path.write_text(CONFIG, encoding="utf-8")
    return path


def execute(config: Path, **overrides: str) -> Path:
    """Execute the config and return the experiment's folder."""
    with own_modules():
        experiment = prepare_or_refuse(config, overrides)
        finished = execute_experiment(experiment, SilentObserver())
    assert finished.failed_count == finished.todo_count == 0, finished.failures
    return finished.folder


@contextmanager
def own_modules() -> Iterator[None]:
    """Forget the config's local modules and their folder: the next config has modules of the same names elsewhere."""
    before, path = set(sys.modules), list(sys.path)
    no_byte_code, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = no_byte_code
        sys.path[:] = path
        for name in set(sys.modules) - before:
            if name in {"packed_paces", "robot_runner_config"}:
                del sys.modules[name]


@contextmanager
def home(folder: Path) -> Iterator[None]:
    before = os.environ.get("HOME")
    os.environ["HOME"] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = before


#: An experiment of two runs whose config has nothing else.
CHANGING = """\
from robot_runner import ExperimentConfig, Factor, RunProcess, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "changing"
    results_output_path = "results"
    run_process = RunProcess.IN_PROCESS

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["Score"])

    def populate_run_data(self, context):
        return {"Score": 1.0}
"""


def changed_between_its_runs(folder: Path) -> Path:
    """Execute an experiment whose config is changed between its first run and its second; return its folder."""
    config = folder / "changing.py"
    config.write_text(CHANGING, encoding="utf-8")
    with own_modules():
        execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(only=("r_1",)))
    config.write_text(f"# Measured anew.\n{CHANGING.replace('1.0', '2.0')}", encoding="utf-8")
    with own_modules():
        execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(accept_changes=True))
    return folder / "results" / "changing"
