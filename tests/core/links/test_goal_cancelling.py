"""Cancelling all goals of an action server, for a process that has sent none of them."""

from __future__ import annotations

from typing import Any

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links import goal_cancelling
from robot_runner.core.links.goal_cancelling import cancel_all_goals, keep_cancelling_goals
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
