"""The robot that software under test commands, on a graph that is known only some time after it was joined."""

from __future__ import annotations

import fcntl
import sys
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution.left_over import is_subject_left
from robot_runner.core.links.robot import GraphEndpoint
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.subjects import halting
from robot_runner.subjects.halting import CommandedRobot, Halting
from robot_runner.subjects.supervised_program import Start
from robot_runner.testing import make_context

if TYPE_CHECKING:
    from pathlib import Path

TWIST = "geometry_msgs/Twist"


class SlowGraph:
    """A graph on which a planner commands a robot, seen a while after it was joined."""

    def __init__(self, seconds: float) -> None:
        self._known_at = time.monotonic() + seconds
        self.commanded: list[str] = []

    @property
    def _is_known(self) -> bool:
        return time.monotonic() >= self._known_at

    def topics(self) -> dict[str, str]:
        return {"/cmd_vel": TWIST} if self._is_known else {}

    def publishers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/planner", TWIST)]

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/base", TWIST)]

    def advertise(self, topic: str, message_type: str) -> bool:
        return True

    def publish(self, topic: str, message_type: str, message: object) -> None:
        self.commanded.append(topic)


@pytest.mark.parametrize("robot", ["dds:domain=7", "ros1"])
def test_a_robot_is_halted_also_after_a_run_that_is_over_before_its_graph_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, robot: str
) -> None:
    graph = SlowGraph(0.3 if robot.startswith("dds") else 0.0)  # who joins ROS 1 asks its master
    monkeypatch.setattr(halting, "connect_robot", lambda _: graph)
    monkeypatch.setattr(halting, "_DISCOVERY", 0.4)
    commanded = CommandedRobot(make_context(tmp_path, robot=robot, clock=SystemClock()))
    commanded.connect()
    commanded.look()
    commanded.look_at_last()
    commanded.halt()
    assert graph.commanded == ["/cmd_vel"]


def test_a_robot_that_is_known_to_be_commanded_is_waited_for_no_longer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(halting, "connect_robot", lambda _: SlowGraph(0.0))
    monkeypatch.setattr(halting, "_DISCOVERY", 3600.0)
    commanded = CommandedRobot(make_context(tmp_path, robot="dds:domain=7", clock=SystemClock()))
    commanded.connect()
    commanded.look()
    commanded.look_at_last()


@pytest.mark.parametrize("fault", [LinkError("it is not reached", where="/alice"), RuntimeError("no context")])
@pytest.mark.parametrize("what", ["stop", "command_zero"])
def test_a_robot_that_is_not_reached_keeps_no_other_from_being_stopped(
    monkeypatch: pytest.MonkeyPatch, what: str, fault: Exception
) -> None:
    told: list[str] = []

    def publish(topic: str, *_: object) -> None:
        if "alice" in topic:
            raise fault
        told.append(topic)

    def keep_commanding(link: Any, topics: Any) -> list[str]:
        link.publish(topics[0][0])
        return []

    monkeypatch.setattr(halting, "keep_commanding_zero", keep_commanding)
    topics = {name: [(f"/{name}/cmd_vel", TWIST), (f"/{name}/arm", TWIST)] for name in ("alice", "bob")}
    robots = halting._CommandedRobots(SimpleNamespace(by_robot=lambda: topics), Resources())  # type: ignore[arg-type]
    robots._links = {
        name: SimpleNamespace(publish=publish, topics=lambda: {"/alice/cmd_vel": TWIST}) for name in topics
    }
    if what == "stop":
        with pytest.raises(type(fault), match=str(fault.args[0])):
            robots.stop()
    else:
        robots.command_zero()
    assert "/bob/cmd_vel" in told


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")
def test_until_the_process_that_halts_the_robot_has_ended_others_see_that_it_is_there(tmp_path: Path) -> None:
    start = Start(tmp_path / "subjects" / "Planner" / "1")
    start.folder.mkdir(parents=True)
    supervisor, folder = start.events.open("w"), ExperimentFolder(tmp_path)
    with supervisor:
        fcntl.flock(supervisor, fcntl.LOCK_EX)
        halts = Halting(start, "Planner")
        assert is_subject_left(folder), "from its beginning on"
    halts.finish()
    assert not is_subject_left(folder)


class GraphOfTwo(SlowGraph):
    """A graph with two robots, of which one takes no publisher of this type."""

    def topics(self) -> dict[str, str]:
        return {"/alice/cmd_vel": TWIST, "/bob/cmd_vel": TWIST}

    def advertise(self, topic: str, message_type: str) -> bool:
        if "alice" in topic:
            raise LinkError("the topic carries another type", where=topic)
        return True


def test_a_robot_that_takes_no_publisher_keeps_no_other_from_being_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = CommandedRobot(make_context(tmp_path, robot="ros2"))
    monkeypatch.setattr(robot, "_link", GraphOfTwo(0.0))
    robot.look()
    assert list(robot._taken) == ["/bob/cmd_vel"]
