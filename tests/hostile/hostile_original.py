"""A small experiment that was really executed, and its package: what everything hostile is made from."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tests.command_line import PROGRAM
from tests.made_once import made_once

if TYPE_CHECKING:
    import pytest

CONFIG = """\
from pathlib import Path

from robot_runner import Author, ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "small"
    results_output_path = Path("results")
    robot = "simulated"
    registration = "small.registration.json"
    authors = [Author("Josiah Carberry", orcid="0000-0002-1825-0097")]
    licence = "CC-BY-4.0"

    def __init__(self):
        self.plugins = [BasicTurtlebot3(sleep_s=1.0, drive_s=1, task_s=1), Ina219(), PsUtil()]

    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["Video", "Network"])],
            repetitions=2,
            seed=1,
            data_columns=["CPU", "Energy", "Phases"],
        )

    def launch_mission(self, context):
        print("on the way")

    def populate_run_data(self, context):
        return {"Phases": context.plugin_data["BasicTurtlebot3"]["phase_count"]}
"""
RUNS = ("r_1", "r_2", "r_3", "r_4")


@dataclass(frozen=True)
class Original:
    """Where the original is.

    Attributes:
        study: the folder with the config and the results; nobody may change it.
        package: the experiment's package.
        config, folder: the config, and the experiment's folder, below any copy of the study.
    """

    study: Path
    package: Path
    config = Path("small.py")
    folder = Path("results/small")


def original_of_session(factory: pytest.TempPathFactory) -> Original:
    """Return the original, which is executed once for all tests."""
    folder = made_once(factory, "hostile", _make_original)
    return Original(folder / "study", folder / "small.zip")


def _make_original(folder: Path) -> None:
    """Execute the experiment and pack it."""
    original = Original(folder / "study", folder / "small.zip")
    original.study.mkdir()
    (original.study / original.config).write_text(CONFIG, encoding="utf-8")
    results = str(original.folder)
    for words in (
        ["preregister", str(original.config)],
        [str(original.config), "--plain", "--no-probe"],
        ["exclude", results, "r_4", "--reason", "the door was open"],
        ["pack", results, "--to", "../small.zip", "--no-wheels", "--no-hashes"],
    ):
        subprocess.run([PROGRAM, *words], cwd=original.study, check=True, capture_output=True, timeout=200)
