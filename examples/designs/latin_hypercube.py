"""A Latin hypercube: six runs that spread over the ranges of two numeric factors and over two tasks.

Each run has a slice of each range of its own: what a model of the energy is fitted to.
"""

from robot_runner import ExperimentConfig, Factor, Range, RunTableModel, treatment
from robot_runner.designs import LatinHypercube
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "latin_hypercube"
    robot = "simulated"
    drive_s = 10.0

    def __init__(self) -> None:
        robot = BasicTurtlebot3(
            speed=treatment("Speed"), task_s=treatment("Work"), sleep_s=0.1, drive_s=self.drive_s, rotate_s=3.0
        )
        self.plugins = [robot, Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Speed", Range(0.05, 0.22, unit="m/s")),
                Factor("Work", Range(0.1, 0.5, unit="s")),
                Factor("Task", ["Computation", "Video"]),
            ],
            design=LatinHypercube(runs=6, seed=1),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
