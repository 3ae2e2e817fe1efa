"""Goals that are sent to the scripted link go as the test says, by the clock."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.links.goals import ActionAborted, GoalStatus
from robot_runner.testing import FakeAction, FakeClock, FakeRobotLink

DOCK = "nav2_msgs/NavigateToPose"


def test_a_goal_takes_its_time_with_feedback_on_the_way():
    clock, told = FakeClock(), []
    script = FakeAction({"error_code": 0}, seconds=3.0, feedback=[{"left": 2}, {"left": 1}])
    link = FakeRobotLink(clock, actions={"dock": script})
    goal = link.send_goal("dock", DOCK, {"pose": {}}, on_feedback=lambda message: told.append((clock.now(), message)))
    assert goal.status is GoalStatus.EXECUTING
    with pytest.raises(LinkError, match="not over within 1 s"):
        goal.result(timeout=1.0)
    result = goal.result(timeout=5.0)
    assert result.has_succeeded
    assert result.result == {"error_code": 0}
    assert [message["left"] for _, message in told] == [2, 1]
    assert [time for time, _ in told] == pytest.approx([1.0, 2.0], abs=0.02)
    assert clock.now() == pytest.approx(3.0, abs=0.02)
    assert [(each.action, each.goal) for each in link.goals] == [("dock", {"pose": {}})]


def test_goals_are_refused_cancelled_and_not_cancelled_as_scripted():
    actions = {
        "busy": FakeAction(status=GoalStatus.REJECTED),
        "long": FakeAction(seconds=60.0),
        "stubborn": FakeAction(seconds=60.0, refuses_cancel=True),
    }
    link = FakeRobotLink(FakeClock(), actions=actions)
    with pytest.raises(GoalRejectedError):
        link.send_goal("busy", DOCK)
    with pytest.raises(LinkError, match="there is no action 'lung'") as missing:
        link.send_goal("lung", DOCK)
    assert missing.value.fix == "Did you mean 'long'?"
    with pytest.raises(LinkError, match="refuses"):
        link.send_goal("stubborn", DOCK).cancel()
    goal = link.send_goal("long", DOCK)
    link.close()
    assert goal.result(timeout=0.0).status is GoalStatus.CANCELED


def test_an_action_that_is_offered_is_executed():
    def execute(execution):
        if execution.goal["order"] < 0:
            raise ActionAborted("no way")
        execution.feedback({"sequence": [1]})
        return {"sequence": [1, 2]}

    link, told = FakeRobotLink(FakeClock()), []
    offer = link.offer_action("count", "example_interfaces/Fibonacci", execute, accept=lambda goal: goal["order"] != 0)
    assert link.actions() == {"/count": "example_interfaces/Fibonacci"}
    goal = link.send_goal("count", "example_interfaces/Fibonacci", {"order": 1}, on_feedback=told.append)
    assert goal.result(timeout=1.0).result == {"sequence": [1, 2]}
    assert told == [{"sequence": [1]}]
    aborted = link.send_goal("count", "example_interfaces/Fibonacci", {"order": -1})
    assert (aborted.status, aborted.result(timeout=1.0).text) == (GoalStatus.ABORTED, "no way")
    with pytest.raises(GoalRejectedError):
        link.send_goal("count", "example_interfaces/Fibonacci", {"order": 0})
    offer.close()
    assert link.actions() == {}
