"""Sobol' points: eight runs that cover two ranges together as evenly as can be, for a map of the energy."""

from robot_runner import ExperimentConfig, Factor, Range, RunTableModel, treatment
from robot_runner.designs import Sobol
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "sobol"
    robot = "simulated"
    drive_s = 10.0

    def __init__(self) -> None:
        robot = BasicTurtlebot3(
            task="Video",
            speed=treatment("Speed"),
            task_s=treatment("Work"),
            sleep_s=0.1,
            drive_s=self.drive_s,
            rotate_s=3.0,
        )
        self.plugins = [robot, Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Speed", Range(0.05, 0.22, unit="m/s")),
                Factor("Work", Range(0.1, 0.5, unit="s")),
            ],
            design=Sobol(runs=8, seed=1),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
