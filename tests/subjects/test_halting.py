"""The robot that software under test commands, on a graph that is known only some time after it was joined."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
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
from robot_runner.subjects.halting import CommandedRobot, CommandedTopics, Halting, end_left_subjects
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

    def advertise(self, topic: str, message_type: str, *, is_commanded: bool = True) -> bool:
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

    def advertise(self, topic: str, message_type: str, *, is_commanded: bool = True) -> bool:
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


class GraphOfNodes(SlowGraph):
    """A graph of velocities: who publishes each topic; a multiplexer that is gone subscribes them all."""

    def __init__(self, nodes: dict[str, list[str]]) -> None:
        super().__init__(0.0)
        self._nodes = nodes
        self.insisted: dict[str, bool] = {}

    def topics(self) -> dict[str, str]:
        return dict.fromkeys(self._nodes, TWIST)

    def publishers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint(node, TWIST) for node in self._nodes[topic]]

    def advertise(self, topic: str, message_type: str, *, is_commanded: bool = True) -> bool:
        self.insisted[topic] = is_commanded
        return True


def test_zero_has_to_arrive_only_where_somebody_was_seen_to_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes: dict[str, list[str]] = {"/joy_vel": [], "/nav_vel": []}
    graph = GraphOfNodes(nodes)
    robot = CommandedRobot(make_context(tmp_path, robot="ros2"))
    monkeypatch.setattr(robot, "_link", graph)
    robot.look()
    assert graph.insisted == {"/joy_vel": False, "/nav_vel": False}
    nodes["/nav_vel"] = ["/planner"]
    robot.look()
    assert graph.insisted == {"/joy_vel": False, "/nav_vel": True}


class GraphOfClients(GraphOfNodes):
    """A graph behind a server whose clients cannot be told apart, this link being one of them."""

    def publishers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint(node, TWIST, is_own=True, is_shared=True) for node in self._nodes[topic]]


def test_a_server_that_publishes_for_software_as_for_this_link_counts_as_somebody_who_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = GraphOfClients({"/cmd_vel": ["/rosbridge_websocket"]})
    robot = CommandedRobot(make_context(tmp_path, robot="rosbridge://robot"))
    monkeypatch.setattr(robot, "_link", graph)
    told: list[str] = []
    robot.tell = lambda topic, _: told.append(topic)
    robot.look()
    assert graph.insisted == {"/cmd_vel": True}
    assert told == ["/cmd_vel"]


def begun(root: Path) -> Start:
    """Return a start of an experiment in this folder."""
    start = Start(root / "subjects" / "Planner" / "1")
    start.folder.mkdir(parents=True)
    return start


@pytest.fixture
def halted(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Take the place of the process that halts robots; return the starts after which it was to do so."""
    starts: list[Path] = []

    def halt(start: Start, _name: str) -> Any:
        starts.append(start.folder)
        return SimpleNamespace(finish=lambda: CommandedTopics(start).end(""))

    monkeypatch.setattr(halting, "Halting", halt)
    return starts


def test_nothing_but_a_velocity_is_commanded_whatever_somebody_has_written_into_the_file_of_a_start(
    tmp_path: Path, halted: list[Path]
) -> None:
    start = begun(tmp_path)
    told = [
        5,
        [],
        "robot",
        {"robot": 5},
        {"robot": "ros2"},
        {"robot": "ros2", "topic": "/takeoff", "type": "std_msgs/Empty"},
    ]
    told += [
        {"problem": 5},
        {"robot": "ros2", "topic": [], "type": TWIST},
        {"robot": "ros2", "topic": "/arm", "type": []},
    ]
    (start.folder / "commanded.jsonl").write_text("".join(f"{json.dumps(each)}\n" for each in told))
    assert CommandedTopics(start).by_robot() == {}
    assert list(end_left_subjects(tmp_path, lambda _: True)) == []
    assert halted == []


def test_a_pipe_in_the_place_of_that_file_is_not_waited_for(tmp_path: Path) -> None:
    start = begun(tmp_path)
    os.mkfifo(start.folder / "commanded.jsonl")
    assert CommandedTopics(start).by_robot() == {}


@pytest.mark.parametrize("is_moved", [False, True], ids=["copied", "moved"])
def test_a_copy_that_was_made_while_a_program_commanded_a_robot_leaves_that_to_the_original(
    tmp_path: Path, halted: list[Path], is_moved: bool
) -> None:
    root, other = tmp_path / "trial", tmp_path / "backup"
    start = begun(root)
    CommandedTopics(start).add("ros2:domain=7", "/cmd_vel", TWIST)
    shutil.copytree(root, other)
    if is_moved:
        shutil.rmtree(root)
    assert len(list(end_left_subjects(other, lambda _: True))) == is_moved
    assert len(halted) == is_moved
    assert len(list(end_left_subjects(root, lambda _: True))) == (not is_moved)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")
def test_who_was_to_halt_the_robot_and_is_stopped_holds_nobody_up_and_is_ended_by_the_next_execution(
    tmp_path: Path, halted: list[Path]
) -> None:
    start = begun(tmp_path)
    commanded = CommandedTopics(start)
    commanded.add("ros2", "/cmd_vel", TWIST)
    with commanded.locked() as inherited:
        stopped = subprocess.Popen(["/bin/sleep", "60"], pass_fds=inherited)
    with stopped:
        try:
            assert is_subject_left(ExperimentFolder(tmp_path))
            os.kill(stopped.pid, signal.SIGSTOP)
            os.waitid(os.P_PID, stopped.pid, os.WSTOPPED)
            assert not is_subject_left(ExperimentFolder(tmp_path)), "it stops no robot"
            (told,) = end_left_subjects(tmp_path, lambda _: True)
            assert "it was commanded to stand still now" in told.problem
            assert stopped.wait(5) == -signal.SIGKILL, "once continued, it would stop the robot in the midst of a run"
            assert halted == [start.folder]
        finally:
            stopped.kill()
