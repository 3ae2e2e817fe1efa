"""An experiment on a simulator that lives on between runs: each begins where the first did, none is left paused."""

from __future__ import annotations

import signal
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.process.graph_simulation import simulated_robot
from tests.ros.real_graph import over
from tests.ros.ros1_master import RUDE

from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

#: A hang, s: two runs in real time take 25 s, and took more than 60 s where a machine had twenty times too much to do.
PATIENCE = 250.0
CONFIG = """\
from pathlib import Path
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import System, connect_robot
from robot_runner.plugins.systems import Simulation


class Drive(System):
    def launch_mission(self, context):
        link = connect_robot(context)
        first = link.wait_for("odom", "nav_msgs/Odometry", timeout=10)
        link.publish("cmd_vel", "geometry_msgs/Twist", {{}})  # so that its subscriber is found before it counts
        context.clock.sleep(0.5)
        link.publish("cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.2}}}})
        context.clock.sleep(1.0)
        link.publish("cmd_vel", "geometry_msgs/Twist", {{}})
        last = link.wait_for("odom", "nav_msgs/Odometry", timeout=10)
        (Path(__file__).parent / "launched").touch()
        x = [each["pose"]["pose"]["position"]["x"] for each in (first, last)]
        if HANGS:
            context.clock.sleep(60)
        context.share(first_x=x[0], last_x=x[1])

    def make_safe(self, context):
        connect_robot(context).publish("cmd_vel", "geometry_msgs/Twist", {{}})


HANGS = {hangs}


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    time_between_runs_in_ms = 0
    robot = {robot!r}
    plugins = [Simulation(reset={reset!r}, lowest_real_time_factor=0), Drive()]

    def create_run_table(self):
        return RunTableModel([Factor("Lap", [1, 2])], data_columns=["First", "Last", "RealTimeFactor", "ResetDuration"])

    def populate_run_data(self, context):
        data = context.plugin_data["Drive"]
        return {{"First": data["first_x"], "Last": data["last_x"]}}
"""


def written(folder: Path, **values: object) -> Path:
    path = folder / "config.py"
    path.write_text(CONFIG.format(**values), encoding="utf-8")
    return path


def goes_on(graph: str) -> bool:
    """Whether the simulator's time passes."""
    name = RobotName.parse(graph)
    link = GRAPH_LINKS[name.link].open(name, SystemClock())
    try:
        heard: list[Any] = []
        link.subscribe("/clock", "rosgraph_msgs/Clock", heard.append)
        deadline = time.monotonic() + PATIENCE
        while len(heard) < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        return len(heard) >= 3
    finally:
        link.close()


@pytest.mark.long
@over("ros1", soak=["dds"])
def test_each_run_begins_where_the_first_did_and_the_simulator_is_left_going_on(
    graph: str, start: Callable[..., Any], tmp_path: Path
) -> None:
    with simulated_robot(graph, "--use-sim-time"):
        reset = "simulation" if graph == "ros1" else "world"
        experiment = start(config=written(tmp_path, robot=graph, reset=reset, hangs=False))
        experiment.output, _ = experiment.process.communicate(timeout=PATIENCE)
        assert experiment.process.returncode == 0, experiment.output
        assert goes_on(graph), "it was left paused"
    assert [row["status"] for row in experiment.table] == ["Done", "Done"]
    for row in experiment.table:
        assert abs(float(row["First"])) < 0.05
        assert 0.1 < float(row["Last"]) < 0.5
        assert 0.3 < float(row["RealTimeFactor"]) < 1.2
        assert 0 < float(row["ResetDuration"]) < 10


@over("ros1", "dds")
@pytest.mark.soak
def test_a_killed_experiment_leaves_no_simulator_paused(graph: str, start: Callable[..., Any], tmp_path: Path) -> None:
    with simulated_robot(graph, "--use-sim-time"):
        experiment = start(config=written(tmp_path, robot=graph, reset="world", hangs=True))
        experiment.wait_for("launched")
        experiment.send(signal.SIGKILL)
        deadline = time.monotonic() + PATIENCE
        while experiment.processes() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert goes_on(graph)
