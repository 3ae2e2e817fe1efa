"""A split plot: laying the floor takes an afternoon, so that it changes from whole plot to whole plot only.

Three tasks are executed in random order on each floor that was laid. Six floors are laid, three of each kind: so many
tell how much one laying differs from the next, which is what the kinds are compared with.
"""

from robot_runner import ExperimentConfig, Factor, RobotRunnerContext, RunTableModel
from robot_runner.designs import SplitPlot
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "split_plot"
    robot = "simulated"
    plugins = [BasicTurtlebot3(sleep_s=0.1, drive_s=3, task_s=0.5, rotate_s=6), Ina219()]
    laid = None

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [
                Factor("Laying", range(1, 7)),
                Factor("Floor", ["wood", "carpet"]),
                Factor("Task", ["Computation", "Video", "Network"]),
            ],
            data_columns=["Energy", "Duration"],
            shuffle=True,
            design=SplitPlot(hard="Floor", plot="Laying"),
        )

    def before_run(self, context: RobotRunnerContext) -> None:
        # In a lab this is a step that waits: OperatorStep("lay the floor", when_changes="Laying").
        if context.combination["Laying"] != self.laid:
            self.laid = context.combination["Laying"]
            print(f"Floor number {self.laid} is laid: {context.combination['Floor']}.")
