"""Two planners of a small navigation stack: which arrives, and by which way?

Offer the simulated robot on a graph, with its lidar and a shelf in its way, and execute the experiment beside it:

    robot-runner simulate turtlebot3 --link dds --use-sim-time --real-time-factor 4 --room room.toml
    robot-runner navigation.py

Over ROS 1 it is --link ros1, and NAVIGATION_ROBOT=ros1 before the second command. On your own robot with Nav2, leave
out the navigator, and bind what you compare to the goal or to the parameters of your planner.
"""

import os
import sys
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.plugins.systems import ActionMission, Program

ROBOT = os.environ.get("NAVIGATION_ROBOT", "dds:clock=graph")
NAVIGATOR = Path(__file__).parent / "navigator.py"


def drive_to(x, y, name):
    return ActionMission(
        "navigate_to_pose",
        "nav2_msgs/NavigateToPose",
        {"pose": {"header": {"frame_id": "odom"}, "pose": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}},
        feedback={"Recoveries": ("last", "number_of_recoveries"), "Left": ("last", "distance_remaining")},
        odometry="odom",
        scan="scan",
        stop_topic="cmd_vel",
        timeout_s=60,
        failure="measure",
        name=name,
    )


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "navigation"
    robot = ROBOT
    repetitions = 5
    navigator = Program(
        [sys.executable, NAVIGATOR, "--robot", ROBOT, "--planner", treatment("Planner")],
        name="Navigator",
        ready="ready",
    )
    # Behind the shelf and home again, so that each run begins where the last one did.
    plugins = [navigator, drive_to(1.2, 0.0, "Out"), drive_to(0.0, 0.0, "Back")]

    def create_run_table(self):
        return RunTableModel([Factor("Planner", ["straight", "astar"])], repetitions=self.repetitions, seed=7)
