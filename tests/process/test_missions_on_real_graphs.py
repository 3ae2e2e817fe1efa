"""Missions without code on a real graph: a robot that carries out a goal stands still when the run dies."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD
from tests.process.conftest import wait_until
from tests.process.graph_simulation import simulated_robot, witness
from tests.processor_wait import ProcessorWait, family
from tests.ros.missions.drive_action import ACTION, ACTION_TYPE, DriveServer
from tests.ros.real_graph import over
from tests.ros.ros1_master import RUDE

from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

Start = Callable[..., Any]

CONFIG = f"""
    robot = {{robot!r}}
    plugins = [Together(
        ActionMission({ACTION!r}, {ACTION_TYPE!r}, {{{{"pose": {{{{"pose": {{{{"position": {{{{"x": 3.0}}}}}}}}}}}}}}}},
                      name="alice", namespace="/alice", odometry="odom"),
        TopicMission("lamp", "std_msgs/String", {{{{"data": "on"}}}}, until=60.0, afterwards={{{{"data": "off"}}}},
                     name="lamp"),
    )]
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])])
"""
OF_CALLBACK = f"""
    robot = {{robot!r}}
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])])
    def launch_mission(self, context):
        robot = connect_robot(context, namespace="/alice")
        goal = {{{{"pose": {{{{"pose": {{{{"position": {{{{"x": 3.0}}}}}}}}}}}}}}}}
        robot.send_goal({ACTION!r}, {ACTION_TYPE!r}, goal).result(timeout=60.0)
"""
#: The standby finds the graph, the server takes the cancel request at its next step, and the wheels roll out.
STOPPED_WITHIN = 3.0


@contextmanager
def driven(graph: str) -> Iterator[tuple[Any, Any, DriveServer]]:
    """Offer an action that drives a robot without a watchdog; yield who sees it, a link to it, and the server."""
    name = RobotName.parse(graph)
    with (
        simulated_robot(graph, "--namespace", "/alice", "--no-watchdog"),
        witness(graph, "/alice") as seen,
        closing(GRAPH_LINKS[name.link].open(name, SystemClock(), "/alice")) as link,
    ):
        server = DriveServer(link, SystemClock())
        link.offer_action(ACTION, ACTION_TYPE, server.execute)
        yield seen, link, server


@pytest.mark.long
@over("ros1", soak=["dds"])
def test_when_the_run_is_killed_its_goal_is_cancelled_and_the_safe_message_is_published(
    graph: str, start: Start, write_config: Callable[..., Path]
) -> None:
    head = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import *\n", 1)
    lamp: list[str] = []
    with driven(graph) as (seen, link, server):
        link.subscribe("/lamp", "std_msgs/String", lambda message: lamp.append(message["data"]))
        experiment = start(config=write_config(CONFIG.format(robot=graph), head=head, table=""))
        moving = seen.sees(0.15)
        wait_until(lambda: "on" in lamp, "the lamp is on")
        wait, killed = ProcessorWait(family()), time.time()
        os.kill(experiment.run_process(), signal.SIGKILL)
        assert moving < killed
        stood = seen.sees_standstill(killed, meanwhile=wait.look)
        assert stood - killed - wait.seconds < STOPPED_WITHIN
        assert server.cancelled == 1
        wait_until(lambda: lamp[-1] == "off", "the lamp is off")
        experiment.end()
        assert "had made Together safe; the process that stood by for this did it" in " ".join(
            experiment.output.split()
        )


@pytest.mark.long
@over("ros1", "dds")
def test_when_the_run_is_killed_the_goal_of_its_callback_is_cancelled_too(
    graph: str, start: Start, write_config: Callable[..., Path]
) -> None:
    head = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins import connect_robot\n", 1)
    with driven(graph) as (seen, _, server):
        experiment = start(config=write_config(OF_CALLBACK.format(robot=graph), head=head, table=""))
        seen.sees(0.15)
        wait, killed = ProcessorWait(family()), time.time()
        os.kill(experiment.run_process(), signal.SIGKILL)
        stood = seen.sees_standstill(killed, meanwhile=wait.look)
        assert stood - killed - wait.seconds < STOPPED_WITHIN
        assert server.cancelled == 1
        experiment.end()
        assert "had made the robot safe; the process that stood by for this did it" in " ".join(
            experiment.output.split()
        )
