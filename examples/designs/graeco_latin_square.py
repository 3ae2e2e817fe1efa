"""A Graeco-Latin square: three tasks, each once on each day, with each battery and with each operator.

Nine runs keep three kinds of blocks out of the comparison; all combinations would be 81.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.designs import GraecoLatinSquare
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "graeco_latin_square"
    robot = "simulated"
    plugins = [BasicTurtlebot3(sleep_s=0.1, drive_s=3, task_s=0.5, rotate_s=6), Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Day", ["Monday", "Tuesday", "Wednesday"]),
                Factor("Battery", ["A", "B", "C"]),
                Factor("Operator", ["Ada", "Bo", "Cy"]),
                Factor("Task", ["Computation", "Video", "Network"]),
            ],
            data_columns=["Energy", "Duration"],
            shuffle=True,
            design=GraecoLatinSquare(rows="Day", columns="Battery", greek="Operator"),
        )
