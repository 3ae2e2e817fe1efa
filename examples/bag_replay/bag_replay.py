"""Two implementations of one node on one recorded bag: which answers faster, and which costs less of the processor?

    python examples/bag_replay/make_bag.py
    robot-runner examples/bag_replay/bag_replay.py

It needs no robot and no ROS: the graph is one of DDS. Over ROS 1, with a master running, it is BAG_REPLAY_ROBOT=ros1
before the second command. For your own node, put a RosNode or a RosLaunch in the place of the Program, and your bag in
the place of this one.
"""

import os
import sys
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.plugins.profilers import PsUtil, TopicLatency
from robot_runner.plugins.systems import PlayBag, Program

FOLDER = Path(__file__).parent
ROBOT = os.environ.get("BAG_REPLAY_ROBOT", "dds")
BAG = os.environ.get("BAG_REPLAY_BAG", FOLDER / "hall")


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "bag_replay"
    robot = ROBOT
    repetitions = 5
    # The node first, so that it is there when the bag begins.
    plugins = [
        Program(
            [sys.executable, FOLDER / "scan_filter.py", "--robot", ROBOT, "--filter", treatment("Filter")],
            name="Node",
            ready="ready",
        ),
        PlayBag(BAG, topics=["/scan"]),
        TopicLatency("/scan", "/scan_filtered"),
        PsUtil(host="localhost", processes=["subject:Node"]),
    ]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel([Factor("Filter", ["plain", "numpy"])], repetitions=self.repetitions, seed=7)
