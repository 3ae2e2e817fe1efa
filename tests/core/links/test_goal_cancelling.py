"""Cancelling all goals of an action server, for a process that has sent none of them."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links import goal_cancelling
from robot_runner.core.links.goal_cancelling import cancel_all_goals, keep_cancelling_goals
from robot_runner.core.links.robot import Encoding
from robot_runner.testing import FakeAction, FakeClock, FakeRobotLink

CANCEL = "/dig/_action/cancel_goal"


@pytest.mark.parametrize(
    ("cancel", "is_there", "waits"),
    [(cancel_all_goals, False, [1.0]), (cancel_all_goals, True, [1.0, 5.0]), (keep_cancelling_goals, False, [5.0])],
    ids=["its server has ended", "its server is slow", "a graph that may not be known yet"],
)
def test_only_a_server_that_may_be_there_is_awaited_for_long(
    cancel: Any, is_there: bool, waits: list[float], monkeypatch: Any
) -> None:
    link = FakeRobotLink(FakeClock(), actions={"/dig": FakeAction()} if is_there else {})
    waited: list[float] = []

    def call(service: str, *_: Any, timeout: float) -> dict[str, Any]:
        waited.append(timeout)
        if is_there and len(waited) > 1:
            return {"return_code": 0}
        raise LinkError("no answer", where=service)

    monkeypatch.setattr(link, "call", call)
    cancel(link, "/dig")
    assert waited == waits


def test_a_goal_that_arrives_after_the_request_to_cancel_it_is_cancelled_too(monkeypatch: Any) -> None:
    executed, on_the_way = ["early"], ["late"]

    def cancel(_: Any) -> dict[str, Any]:
        executed[:] = [on_the_way.pop()] if on_the_way else []
        return {"return_code": 0}

    monkeypatch.setattr(goal_cancelling, "_LATE_SECONDS", 0.1)
    link = FakeRobotLink(FakeClock())
    link.offer(CANCEL, "action_msgs/CancelGoal", cancel)
    keep_cancelling_goals(link, "/dig")
    assert (executed, on_the_way) == ([], [])


def test_a_server_that_refuses_is_an_error() -> None:
    link = FakeRobotLink(FakeClock())
    link.offer(CANCEL, "action_msgs/CancelGoal", lambda _: {"return_code": 1})
    with pytest.raises(LinkError, match="refuses to cancel its goals"):
        cancel_all_goals(link, "/dig")


@pytest.mark.parametrize("cancel", [cancel_all_goals, keep_cancelling_goals])
@pytest.mark.parametrize(
    ("states", "goes_on"),
    [([2], True), ([6, 1], True), ([2, 3], True), ([3], True), ([4, 5, 6], False), ([], False), (None, False)],
)
def test_a_server_that_answers_well_and_goes_on_is_an_error(
    cancel: Any, states: list[int] | None, goes_on: bool, monkeypatch: Any
) -> None:
    monkeypatch.setattr(goal_cancelling, "_LATE_SECONDS", 0.0)
    link = FakeRobotLink(FakeClock(), actions={"/dig": FakeAction()})
    link.offer(CANCEL, "action_msgs/CancelGoal", lambda _: {"return_code": 0, "goals_canceling": []})
    _tell(link, "/dig/_action/status", states, monkeypatch)
    with pytest.raises(LinkError, match="do not end within 5 s after it was asked") if goes_on else nullcontext():
        cancel(link, "/dig")


@pytest.mark.parametrize(
    ("states", "goes_on"), [([1], True), ([6], True), ([7, 3], True), ([2, 3, 4, 5, 8, 9], False), ([], False)]
)
def test_a_goal_of_ros_1_that_takes_the_request_and_goes_on_is_an_error(
    states: list[int], goes_on: bool, monkeypatch: Any
) -> None:
    link = FakeRobotLink(FakeClock(), actions={"/dig": FakeAction()})
    monkeypatch.setattr(link, "encoding", Encoding.ROS1, raising=False)
    _tell(link, "/dig/status", states, monkeypatch)
    with pytest.raises(LinkError, match="do not end within 0 s after it was asked") if goes_on else nullcontext():
        cancel_all_goals(link, "/dig", timeout=0.0)


def _tell(link: FakeRobotLink, topic: str, states: list[int] | None, monkeypatch: Any) -> None:
    """Deliver the states of goals to whoever subscribes, as they are transient local, or come again at once."""
    subscribe = link.subscribe

    def told_at_once(name: str, message_type: str, callback: Any) -> Any:
        subscription = subscribe(name, message_type, callback)
        if states is not None:
            link.deliver(topic, {"status_list": [{"status": each} for each in states]})
        return subscription

    monkeypatch.setattr(link, "subscribe", told_at_once)


def test_a_goal_whose_end_takes_a_moment_after_the_answer_is_waited_for(monkeypatch: Any) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock, actions={"/dig": FakeAction()})
    link.offer(CANCEL, "action_msgs/CancelGoal", lambda _: {"return_code": 0})
    status = iter([2, 2, 3, 3, 3, 5])

    def sleep(seconds: float) -> None:
        link.deliver("/dig/_action/status", {"status_list": [{"status": next(status)}]})

    monkeypatch.setattr(clock, "sleep", sleep)
    cancel_all_goals(link, "/dig")
    assert next(status, None) is None
