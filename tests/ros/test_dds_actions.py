"""Actions over DDS beside a server and a client of another process, which know nothing of it."""

from __future__ import annotations

import threading
import time
from contextlib import closing

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.other_node import OtherNode
from tests.waiting import wait_until

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.goals import GoalStatus
from robot_runner.ros.link_opening import open_dds_link

DOMAIN = claim_domain()
FIBONACCI = "example_interfaces/Fibonacci"


def other_node():
    return OtherNode("bare_action_node.py", str(DOMAIN))


@pytest.fixture
def other(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    with closing(other_node()) as node:
        yield node


@pytest.fixture
def link(other):
    with closing(open_dds_link({"domain": str(DOMAIN)}, SystemClock())) as opened:
        yield opened


@pytest.mark.long
def test_goals_of_a_foreign_server_are_sent_followed_and_cancelled(link):
    told = []
    assert link.actions() == {"/count": FIBONACCI}
    goal = link.send_goal("count", FIBONACCI, {"order": 6}, on_feedback=told.append)
    result = goal.result(timeout=20.0)
    assert result.has_succeeded
    assert result.result == {"sequence": [0, 1, 1, 2, 3, 5, 8]}
    assert {"sequence": [5, 8]} in told
    long = link.send_goal("count", FIBONACCI, {"order": 5000})
    long.cancel(timeout=20.0)
    assert long.result(timeout=20.0).status is GoalStatus.CANCELED


@pytest.mark.long
def test_what_a_foreign_server_refuses_or_does_not_answer_is_named_in_time(link):
    with pytest.raises(GoalRejectedError, match="rejects the goal"):
        link.send_goal("count", FIBONACCI, {"order": 0})
    with pytest.raises(LinkError, match=r"does not answer within 0\.5 s"):
        link.send_goal("count", FIBONACCI, {"order": 13}, timeout=0.5)
    stubborn = link.send_goal("count", FIBONACCI, {"order": 99})
    with pytest.raises(LinkError, match="the goal is not cancelled: the server refuses"):
        stubborn.cancel()
    assert stubborn.result(timeout=20.0).has_succeeded


@pytest.mark.long
def test_two_servers_of_one_name_are_refused(link):
    with closing(other_node()):
        deadline = time.monotonic() + 20.0
        while len(link.publishers("count/_action/status")) < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
        with pytest.raises(LinkError, match="2 nodes offer the action"):
            link.send_goal("count", FIBONACCI, {"order": 6})


def test_a_foreign_client_is_served(link, other):
    facts = []

    def execute(execution):  # what is told before the other side's reader is found is lost to it
        told = {"sequence": [execution.goal["order"]]}
        wait_until(lambda: execution.feedback(told) or any("feedback" in fact for fact in facts))
        return {"sequence": [1, 2, 3]}

    link.offer_action("ours", FIBONACCI, execute)
    other.until(lambda fact: facts.append(fact) or "result" in fact)
    assert {"accepted": True} in facts
    assert {"feedback": [5], "is_mine": True} in facts
    assert facts[-1] == {"status": 4, "result": [1, 2, 3]}


@pytest.mark.long
def test_a_server_that_leaves_in_the_middle_is_an_error_at_once(link, other):
    goal = link.send_goal("count", FIBONACCI, {"order": 5000})
    threading.Timer(0.3, other.process.terminate).start()
    begun = time.monotonic()
    with pytest.raises(LinkError, match="the action server is gone"):
        goal.result(timeout=60.0)
    assert time.monotonic() - begun < 20.0
