"""Whoever else commands what a mission commands fails its run at once: velocities and any other message."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import ExitStack
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.process.graph_simulation import rival, simulated_robot
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunFailed
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.journal import read_journal
from robot_runner.plugins.systems import TopicMission
from robot_runner.ros.graph_links import GRAPH_LINKS
from robot_runner.ros.opened_names import Advertised
from robot_runner.ros.sent_commands import is_from_here, note_sent
from robot_runner.ros.shapes import completed
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

_TWIST, _TEXT = "geometry_msgs/Twist", "std_msgs/String"
_HEAD = """\
from robot_runner import *
from robot_runner.plugins.systems import TopicMission, Waypoints

MISSIONS = {
    "drive": TopicMission("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}}, until=60.0, namespace="/gus"),
    "lamp": TopicMission("lamp", "std_msgs/String", {"data": "on"}, until=60.0, namespace="/gus"),
    "way": Waypoints([(5.0, 0.0)], namespace="/gus"),
}


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"

    def start_run(self, context):
        self.mission = MISSIONS[context.combination["Mission"]]
        self.mission.start_run(context)

    def launch_mission(self, context):
        self.mission.launch_mission(context)

    def stop_run(self, context):
        self.mission.stop_run(context)

"""
_TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Mission", {missions})])
"""


def _failures(graph: str, missions: list[str], tmp_path: Path, write_config: Any) -> list[str]:
    """Return how each run failed while somebody else published on the topics of its mission."""
    config = write_config(f"robot = {graph!r}", head=_HEAD, table=_TABLE.format(missions=missions))
    name = RobotName.parse(graph)
    with ExitStack() as stack:
        listening = GRAPH_LINKS[name.link].open(name, SystemClock(), "/gus")
        stack.callback(listening.close)
        for topic, kind in (("lamp", _TEXT), ("cmd_vel", _TWIST)):
            listening.subscribe(topic, kind, lambda _: None)
        stack.enter_context(rival(graph, "/gus", "cmd_vel", _TWIST, {"linear": {"x": -0.1}}))
        stack.enter_context(rival(graph, "/gus", "lamp", _TEXT, {"data": "off"}))
        begun = time.monotonic()
        command = [sys.executable, "-m", "robot_runner", "run", str(config)]
        answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert answer.returncode == 1, answer.stdout + answer.stderr
    assert time.monotonic() - begun < 100.0  # none of them went on to its end
    journal = tmp_path / "results/trial/journal.jsonl"
    first: dict[str, str] = {}
    for each in read_journal(journal, kinds=["failure"]):
        first.setdefault(each["run"], each["problem"])
    return list(first.values())


@pytest.mark.long
@quiet_about_rospy
def test_a_rival_on_ros1(master_uri: str, tmp_path: Path, write_config: Any) -> None:
    told = _failures(f"ros1:master={master_uri}", ["drive", "lamp"], tmp_path, write_config)
    assert len(told) == 2
    assert sum("commands the robot on '/gus/cmd_vel': -0.1 m/s" in each for each in told) == 1
    assert sum("commands the robot on '/gus/lamp': {'data': 'off'}" in each for each in told) == 1


@pytest.mark.long
def test_a_rival_over_dds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, write_config: Any) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    graph = f"dds:domain={claim_domain()}"
    with simulated_robot(graph, "--namespace", "/gus"):
        told = _failures(graph, ["drive", "way"], tmp_path, write_config)
    assert len(told) == 2
    assert all("commands the robot on '/gus/cmd_vel': -0.1 m/s" in each for each in told)


def test_a_mission_that_need_not_be_alone_is_doubtful_where_it_was_not(tmp_path: Path) -> None:
    for is_sole in (True, False):
        clock = FakeClock()
        link = FakeRobotLink(clock)
        clock.at(1.0, lambda link=link: link.deliver("/lamp", {"data": "off"}))  # type: ignore[misc]
        mission = TopicMission("lamp", _TEXT, {"data": "on"}, until=2.0, sole_control=is_sole)
        context = make_context(tmp_path, mission, robot="dds", links=FakeLinks(robot=link), clock=clock)
        if is_sole:
            with pytest.raises(RunFailed, match=r"another node commands the robot on '/lamp': {'data': 'off'}"):
                rehearse(context, mission)
        else:
            assert rehearse(context, mission)["Messages"] == 20
            assert "another node commands the robot" in context.broker.findings[0].problem


def test_a_rival_that_moves_a_robot_sideways_is_not_taken_for_our_command_to_stand_still(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    shape = TypeCatalogue.of(2).shape(_TWIST)
    still, sideways = (completed(shape, {"linear": {"y": speed}}, where="cmd_vel") for speed in (0.0, 0.3))
    Advertised(_TWIST, shape, SimpleNamespace(publish=print)).send("/cmd_vel", still)
    clock.at(0.5, lambda: link.deliver("/cmd_vel", still))
    clock.at(1.0, lambda: link.deliver("/cmd_vel", sideways))
    mission = TopicMission("cmd_vel", _TWIST, {}, until=2.0)
    context = make_context(tmp_path, mission, robot="dds", links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(RunFailed, match=r"another node commands the robot on '/cmd_vel': .*'y': 0\.3"):
        rehearse(context, mission)
    assert clock.now() == pytest.approx(1.0, abs=0.2)


def test_a_message_is_known_again_after_it_was_rounded_on_its_way() -> None:
    sent = {"name": ["arm"], "position": [0.1, float("nan")], "data": b"ab"}
    note_sent("/arm", sent)
    assert is_from_here("/arm", sent | {"position": [0.10000000149011612, float("nan")]})
    for other in ({"position": [0.2, float("nan")]}, {"name": ["leg"]}, {"data": b"ac"}, {"position": [0.1]}):
        assert not is_from_here("/arm", sent | other)


def test_a_command_of_ours_from_before_is_not_held_for_that_of_a_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    for velocity in ((0.2, 0.0), (0.0, 0.0)):
        note_sent("/long_ago", velocity)
        now[0] += 1.0
    assert is_from_here("/long_ago", (0.2, 0.0))
    now[0] += 10.0
    assert is_from_here("/long_ago", (0.0, 0.0)), "it still holds, and may be sent anew"
    assert not is_from_here("/long_ago", (0.2, 0.0))
