"""A D-optimal design: seven of the eleven allowed combinations, from which main effects are estimated best.

The network is not reached at full speed, and work of the computer is varied only for the task that has some: a fraction
of a factorial would lose its balance, and this one is built around what is left. The report tests work among the runs
of the computation alone, and says so.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.designs import DOptimal
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "d_optimal"
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
                Factor("Work", [0.1, 0.4], when={"Task": "Computation"}, unit="s"),
            ],
            exclude_combinations=[{"Task": "Network", "Speed": 0.2}],
            design=DOptimal(runs=7, model="main"),
            data_columns=["Energy", "Duration"],
            shuffle=True,
        )
