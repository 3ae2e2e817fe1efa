"""Goals that a link sends, where steps of two threads come in the order that is seldom."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.goals import GoalStatus
from robot_runner.ros import ros1_actions
from robot_runner.ros.action_calls import LinkGoals
from robot_runner.ros.action_server import GoalServer
from robot_runner.ros.ros1_actions import Ros1Actions
from robot_runner.ros.ros2_actions import Ros2Actions
from robot_runner.ros.sent_goal import SentGoal
from robot_runner.ros.shapes import Shape

if TYPE_CHECKING:
    from collections.abc import Callable

NOTHING = Shape("test/Empty", ())
COUNT = "test/Count"


class Dialect:
    """Actions whose clients note what is done with them; `finding` is called while one is looked for."""

    def __init__(self) -> None:
        self.clients: list[Any] = []
        self.finding: Callable[[], object] = lambda: None

    def types(self, action_type: str) -> Any:
        return SimpleNamespace(goal=NOTHING)

    def client(self, action: str, action_type: str, timeout: float) -> Any:
        self.finding()
        client = SimpleNamespace(sent=[], is_open=True, is_served=lambda: True, cancel=lambda sent, timeout: None)
        client.cancels_at_once = False
        client.send = lambda goal, sent, timeout: client.sent.append(sent)
        client.close = lambda: setattr(client, "is_open", False)
        self.clients.append(client)
        return client


def goals_of(dialect: Any, check_open: Callable[[str], None] = lambda _: None) -> LinkGoals:
    def wait(event: threading.Event, seconds: float) -> None:
        event.wait(seconds)

    return LinkGoals(dialect, wait, check_open)


def send(goals: LinkGoals, graph: str | None = None) -> SentGoal:
    return goals.send("/count", COUNT, {}, lambda _: None, 1.0, graph)


def test_two_threads_that_send_the_first_goal_of_an_action_share_its_client() -> None:
    dialect = Dialect()
    both = threading.Barrier(2)
    dialect.finding = lambda: both.wait(PATIENCE)
    goals = goals_of(dialect)
    threads = [threading.Thread(target=send, args=(goals,)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert sorted(len(client.sent) for client in dialect.clients) == [0, 2]
    assert [client.is_open for client in dialect.clients if not client.sent] == [False]
    goals.close()
    assert not any(client.is_open for client in dialect.clients)


def test_no_goal_is_sent_until_whoever_stands_by_knows_of_the_action(monkeypatch: pytest.MonkeyPatch) -> None:
    dialect, told = Dialect(), []
    goals = goals_of(dialect)

    def refuse(commanded: Any) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(commanded_topics, "_listeners", [refuse])
    for _ in range(2):  # as in a mission that goes on whatever is raised
        with pytest.raises(OSError, match="no space left"):
            send(goals, graph="dds:domain=7")
    assert not dialect.clients[0].sent
    monkeypatch.setattr(commanded_topics, "_listeners", [lambda each: told.append(each.topic)])
    for _ in range(2):
        send(goals, graph="dds:domain=7")
    assert (told, len(dialect.clients[0].sent)) == (["/count"], 2)


def test_a_client_that_is_found_after_the_link_was_closed_is_left() -> None:
    dialect = Dialect()
    is_closed: list[bool] = []

    def check_open(action: str) -> None:
        if is_closed:
            raise LinkError("the link was closed", where=action)

    goals = goals_of(dialect, check_open)

    def close() -> None:  # as another thread does while the server is looked for
        is_closed.append(True)
        goals.close()

    dialect.finding = close
    with pytest.raises(LinkError, match="the link was closed"):
        send(goals)
    assert [client.is_open for client in dialect.clients] == [False]


def test_an_error_of_any_kind_ends_a_goal_that_is_sent() -> None:
    dialect = Dialect()
    goals = goals_of(dialect)
    send(goals)

    def fail(goal: Any, sent: SentGoal, timeout: float) -> None:
        dialect.clients[0].sent.append(sent)
        raise RuntimeError("context is not valid")

    dialect.clients[0].send = fail
    with pytest.raises(RuntimeError):
        send(goals)
    assert dialect.clients[0].sent[-1].is_over


def test_a_goal_is_cancelled_also_where_the_graph_cannot_tell_whether_its_server_is_there() -> None:
    dialect = Dialect()
    goals = goals_of(dialect)
    sent = send(goals)
    (client,) = dialect.clients
    cancelled: list[SentGoal] = []

    def fail() -> bool:
        raise LinkError("the graph cannot be listed", where="/count")

    client.is_served, client.cancel = fail, lambda goal, timeout: cancelled.append(goal)
    sent.ask_for_end(1.0)
    assert cancelled == [sent]
    assert not sent.is_over


def test_what_a_goal_is_cannot_be_overtaken_by_that_it_was_accepted() -> None:
    sent = SentGoal("/count", lambda event, seconds: None, lambda _: None)
    sent.note(GoalStatus.EXECUTING)
    sent.note(GoalStatus.ACCEPTED)
    assert sent.status is GoalStatus.EXECUTING
    sent.note(GoalStatus.CANCELING)
    sent.note(GoalStatus.EXECUTING)  # the server may refuse, and go on
    assert sent.status is GoalStatus.EXECUTING


class GraphOfRos2:
    """A server of one action that accepts a goal as its client gives up."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.receivers: dict[str, Any] = {}

    def services(self) -> dict[str, str]:
        return {"/count/_action/send_goal": "test/Count_SendGoal"}

    def publishers(self, topic: str) -> list[Any]:
        return []

    def subscribe(self, topic: str, message_type: str, receive: Any, **_: Any) -> Any:
        self.receivers[topic] = receive
        return SimpleNamespace(close=lambda: None)

    def call(self, service: str, service_type: str, request: Any, timeout: float) -> Any:
        self.asked.append((service, request))
        if not service.endswith("send_goal"):
            return {"return_code": 0}
        told = {"goal_info": {"goal_id": request["goal_id"]}, "status": 2}
        self.receivers["/count/_action/status"](SimpleNamespace(message=lambda: {"status_list": [told]}))
        raise LinkError("the service does not answer", where=service)


