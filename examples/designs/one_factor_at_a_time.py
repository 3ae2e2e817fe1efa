"""One factor at a time around the robot's usual mission: five runs, and no word on interactions."""

from robot_runner import ExperimentConfig, Factor, Range, RunTableModel, treatment
from robot_runner.designs import OneFactorAtATime
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "one_factor_at_a_time"
    robot = "simulated"
    drive_s = 10.0

    def __init__(self) -> None:
        robot = BasicTurtlebot3(speed=treatment("Speed"), sleep_s=0.1, task_s=0.2, drive_s=self.drive_s, rotate_s=3.0)
        self.plugins = [robot, Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Task", ["Computation", "Video", "Network"]),
                Factor("Speed", Range(0.05, 0.22, unit="m/s")),
            ],
            design=OneFactorAtATime(base={"Task": "Video", "Speed": 0.15}),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
