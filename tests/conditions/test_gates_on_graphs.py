"""A gate and a guard of a robot on a real graph."""

from __future__ import annotations

import json
import subprocess
from typing import TYPE_CHECKING

import pytest
from tests.process.graph_simulation import PATIENCE, simulated_robot
from tests.ros.real_graph import graph, over
from tests.ros.ros1_master import RUDE

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["graph"]
pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

CONFIG = """\
from robot_runner import *
from robot_runner.plugins import connect_robot

ALICE = dict(namespace="/alice")
PLACE = ("odom", "nav_msgs/Odometry", "pose.pose.position.x")

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = {robot!r}
    gates = [Gate(all_of(topic_present("odom", **ALICE), battery_above(10, **ALICE)).held_for(0.3), timeout_s=60)]
    # A metre beyond the end of the first mission: a busy machine may be late to see that end.
    guards = [Guard(topic_above(*PLACE, 1.2, **ALICE), GuardAction.STOP)]

    def launch_mission(self, context):
        far = 0.2 if context.combination["Far"] == "no" else 100
        link = connect_robot(context, **ALICE)
        for _ in range(6):  # on a busy machine the robot may discover its publisher only after the first message
            link.publish("cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.2}}}})
            context.clock.sleep(0.3)
        topic_above(*PLACE, far, **ALICE).wait(context, timeout_s=50)

    def create_run_table(self):
        return RunTableModel([Factor("Far", ["no", "yes"])])
"""


@pytest.mark.long
@over("dds", soak=["ros1", "ros2"])
def test_a_mission_ends_by_a_condition_and_a_guard_ends_one_over_a_real_graph(
    graph: str,
    tmp_path: Path,
    program: str,
) -> None:
    (tmp_path / "config.py").write_text(CONFIG.format(robot=graph))
    with simulated_robot(graph, "--namespace", "/alice"):
        done = subprocess.run(
            [program, "run", "config.py", "--plain"],
            check=False,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE,
        )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Stopped by a guard: 1 of 2 runs done, 1 failed, 0 to do" in done.stdout, done.stdout
    kept = [json.loads(line) for line in (tmp_path / "results" / "trial" / "journal.jsonl").read_text().splitlines()]
    gates = [record for record in kept if record["kind"] == "gate" and record["state"] == "open"]
    assert [record["run"] for record in gates] == ["r_1", "r_2"]
    assert "/alice/odom is there; the battery of the robot /alice: " in gates[0]["seen"]
    (waited,) = (record for record in kept if record["kind"] == "waited" and record["holds"])
    assert waited["condition"] == "pose.pose.position.x of /alice/odom is above 0.2"
    (guard,) = (record for record in kept if record["kind"] == "guard")
    assert (guard["run"], guard["action"]) == ("r_2", "stop")
    ends = {record["run"]: record for record in kept if record["kind"] == "attempt_finished"}
    assert (ends["r_1"]["status"], ends["r_2"]["status"]) == ("done", "failed")
    assert ends["r_2"]["seconds"] < 40
