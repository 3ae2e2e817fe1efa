"""A fractional factorial: four properties of a mission in eight runs instead of sixteen.

No main effect is hidden by an interaction of two factors (resolution 4); which interactions cannot be told from each
other is shown by `robot-runner plan`.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.designs import FractionalFactorial
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "fractional_factorial"
    robot = "simulated"
    drive_s = 10.0

    def __init__(self) -> None:
        robot = BasicTurtlebot3(
            speed=treatment("Speed"),
            sleep_s=treatment("Pause"),
            task_s=treatment("Work"),
            drive_s=self.drive_s,
            rotate_s=3.0,
        )
        self.plugins = [robot, Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Task", ["Computation", "Video"]),
                Factor("Speed", [0.15, 0.2], unit="m/s"),
                Factor("Pause", [0.1, 0.3], unit="s"),
                Factor("Work", [0.1, 0.4], unit="s"),
            ],
            design=FractionalFactorial(resolution=4),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
