# The paper's Listing 1 as it is printed; only the missing imports and a body for the callback were added.
# ruff: noqa: ANN204, F401, I001, Q000, UP006, UP035 - printed so
# fmt: off

# Import plugins
import plugins.systems.BasicTurtlebot3
import plugins.profilers.Ina219
import plugins.profilers.PsUtil

from pathlib import Path
from typing import Dict, List

from robot_runner import (
    EventSubscriptionController,
    Factor,
    OperationType,
    RobotRunnerContext,
    RobotRunnerEvents,
    RunTableModel,
)


class RobotRunnerConfig:
    # Static parameters
    experiment_name: str = 'basic_experiment'
    required_ros_version: int = 1
    required_ros_distro: str = "melodic"
    operation_type: OperationType = OperationType.SEMI
    results_output_path: Path = Path('~/example_mission_results/')

    def __init__(self):
        # Events subscription
        EventSubscriptionController.subscribe_to_multiple_events([
            (RobotRunnerEvents.LAUNCH_MISSION, self.launch_mission),
        ])

    # Event callbacks
    def launch_mission(self, context: RobotRunnerContext) -> None:
        # BasicTurtlebot3 has carried out its mission by now; this is the place for a mission of your own.
        print(f"{context.run_id}: the mission with the task {context.combination['Task']} is over")

    # Creation of the run table
    def create_run_table(self) -> List[Dict]:
        run_table = RunTableModel(
            factors = [
                Factor('Task', ['Computation', 'Video', 'Network']),
                Factor('Repetition', range(1, 6))],
            data_columns=['CPU', 'Memory', 'Energy']
        )
        run_table.create_experiment_run_table()
        run_table.randomize_runs_order()
        return run_table
