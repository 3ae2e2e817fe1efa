"""A Box-Behnken design: a response surface of three factors that are never at their ends all at once."""

from robot_runner import ExperimentConfig, Factor, Range, RunTableModel, treatment
from robot_runner.designs import BoxBehnken
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "box_behnken"
    robot = "simulated"
    drive_s = 10.0

    def __init__(self) -> None:
        robot = BasicTurtlebot3(
            task="Video",
            speed=treatment("Speed"),
            task_s=treatment("Work"),
            sleep_s=treatment("Pause"),
            drive_s=self.drive_s,
            rotate_s=3.0,
        )
        self.plugins = [robot, Ina219()]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Speed", Range(0.05, 0.22, unit="m/s")),
                Factor("Work", Range(0.1, 0.5, unit="s")),
                Factor("Pause", Range(0.1, 0.3, unit="s")),
            ],
            design=BoxBehnken(centre=2),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
