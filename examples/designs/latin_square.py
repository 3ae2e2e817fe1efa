"""A Latin square: three tasks, each once on each day and once with each battery.

Nine runs tell the tasks apart from the days and from the batteries; all combinations would be 27.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.designs import LatinSquare
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "latin_square"
    robot = "simulated"
    plugins = [BasicTurtlebot3(sleep_s=0.1, drive_s=3, task_s=0.5, rotate_s=6), Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Day", ["Monday", "Tuesday", "Wednesday"]),
                Factor("Battery", ["A", "B", "C"]),
                Factor("Task", ["Computation", "Video", "Network"]),
            ],
            data_columns=["Energy", "Duration"],
            shuffle=True,
            design=LatinSquare(rows="Day", columns="Battery"),
        )
