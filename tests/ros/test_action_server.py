"""The server of an action, whatever the graph speaks."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.links.goals import ActionCanceled, GoalStatus
from robot_runner.ros import action_server
from robot_runner.ros.action_server import GoalServer
from robot_runner.ros.ros1_actions import Ros1Actions
from robot_runner.ros.shapes import Shape

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.ros.action_server import Execution

NOTHING = Shape("test/Empty", ())
TYPES = SimpleNamespace(goal=NOTHING, result=NOTHING, feedback=NOTHING)


@pytest.fixture(autouse=True)
def _nobody_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a server wait for its goals for as long as it takes: on a busy machine that may be long."""
    monkeypatch.setattr(action_server, "_ENDING_SECONDS", PATIENCE)


class SlowOutlet:
    """Takes its time to tell that a goal is being cancelled; a subscriber that keeps the last message has the last."""

    def __init__(self) -> None:
        self.told: list[GoalStatus] = []
        self.is_telling, self.may_tell = threading.Event(), threading.Event()

    def tell_status(self, executions: Sequence[Execution]) -> None:
        (status,) = [each.status for each in executions]
        if status is GoalStatus.CANCELING:
            self.is_telling.set()
            self.may_tell.wait(PATIENCE)
        self.told.append(status)

    def tell_result(self, execution: Execution, result: Any) -> None: ...
    def tell_feedback(self, execution: Execution, message: Any) -> None: ...


def test_the_last_state_that_is_told_of_a_goal_is_its_end() -> None:
    def execute(execution: Any) -> dict[str, Any]:
        outlet.is_telling.wait(PATIENCE)
        raise ActionCanceled

    outlet = SlowOutlet()
    server = GoalServer("/count", TYPES, execute, None, lambda fault: None)
    server.connect(outlet)
    execution = server.accept("1", {})
    assert execution is not None
    cancelling = threading.Thread(target=server.cancel, args=(execution,))
    cancelling.start()
    assert execution.over.wait(PATIENCE)  # it is over before it was told that it is being cancelled
    outlet.may_tell.set()
    cancelling.join(PATIENCE)
    server.close()
    for thread in threading.enumerate():
        if thread.name == "action":
            thread.join(PATIENCE)
    assert outlet.told[-1] is GoalStatus.CANCELED
    assert outlet.told.count(GoalStatus.CANCELING) == 1


class LateOutlet:
    """Takes its time to tell the result of a goal."""

    def __init__(self) -> None:
        self.is_telling, self.may_tell = threading.Event(), threading.Event()

    def tell_result(self, execution: Execution, result: Any) -> None:
        self.is_telling.set()
        self.may_tell.wait(PATIENCE)

    def tell_status(self, executions: Sequence[Execution]) -> None: ...
    def tell_feedback(self, execution: Execution, message: Any) -> None: ...


def test_an_action_is_withdrawn_once_the_results_of_its_goals_are_told() -> None:
    outlet = LateOutlet()
    server = GoalServer("/count", TYPES, lambda _: {}, None, lambda fault: None)
    server.connect(outlet)
    server.accept("1", {})
    assert outlet.is_telling.wait(PATIENCE)  # it is over, and whoever sent it does not know what came of it yet
    closing = threading.Thread(target=server.close)
    closing.start()
    closing.join(0.1)
    was_waiting = closing.is_alive()
    outlet.may_tell.set()
    closing.join(PATIENCE)
    assert was_waiting
    assert not closing.is_alive()


def test_an_action_that_is_withdrawn_by_whoever_hears_its_result_waits_for_nobody() -> None:
    server = GoalServer("/count", TYPES, lambda _: {}, None, lambda fault: None)
    is_awaited: list[bool] = []

    def withdraw(execution: Execution, _result: Any) -> None:
        with pytest.MonkeyPatch.context() as watched:
            watched.setattr(execution.told, "wait", lambda _: is_awaited.append(True))
            server.close()
        is_awaited.append(False)

    outlet: Any = SimpleNamespace(tell_result=withdraw, tell_status=lambda _: None)
    server.connect(outlet)
    server.start = lambda work: work()  # as in a simulation, whose subscribers hear it in the same thread
    server.accept("1", {})
    assert is_awaited == [False]


class ScriptedTransport:
    """A graph of ROS 1 with one server, to which messages are delivered by hand."""

    def __init__(self) -> None:
        self.published: list[tuple[str, Any]] = []
        self.receivers: dict[str, Callable[[Any], None]] = {}

    def topics(self) -> dict[str, str]:
        return {}

    def advertise(self, topic: str, message_type: str, qos: Any) -> Any:
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)), close=lambda: None)

    def subscribe(self, topic: str, message_type: str, receive: Callable[[Any], None], **_: Any) -> Any:
        self.receivers[topic] = receive
        return SimpleNamespace(close=lambda: None)

    def deliver(self, topic: str, message: Any) -> None:
        self.receivers[topic](SimpleNamespace(message=lambda: message))


def test_a_server_of_ros1_forgets_the_goals_that_are_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(action_server, "_REMEMBERED_SECONDS", 0.0)
    transport = ScriptedTransport()
    server = GoalServer("/count", TYPES, lambda _: {}, None, lambda fault: None)
    served: Any = Ros1Actions(transport).serve("/count", "test/Count", server)  # type: ignore[arg-type]
    for number in range(50):
        stamp = {"sec": number, "nanosec": 0}
        transport.deliver("/count/goal", {"goal_id": {"id": f"goal {number}", "stamp": stamp}, "goal": {}})
        execution = server.find(f"goal {number}")
        assert execution is None or execution.over.wait(PATIENCE)
    served.close()
    results = [message["status"]["goal_id"] for topic, message in transport.published if topic == "/count/result"]
    # Each is published by the thread of its goal, which tells that the goal is over before.
    found = sorted((each["stamp"]["sec"], each["id"]) for each in results)
    assert found == [(n, f"goal {n}") for n in range(50)]
    assert len(served._stamps) <= 2


def test_that_a_state_cannot_be_told_keeps_no_goal_from_being_executed_or_cancelled() -> None:
    def lose(_: object) -> None:
        raise RuntimeError("context is not valid")

    executed: list[str] = []

    def execute(execution: Any) -> dict[str, Any]:
        wait_until(lambda: execution.is_cancel_requested, "it was not asked to end")
        executed.append(execution.key)
        raise ActionCanceled

    outlet: Any = SimpleNamespace(tell_status=lose, tell_result=lambda *_: None)
    server = GoalServer("/count", TYPES, execute, None, lambda fault: None)
    server.connect(outlet)
    executions = [server.accept(key, {}) for key in ("1", "2")]
    server.close()
    assert [each.status for each in executions if each is not None] == [GoalStatus.CANCELED] * 2
    assert sorted(executed) == ["1", "2"]


def test_a_goal_that_comes_as_its_action_is_withdrawn_is_not_begun() -> None:
    begun: list[str] = []

    def accept(_: object) -> bool:
        server.close()  # as another thread does meanwhile
        return True

    server = GoalServer(
        "/count", TYPES, lambda execution: begun.append(execution.goal) or {}, accept, lambda fault: None
    )
    assert server.accept("1", {}) is None
    assert begun == []