def test_a_goal_of_ros2_that_begins_as_its_client_gives_up_is_cancelled() -> None:
    graph = GraphOfRos2()
    actions = Ros2Actions(graph)  # type: ignore[arg-type]
    actions.types = lambda _: SimpleNamespace(goal=NOTHING)  # type: ignore[method-assign,assignment,return-value]
    goals = goals_of(actions)
    with pytest.raises(LinkError, match="does not answer"):
        send(goals)
    wait_until(lambda: [service for service, _ in graph.asked if service.endswith("cancel_goal")])


class GraphOfRos1:
    """A graph on which goals and requests to cancel come as soon as they are subscribed, or one topic fails."""

    def __init__(self, failing: str = "") -> None:
        self.published: list[tuple[str, Any]] = []
        self.open: list[str] = []
        self._failing = failing
        self.handing_on: list[threading.Thread] = []

    def topics(self) -> dict[str, str]:
        return {}

    def advertise(self, topic: str, message_type: str, qos: Any) -> Any:
        for each in self.handing_on:
            each.join(0.2)  # what came before has all the time that it may want
        return self._opened(topic)

    def subscribe(self, topic: str, message_type: str, receive: Any, **_: Any) -> Any:
        opened = self._opened(topic)
        if topic.endswith("/goal"):
            goal = {"goal_id": {"id": "early", "stamp": {"sec": 1, "nanosec": 0}}, "goal": {}}
            self.handing_on.append(
                threading.Thread(target=receive, args=(SimpleNamespace(message=lambda: goal),), daemon=True)
            )
            self.handing_on[-1].start()
        return opened

    def _opened(self, topic: str) -> Any:
        if topic == self._failing:
            raise LinkError("the topic carries another type", where=topic)
        self.open.append(topic)
        return SimpleNamespace(
            publish=lambda message: self.published.append((topic, message)), close=lambda: self.open.remove(topic)
        )


