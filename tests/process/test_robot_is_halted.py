"""Software that goes on through all runs drives a robot without a watchdog: whoever dies, the robot stands still."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.process.conftest import kill_together, wait_until
from tests.ros.real_graph import over
from tests.ros.ros1_master import RUDE

from robot_runner.core.links.connect import open_robot

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.process.conftest import Experiment

    from robot_runner.core.links.robot import RobotLink

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

#: A planner that drives at once, and stops nobody when it is killed: whoever leaves a graph in order stops the robot.
PLANNER = """
import os, signal, sys, time
from robot_runner.core.links.connect import open_robot

signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
with open_robot(sys.argv[1]) as (link, _):
    while True:
        link.publish("/cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        print("drives", flush=True)
        time.sleep(0.05)
"""
CONFIG = """
import sys
from pathlib import Path
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.systems import Program

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path(__file__).parent / "results"
    robot = "{robot}"
    time_between_runs_in_ms = 600_000
    plugins = [Program(
        ["sh", "-c", '"$0" "$@" & wait', sys.executable, str(Path(__file__).with_name("planner.py")), robot],
        name="Planner", per="experiment", ready="drives", ready_timeout_s=60,
    )]

    def launch_mission(self, context):
        context.clock.sleep(0.1)

    def create_run_table(self):
        return RunTableModel([Factor("Map", ["hall", "kitchen"])])
"""


SUPERVISOR, HALTING = b"subjects/supervisor.py", b"robot_runner.subjects.halting"


class Robot:
    """Hears what it is commanded, and carries out the last of it for ever."""

    def __init__(self, link: RobotLink) -> None:
        self._heard: list[float] = []
        link.subscribe("/cmd_vel", "geometry_msgs/Twist", lambda twist: self._heard.append(twist["linear"]["x"]))

    def moves(self) -> bool:
        """Whether the last that it was commanded, since the last call and before, is to drive."""
        return bool(self._heard) and self._heard[-1] > 0

    def stood_still(self) -> bool:
        """Whether it was commanded to stand still since the last call."""
        heard, self._heard = self._heard, self._heard[-1:]
        return 0.0 in heard[1:]


def named(experiment: Experiment, part: bytes) -> list[int]:
    """Return the processes of an experiment on whose command line something stands."""
    return [pid for pid in experiment.processes() if part in Path(f"/proc/{pid}/cmdline").read_bytes()]


@over("dds", "ros1", "ros2")
@pytest.mark.parametrize(
    "killed",
    [
        "the orchestrator",
        pytest.param("the supervisor", marks=pytest.mark.long),
        pytest.param("the orchestrator and the supervisor", marks=pytest.mark.long),
        pytest.param("the program", marks=pytest.mark.long),
        pytest.param("the process that halts", marks=pytest.mark.long),
        pytest.param("the orchestrator and the process that halts", marks=pytest.mark.long),
    ],
)
def test_a_robot_that_a_program_of_all_runs_drives_stands_still_between_two_runs_whoever_is_killed(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, killed: str
) -> None:
    (tmp_path / "planner.py").write_text(PLANNER)
    config = tmp_path / "config.py"
    config.write_text(CONFIG.format(robot=graph))
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until(
            lambda: (experiment.folder / "run_table.csv").exists() and "Done" in experiment.statuses, "a run is done"
        )
        robot.stood_still()
        wait_until(robot.moves, "the program drives it on between two runs")
        if killed == "the program":
            events = experiment.folder / "subjects" / "Planner" / "1" / "events.jsonl"
            os.kill(json.loads(events.read_text().splitlines()[0])["started"], signal.SIGKILL)
            wait_until(lambda: not robot.moves(), "it stands still")
            experiment.send(signal.SIGINT)
        else:
            doomed = {"the orchestrator": [experiment.process.pid], "the supervisor": named(experiment, SUPERVISOR)}
            doomed |= {"the process that halts": named(experiment, HALTING)}
            kill_together(pid for who in killed.split(" and ") for pid in doomed[who])
            if killed == "the supervisor":
                wait_until(lambda: not robot.moves(), "it stands still")
            if "orchestrator" not in killed:
                experiment.send(signal.SIGINT)
        experiment.end()
        experiment.nobody_is_left()
        if killed == "the orchestrator and the process that halts":  # nobody is left who could: the next execution does
            assert robot.moves()
            experiment = start(config=config)
            wait_until(robot.stood_still, "it is commanded to stand still before the program is started again")
            wait_until(
                lambda: not experiment.processes() or experiment.statuses.count("Done") == 2, "both runs are done"
            )
            assert experiment.end() == 0, experiment.output
            said = (
                "an earlier execution was killed while Planner commanded the robot; it was commanded to stand still now"
            )
            assert said in experiment.output
            experiment.nobody_is_left()
        told = sorted((experiment.folder / "subjects" / "Planner").glob("*/commanded.jsonl"))
        assert not robot.moves(), [each.read_text() for each in told]
