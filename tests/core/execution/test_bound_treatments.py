"""Treatments that reach the plugins that they are bound to, in each kind of process, and those that reach nobody."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Execute = Callable[..., Any]

#: Some 0.1 and 0.4 m on the simulated robot, in a mission of a few seconds.
HEAD = """\
from robot_runner import *
from robot_runner.plugins.systems import BasicTurtlebot3

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = "simulated"
"""

TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.05, 0.2])])
"""

SHORT = "task='Video', sleep_s=0.2, drive_s=2, task_s=0.2, rotate_s=4"


def test_setting_a_parameter_of_a_plugin_in_a_callback_is_refused_with_the_remedy(execute: Execute) -> None:
    body = f"""
    def __init__(self):
        self.turtle = BasicTurtlebot3({SHORT})
        self.plugins = [self.turtle]

    def before_run(self, context):
        self.turtle.speed = context.combination["Speed"]
    """
    executed = execute(body, head=HEAD, table=TABLE)
    assert [row["status"] for row in executed.table] == ["Failed", "Failed"]
    (failure, _) = executed.finished.failures
    assert "speed is a parameter of BasicTurtlebot3" in failure
    assert "BasicTurtlebot3(speed=treatment('Speed'))" in failure
