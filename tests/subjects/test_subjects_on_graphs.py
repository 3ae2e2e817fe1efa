"""A subject that is a node of the run's graph: it is ready once its node, its topic and its life cycle are."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
import time
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Any

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain

from robot_runner import all_of, lifecycle_state, topic_present
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunFailed
from robot_runner.plugins.systems import Program
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.testing import make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

pytestmark = pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="there is no DDS")

#: A managed node that takes a moment to become active, and publishes a topic from then on.
NODE = """
import sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.ros.lifecycle import LifecycleState
from robot_runner.testing import LifecycleNode

link = open_dds_link({"domain": sys.argv[1], "distro": "jazzy"}, SystemClock())
node = LifecycleNode(link, "/slam")
begun = time.monotonic()
time.sleep(1.0)
node.state = LifecycleState.ACTIVE
link.advertise("/map", "nav_msgs/OccupancyGrid")
print(f"active after {time.monotonic() - begun:.1f} s", flush=True)
time.sleep(60)
"""


#: A planner that drives at once, and stops nobody when it ends.
PLANNER = """
import sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link

link = open_dds_link({"domain": sys.argv[1], "distro": "jazzy"}, SystemClock())
while True:
    link.publish("/cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
    print("drives", flush=True)
    time.sleep(0.05)
"""


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:Exception in thread watch over:pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("ends", ["with its run", "by itself"])
def test_a_robot_that_it_commands_stands_still_once_it_has_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: str
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = claim_domain()
    (tmp_path / "planner.py").write_text(PLANNER)
    planner = Program([sys.executable, str(tmp_path / "planner.py"), str(domain)], name="Planner", ready="drives")
    robot = open_dds_link({"domain": str(domain), "distro": "jazzy"}, SystemClock())
    heard: list[float] = []
    robot.subscribe("/cmd_vel", "geometry_msgs/Twist", lambda twist: heard.append(twist["linear"]["x"]))
    context = make_context(tmp_path, planner, robot=f"dds:domain={domain},distro=jazzy", clock=SystemClock())

    def stands_still() -> bool:
        # Not by `wait_for`: its own subscription may be made only after the command, and hear a message before `heard`.
        deadline = time.monotonic() + 20.0
        while heard[-1:] != [0.0] and time.monotonic() < deadline:
            time.sleep(0.01)
        return heard[-1:] == [0.0]

    def mission() -> None:
        robot.wait_for("/cmd_vel", "geometry_msgs/Twist", lambda twist: twist["linear"]["x"] > 0, timeout=20.0)
        if ends == "by itself":
            os.kill(context.plugin_data["Planner"]["pid"], signal.SIGKILL)
            assert stands_still()

    with closing(robot):
        with closing(context.resources), suppress(RunFailed):
            rehearse(context, planner, mission=mission)
        assert stands_still()


#: A program that commands once, and ends as soon as the robot has it: before anybody sees that it is on the graph.
ONCE = """
import os, sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link

link = open_dds_link({"domain": sys.argv[1], "distro": "jazzy"}, SystemClock())
while not os.path.exists(sys.argv[2]):
    link.publish("/cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
    time.sleep(0.01)
link._transport.close()  # as a program does that ends; our own link would command zero
os._exit(0)
"""


@pytest.mark.long
def test_a_robot_that_was_commanded_by_what_ended_at_once_stands_still_after_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = claim_domain()
    (tmp_path / "once.py").write_text(ONCE)
    command = [sys.executable, str(tmp_path / "once.py"), str(domain), str(tmp_path / "heard")]
    once = Program(command, per="mission", exit_codes=[0])
    robot = open_dds_link({"domain": str(domain), "distro": "jazzy"}, SystemClock())
    heard: list[float] = []

    def hear(twist: Mapping[str, Any]) -> None:
        heard.append(twist["linear"]["x"])
        (tmp_path / "heard").touch()

    robot.subscribe("/cmd_vel", "geometry_msgs/Twist", hear)
    context = make_context(tmp_path, once, robot=f"dds:domain={domain},distro=jazzy", clock=SystemClock())
    with closing(robot):
        with closing(context.resources):
            rehearse(context, once, mission=lambda: once.wait(context, timeout_s=20.0))
            assert 0.2 in heard
        deadline = time.monotonic() + 20.0
        while heard[-1] and time.monotonic() < deadline:
            time.sleep(0.01)
        assert heard[-1] == 0.0


@pytest.mark.long
def test_it_is_ready_once_its_life_cycle_and_its_topic_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = claim_domain()
    (tmp_path / "node.py").write_text(NODE)
    ready = all_of(lifecycle_state("slam"), topic_present("map", "nav_msgs/OccupancyGrid"))
    node = Program([sys.executable, str(tmp_path / "node.py"), str(domain)], name="Slam", ready=ready)
    context = make_context(tmp_path, node, robot=f"dds:domain={domain},distro=jazzy", clock=SystemClock())
    begun = time.monotonic()
    try:
        measures = rehearse(context, node)
    finally:
        context.resources.close()
    assert "active after 1" in (tmp_path / "runs" / "r_1" / "Slam" / "stdout.txt").read_text()
    assert 1.0 < measures["StartupTime"] < time.monotonic() - begun
