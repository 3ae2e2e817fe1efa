"""The navigation example on a real graph: an action server of its own on the embedded robot, and two planners."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.process.graph_simulation import simulated_robot
from tests.ros.real_graph import over
from tests.ros.ros1_master import RUDE

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

CONFIG = Path(__file__).parents[2] / "examples" / "navigation" / "navigation.py"
ROOM = CONFIG.with_name("room.toml")
#: Two runs of 20 simulated seconds each, at this pace: a command to stop that comes late lets the robot roll on.
FACTOR = "2"
#: A hang, s: 36 s of work took more than 120 s where a machine had twelve times more to do than it could.
PATIENCE = 250.0
#: From home to behind the shelf, m: as the crow flies, and what is long for it.
DIRECT, LONG = 1.1, 2.5


@pytest.mark.long
@over("dds", soak=["ros1"])
def test_both_planners_arrive_and_success_and_path_length_are_measured(graph: str, tmp_path: Path) -> None:
    robot = graph if graph == "ros1" else f"{graph},clock=graph"
    words = [str(CONFIG), "--set", f"results_output_path={tmp_path}", "--set", "repetitions=1"]
    with simulated_robot(graph, "--use-sim-time", "--real-time-factor", FACTOR, "--room", str(ROOM)):
        done = subprocess.run(
            [sys.executable, "-m", "robot_runner", *words],
            env=os.environ | {"NAVIGATION_ROBOT": robot},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said + _logs(tmp_path)
    with (tmp_path / "navigation" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["Planner"] for row in rows} == {"straight", "astar"}
    for row in rows:
        for mission in ("Out", "Back"):
            assert row[f"{mission}.Outcome"] == "succeeded", said + _logs(tmp_path)
            assert row[f"{mission}.Success"] == "True"
            assert DIRECT < float(row[f"{mission}.PathLength"]) < LONG
            assert float(row[f"{mission}.Left"]) < 0.2
            assert 0.1 < float(row[f"{mission}.ClosestObstacle"]) < 0.6


def _logs(folder: Path) -> str:
    return "".join(each.read_text(encoding="utf-8") for each in folder.rglob("*.txt"))