def test_a_goal_that_comes_while_its_server_of_ros1_begins_is_executed() -> None:
    executed = threading.Event()
    faults: list[Exception] = []
    types: Any = SimpleNamespace(goal=NOTHING, result=NOTHING, feedback=NOTHING)
    graph = GraphOfRos1()

    def execute(_: object) -> dict[str, Any]:
        executed.set()
        return {}

    server = GoalServer("/count", types, execute, None, faults.append)
    served = Ros1Actions(graph).serve("/count", COUNT, server)  # type: ignore[arg-type]
    assert executed.wait(PATIENCE)
    wait_until(lambda: [topic for topic, _ in graph.published if topic == "/count/result"])
    served.close()
    assert faults == []
    assert graph.open == []


class ServerOfRos1:
    """A graph with an action server that takes each goal, and says of them what the test lets it say."""

    def __init__(self) -> None:
        self.keys: list[str] = []
        self.cancelled: list[str] = []
        self.receivers: dict[str, Any] = {}

    def publishers(self, topic: str) -> list[Any]:
        return ["/counter"]

    def subscribe(self, topic: str, message_type: str, receive: Any, **_: Any) -> Any:
        self.receivers[topic] = receive
        if topic.endswith("/status"):
            self.tell([])
        return SimpleNamespace(close=lambda: None)

    def advertise(self, topic: str, message_type: str, qos: Any) -> Any:
        return SimpleNamespace(
            publish=self.take if topic.endswith("/goal") else lambda asked: self.cancelled.append(asked["id"]),
            flush=lambda _: None,
            close=lambda: None,
        )

    def wait(self, event: threading.Event, seconds: float) -> None:
        event.wait(seconds)

    def take(self, message: Any) -> None:
        self.keys.append(message["goal_id"]["id"])
        self.tell(self.keys)

    def tell(self, keys: list[str]) -> None:
        listed = [{"goal_id": {"id": key}, "status": 1, "text": ""} for key in keys]
        self.receivers["/count/status"](SimpleNamespace(message=lambda: {"status_list": listed}))


def times(monotonic: Callable[[], float]) -> Any:
    return SimpleNamespace(monotonic=monotonic, time=time.time, time_ns=time.time_ns)


def test_a_goal_that_its_server_of_ros1_has_forgotten_is_lost_as_after_a_restart(monkeypatch: Any) -> None:
    now = 100.0
    monkeypatch.setattr(ros1_actions, "time", times(lambda: now))
    server = ServerOfRos1()
    actions = Ros1Actions(server)  # type: ignore[arg-type]
    actions.actions = lambda: {"/count": COUNT}  # type: ignore[method-assign]
    actions.types = lambda _: SimpleNamespace(goal=NOTHING)  # type: ignore[method-assign,assignment,return-value]
    goals = goals_of(actions)
    lost, other = send(goals), send(goals)
    server.tell([other.key])
    assert lost.fault is None  # it may be listed again at once
    now += 1.5
    server.tell([other.key])
    with pytest.raises(LinkError, match="does not know the goal any more"):
        lost.result(timeout=0.0)
    assert (other.fault, other.is_over) == (None, False)


def test_a_goal_of_ros1_is_cancelled_at_once_though_the_master_hangs(monkeypatch: Any) -> None:
    monkeypatch.setattr(ros1_actions, "time", times(lambda: 100.0))
    server = ServerOfRos1()
    actions = Ros1Actions(server)  # type: ignore[arg-type]
    actions.actions = lambda: {"/count": COUNT}  # type: ignore[method-assign]
    actions.types = lambda _: SimpleNamespace(goal=NOTHING)  # type: ignore[method-assign,assignment,return-value]
    goal = send(goals_of(actions))
    asked: list[str] = []
    monkeypatch.setattr(server, "publishers", asked.append)  # it answers after seconds
    server.tell(server.keys)
    goal.ask_for_end(1.0)
    assert (asked, server.cancelled) == ([], [goal.key])


@pytest.mark.parametrize("failing", ["/count/goal", "/count/cancel", "/count/feedback"])
def test_a_client_of_ros1_that_cannot_be_opened_leaves_no_topic_behind(failing: str) -> None:
    graph = GraphOfRos1(failing)
    actions = Ros1Actions(graph)  # type: ignore[arg-type]
    actions.actions = lambda: {"/count": COUNT}  # type: ignore[method-assign]
    with pytest.raises(LinkError, match="another type"):
        actions.client("/count", COUNT, 0.1)
    assert graph.open == []
