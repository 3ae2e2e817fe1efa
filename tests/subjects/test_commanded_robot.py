"""The robot that software under test commands, on a graph that is known only some time after it was joined."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import pytest
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import GraphEndpoint, Qos
from robot_runner.plugins.systems import Program
from robot_runner.subjects import commanded_robot, subject
from robot_runner.subjects.commanded_robot import CommandedRobot
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

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT, is_commanded: bool = True) -> bool:
        return True

    def publish(self, topic: str, message_type: str, message: object) -> None:
        self.commanded.append(topic)


@pytest.mark.parametrize("robot", ["dds:domain=7", "ros1"])
def test_a_robot_is_halted_also_after_a_run_that_is_over_before_its_graph_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, robot: str
) -> None:
    graph = SlowGraph(0.3 if robot.startswith("dds") else 0.0)  # who joins ROS 1 asks its master
    monkeypatch.setattr(commanded_robot, "connect_robot", lambda _: graph)
    monkeypatch.setattr(commanded_robot, "_DISCOVERY", 0.4)
    commanded = CommandedRobot(make_context(tmp_path, robot=robot, clock=SystemClock()))
    commanded.connect()
    commanded.look()
    commanded.look_at_last()
    commanded.halt()
    assert graph.commanded == ["/cmd_vel"]


class SharedServer(SlowGraph):
    """A graph behind a rosbridge's server, whose client the robot is, too."""

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/rosbridge_websocket", TWIST, is_own=True, is_shared=True)]


def test_a_robot_behind_the_server_of_our_own_link_is_halted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = SharedServer(0.0)
    monkeypatch.setattr(commanded_robot, "connect_robot", lambda _: graph)
    commanded = CommandedRobot(make_context(tmp_path, robot="rosbridge://robot", clock=SystemClock()))
    commanded.connect()
    commanded.look()
    commanded.halt()
    assert graph.commanded == ["/cmd_vel"]


def test_a_robot_that_is_known_to_be_commanded_is_waited_for_no_longer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commanded_robot, "connect_robot", lambda _: SlowGraph(0.0))
    monkeypatch.setattr(commanded_robot, "_DISCOVERY", 3600.0)
    commanded = CommandedRobot(make_context(tmp_path, robot="dds:domain=7", clock=SystemClock()))
    commanded.connect()
    commanded.look()
    commanded.look_at_last()


class GraphOfTwo(SlowGraph):
    """A graph with two robots, of which one takes no publisher of this type."""

    def topics(self) -> dict[str, str]:
        return {"/alice/cmd_vel": TWIST, "/bob/cmd_vel": TWIST}

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT, is_commanded: bool = True) -> bool:
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

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT, is_commanded: bool = True) -> bool:
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

    planners: tuple[str, ...] | list[str] = ()

    def publishers(self, topic: str) -> list[GraphEndpoint]:
        servers = [GraphEndpoint(node, TWIST, is_own=True, is_shared=True) for node in self._nodes[topic]]
        return [*servers, *(GraphEndpoint(node, TWIST) for node in self.planners)]


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


def test_a_program_that_ends_in_a_mission_does_not_stop_a_robot_that_the_mission_may_drive_through_the_same_server(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = GraphOfClients({"/cmd_vel": ["/rosbridge_websocket"]})
    robot = CommandedRobot(make_context(tmp_path, robot="rosbridge://robot"))
    monkeypatch.setattr(robot, "_link", graph)
    robot.look()
    robot.halt()
    assert graph.commanded == []
    graph.planners = ["/planner"]
    robot.look()
    robot.halt()
    assert graph.commanded == ["/cmd_vel"], "a node of its own has commanded it since"


class HangingGraph(SlowGraph):
    """A graph that does not tell anything any more, as a busy rosapi does for seconds."""

    def __init__(self) -> None:
        super().__init__(0.0)
        self.answers = threading.Event()
        self.is_asked = threading.Event()
        self.answers.set()

    def topics(self) -> dict[str, str]:
        self.is_asked.set()
        self.answers.wait(PATIENCE)
        return super().topics()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:Exception in thread watch over:pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("exit_codes", [[0], []])
def test_the_robot_of_a_program_that_ends_is_halted_at_once_though_its_graph_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exit_codes: list[int]
) -> None:
    graph = HangingGraph()
    monkeypatch.setattr(commanded_robot, "connect_robot", lambda _: graph)
    monkeypatch.setattr(subject, "_ROBOT_LOOK", 0.05)
    planner = Program(["sh", "-c", f"while [ ! -e {tmp_path}/end ]; do sleep 0.05; done"], exit_codes=exit_codes)
    context = make_context(tmp_path, planner, robot="ros1", clock=SystemClock())
    planner.start_run(context)
    graph.answers.clear()
    graph.is_asked.clear()
    assert graph.is_asked.wait(PATIENCE)
    (tmp_path / "end").touch()
    try:
        wait_until(lambda: graph.commanded == ["/cmd_vel"])
    finally:
        graph.answers.set()
        planner.stop_run(context)
    assert len(graph.commanded) > 1, "once more, as it may have commanded others, or again, since the last look"


@pytest.mark.long
def test_a_program_that_is_to_end_is_ended_though_its_graph_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = HangingGraph()
    monkeypatch.setattr(commanded_robot, "connect_robot", lambda _: graph)
    planner = Program(["sh", "-c", f"trap 'touch {tmp_path}/ended; exit' TERM; while :; do sleep 0.05; done"])
    context = make_context(tmp_path, planner, robot="ros1", clock=SystemClock())
    planner.start_run(context)
    graph.answers.clear()
    ending = threading.Thread(target=planner.stop_run, args=(context,))
    ending.start()
    try:
        wait_until((tmp_path / "ended").exists)
        wait_until(lambda: graph.commanded == ["/cmd_vel"])
    finally:
        graph.answers.set()
        ending.join(PATIENCE)
