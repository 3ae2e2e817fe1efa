"""Balanced incomplete blocks: seven speeds, of which there is time for three a day.

In seven days each speed is driven three times, and each two speeds are compared on one day.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.designs import Blocks
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "incomplete_blocks"
    robot = "simulated"
    plugins = [
        BasicTurtlebot3(
            speed=treatment("Speed"),
            task_factor=None,
            task="Computation",
            sleep_s=0.1,
            drive_s=3,
            task_s=0.1,
            rotate_s=6,
        ),
        Ina219(),
    ]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Day", range(1, 8)),
                Factor("Speed", [0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2]),
            ],
            repetitions=3,
            data_columns=["Energy", "Duration"],
            shuffle=True,
            design=Blocks("Day"),
        )
