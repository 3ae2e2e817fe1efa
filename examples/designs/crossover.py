"""A crossover: four robots, each of which does all four ways of working, one after another.

Each way follows each other one once, so that what one leaves behind (a warm processor, a drained battery) weighs on
none more than on another. Between two of them a robot rests.
"""

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.designs import Crossover
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "crossover"
    robot = "simulated"
    plugins = [BasicTurtlebot3(speed=treatment("Speed"), sleep_s=0.1, drive_s=3, task_s=0.5, rotate_s=6), Ina219()]
    # On real robots some minutes.
    washout_in_s = 0.05

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Robot", ["alice", "bob", "carol", "dave"]),
                Factor("Period", [1, 2, 3, 4]),
                Factor("Task", ["Computation", "Network"]),
                Factor("Speed", [0.1, 0.2]),
            ],
            data_columns=["Energy", "Duration"],
            shuffle=True,
            design=Crossover(unit="Robot", period="Period", washout_in_s=self.washout_in_s),
        )
