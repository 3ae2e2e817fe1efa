"""A covering array: each pair of treatments occurs together at least once, in ten runs instead of twenty-four.

For finding out whether anything goes wrong with any pair. What excludes each other never occurs.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.designs import CoveringArray
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "covering_array"
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
                Factor("Task", ["Computation", "Video", "Network"]),
                Factor("Speed", [0.1, 0.15, 0.2], unit="m/s"),
                Factor("Work", [0.1, 0.2, 0.4], unit="s"),
            ],
            exclude_combinations=[{"Task": "Video", "Speed": 0.2}],
            design=CoveringArray(strength=2),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
