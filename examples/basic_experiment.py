"""The paper's experiment in the shorter spelling: a derived class, plugins in a list, the embedded robot.

`robot-runner examples/basic_experiment.py --set repetitions=1` executes three runs instead of 15.
"""

from pathlib import Path

from robot_runner import ExperimentConfig, Factor, OperationType, RobotRunnerContext, RunTableModel
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "basic_experiment"
    operation_type = OperationType.AUTO
    results_output_path = Path("~/example_mission_results/")
    robot = "simulated"
    plugins = [BasicTurtlebot3(), Ina219(), PsUtil()]

    # An attribute of our own: being a plain number, it can be set from the command line like the others.
    repetitions = 5

    def create_run_table(self) -> RunTableModel:
        run_table = RunTableModel(
            factors=[Factor("Task", ["Computation", "Video", "Network"])],
            repetitions=self.repetitions,
            data_columns=["CPU", "Memory", "Energy", "MeanPower"],
        )
        run_table.randomize_runs_order()
        return run_table

    # Named like an event, so it is called there; nothing has to be subscribed. What it prints goes to the run's log.
    def launch_mission(self, context: RobotRunnerContext) -> None:
        print(f"{context.run_id}: the mission with the task {context.combination['Task']} is over")
