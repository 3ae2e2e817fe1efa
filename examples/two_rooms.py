"""Exclusions, blocks and repetitions: tasks of a robot in two rooms, of which one has no network.

Somebody has to carry the robot from room to room, so all runs of a room are kept together (a block), and their order
is randomised within it.
"""

from robot_runner import ExperimentConfig, Factor, RobotRunnerContext, RunTableModel
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "two_rooms"
    robot = "simulated"
    repetitions = 3
    sleep_s = 5.0
    task_s = 10.0

    def __init__(self) -> None:
        # Made here and not in the class, so that --set task_s=2 reaches the plugin.
        self.plugins = [BasicTurtlebot3(sleep_s=self.sleep_s, task_s=self.task_s), Ina219()]
        self.room = None

    def create_run_table(self) -> RunTableModel:
        room = Factor("Room", ["laboratory", "corridor"])
        task = Factor("Task", ["Computation", "Video", "Network"])
        return RunTableModel(
            factors=[room, task],
            exclude_combinations=[{"Room": "corridor", "Task": "Network"}],
            repetitions=self.repetitions,
            data_columns=["Energy", "MeanPower", "Duration"],
            shuffle=True,
            blocks="Room",
            seed=1,
        )

    def before_run(self, context: RobotRunnerContext) -> None:
        # Called in the orchestrating process: it remembers, and what it prints is seen on the terminal.
        if context.combination["Room"] != self.room:
            self.room = context.combination["Room"]
            print(f"From here on the robot is in the {self.room}.")
