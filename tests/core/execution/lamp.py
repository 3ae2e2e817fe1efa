"""A lamp in a room that is a treatment: it writes down in which room, and for which run and robot, it was made safe."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment

HEAD = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import System

HERE = Path(__file__).parent

class Lamp(System):
    def __init__(self, *, room):
        super().__init__()
        self.room = room
    def claims(self, robot):
        return ()
    def make_safe(self, context):
        (HERE / "made_safe").write_text(f"{self.room} {context.combination['Room']} {context.run_id} {context.robot}")

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    workers = 2
    plugins = [Lamp(room=treatment("Room"))]
"""
TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("Room", ["kitchen", "hall"])])
"""


def made_safe(experiment: Experiment) -> str:
    """Return what the lamp has written; nothing where it was not made safe."""
    path = experiment.config_path.with_name("made_safe")
    return path.read_text(encoding="utf-8") if path.exists() else ""
