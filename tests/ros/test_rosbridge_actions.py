"""Actions through a rosbridge of ROS 2: what its servers tell of them, and what they do not."""

from __future__ import annotations

import threading
import time
from contextlib import closing

import pytest
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.goals import ActionCanceled, ActionResult, GoalStatus
from robot_runner.ros import rosbridge_actions
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.testing import RosbridgeServer

FIBONACCI = "example_interfaces/Fibonacci"


@pytest.fixture
def server():
    with closing(RosbridgeServer(generation=2)) as opened:
        yield opened


@pytest.fixture
def robot(server):
    with closing(open_rosbridge_link(server.url, SystemClock())) as opened:
        yield opened


@pytest.fixture
def link(server):
    with closing(open_rosbridge_link(server.url, SystemClock())) as opened:
        yield opened


def count(execution):
    deadline = time.monotonic() + PATIENCE
    while not execution.is_cancel_requested and execution.goal["order"] and time.monotonic() < deadline:
        execution.feedback({"sequence": [1]})
        time.sleep(0.02)
    return {"sequence": [2]}


def test_a_goal_that_is_rejected_is_told_as_far_as_the_server_tells_it(server, robot, link):
    robot.offer_action("count", FIBONACCI, count)
    server.actions.rejects["/count"] = lambda goal: goal["order"] < 0
    with pytest.raises(LinkError, match=r"does not accept the goal within 0\.5 s") as silent:
        link.send_goal("count", FIBONACCI, {"order": -1}, timeout=0.5)
    assert "rejects" in silent.value.fix
    assert "rosbridge_suite" in silent.value.fix
    server.actions.tells_rejection = True
    with pytest.raises(GoalRejectedError, match="Action goal was rejected"):
        link.send_goal("count", FIBONACCI, {"order": -1})


@pytest.mark.parametrize("tells", [True, False])
def test_a_server_that_is_too_old_for_actions_is_named_with_the_remedy(server, robot, link, tells):
    server.tells = tells
    robot.offer_action("count", FIBONACCI, count)
    server.actions.is_known = False
    with pytest.raises(LinkError) as sent:
        link.send_goal("count", FIBONACCI, {"order": 0}, timeout=0.5)
    with pytest.raises(LinkError) as offered:
        robot.offer_action("add", FIBONACCI, count)
    server.actions.is_known = True
    for error in (sent.value, offered.value):
        assert "rosbridge_suite 2.0 or newer" in error.fix


def test_messages_of_a_link_go_on_while_a_goal_of_it_is_executed(server, robot, link):
    robot.offer_action("count", FIBONACCI, count)
    before = len(server._clients)
    goal = link.send_goal("count", FIBONACCI, {"order": 1})
    assert len(server._clients) == before + 1  # servers take nothing else of a connection while a goal of it goes on
    # What whoever is left asks for once a run is dead: the end of all goals.
    link.call("count/_action/cancel_goal", "action_msgs/CancelGoal")
    goal.result(timeout=20.0)
    wait_until(lambda: len(server._clients) <= before)
    assert len(server._clients) == before  # that of the goal is closed; the call used the one of earlier calls


def test_a_connection_that_is_lost_ends_the_wait_for_a_goal_at_once(server, robot, link):
    robot.offer_action("count", FIBONACCI, count)
    goal = link.send_goal("count", FIBONACCI, {"order": 1})
    server._clients[-1].close()  # that of the goal
    begun = time.monotonic()
    with pytest.raises(LinkError, match="the connection is lost"):
        goal.result(timeout=60.0)
    assert time.monotonic() - begun < 10.0


@pytest.mark.parametrize("seconds", [0.0, 60.0])
def test_goals_of_two_clients_at_once_are_an_error_and_none_goes_on(server, robot, link, monkeypatch, seconds):
    def dig(execution):
        wait_until(lambda: execution.is_cancel_requested)
        ended.append(execution.goal["order"])
        raise ActionCanceled

    ended = []
    monkeypatch.setattr(rosbridge_actions, "_AT_ONCE", seconds)
    robot.offer_action("dig", FIBONACCI, dig)
    with closing(open_rosbridge_link(server.url, SystemClock())) as rival:
        own = link.send_goal("dig", FIBONACCI, {"order": 1})
        other = rival.send_goal("dig", FIBONACCI, {"order": 2})
        if seconds:
            with pytest.raises(LinkError, match="sent a goal to this action at the same time") as told:
                own.result(timeout=20)
            assert "nobody else" in told.value.fix
            wait_until(lambda: ended == [1])
        else:  # who comes later is somebody else for certain
            time.sleep(0.5)
            own.cancel(timeout=20)
            assert own.result(timeout=20).status is GoalStatus.CANCELED
        other.cancel(timeout=20)
        wait_until(lambda: ended == [1, 2])


def test_a_goal_that_is_given_up_as_another_s_is_not_told_to_be_cancelled_though_its_end_comes_first(
    robot, link, monkeypatch
):
    robot.offer_action("sow", FIBONACCI, count)
    goal = link.send_goal("sow", FIBONACCI, {"order": 1})
    monkeypatch.setattr(goal.client, "cancel", lambda sent, _: sent.finish(ActionResult(GoalStatus.CANCELED, {})))
    goal.client._give_up(goal, "it may be another client's")
    with pytest.raises(LinkError, match="it may be another client's"):
        goal.result(timeout=0.0)
    monkeypatch.undo()
    goal.client.cancel(goal, 0.0)


def test_a_goal_of_another_client_is_not_taken_for_one_that_was_silently_rejected(server, robot, link):
    def rejects(goal):
        if goal["order"] < 0:
            is_rejected.set()
        return goal["order"] < 0

    got, is_rejected = [], threading.Event()
    robot.offer_action("drill", FIBONACCI, lambda execution: time.sleep(1.0) or {"sequence": [7]})
    server.actions.rejects["/drill"] = rejects
    with closing(open_rosbridge_link(server.url, SystemClock())) as rival:
        sending = threading.Thread(target=lambda: got.append(link.send_goal("drill", FIBONACCI, {"order": -1})))
        sending.start()
        assert is_rejected.wait(PATIENCE)  # and nobody will say that it is not taken
        rival.send_goal("drill", FIBONACCI, {"order": 3})
        sending.join(30)
        with pytest.raises(LinkError, match="it was another client's") as told:
            got[0].result(timeout=30)
        assert "nobody else" in told.value.fix


def test_an_action_that_a_server_of_ros_1_still_publishes_is_not_offered_any_more():
    with closing(RosbridgeServer(generation=1)) as server:
        server.graph.unregister_timeout = 3600.0
        with closing(open_rosbridge_link(server.url, SystemClock())) as link:
            with closing(open_rosbridge_link(server.url, SystemClock())) as robot:
                robot.offer_action("count", FIBONACCI, count)
                assert link.actions() == {"/count": FIBONACCI}
            wait_until(lambda: not link.actions())
            assert link.topics()["/count/status"] == "actionlib_msgs/GoalStatusArray"
            link.offer_action("count", FIBONACCI, count)


def test_who_offers_an_action_again_that_its_server_keeps_is_told_to_start_the_server_anew(server, link):
    server.actions.keeps_actions = True
    with closing(open_rosbridge_link(server.url, SystemClock())) as robot:
        robot.offer_action("count", FIBONACCI, count)
    with pytest.raises(LinkError, match="offers the action '/count' already") as caught:
        link.offer_action("count", FIBONACCI, count)
    assert "restart it" in caught.value.fix


def test_a_request_to_cancel_does_not_wait_for_rosapi_which_may_hang(robot, link, monkeypatch):
    is_requested, answers = threading.Event(), threading.Event()

    def execute(execution):
        wait_until(lambda: execution.is_cancel_requested)
        is_requested.set()
        raise ActionCanceled

    robot.offer_action("count", FIBONACCI, execute)
    goal = link.send_goal("count", FIBONACCI, {"order": 1})
    graph = link._transport.actions
    is_served = graph.is_served
    monkeypatch.setattr(graph, "is_served", lambda action: answers.wait(PATIENCE) and is_served(action))
    cancelling = threading.Thread(target=goal.cancel)
    cancelling.start()
    try:
        assert is_requested.wait(PATIENCE / 4)
    finally:
        answers.set()
        cancelling.join(PATIENCE)
    assert goal.status is GoalStatus.CANCELED


def test_the_feedback_of_an_action_is_subscribed_as_any_topic_is_whoever_has_sent_the_goal(robot, link):
    """A server imports the type by the name that it is given, and finds this one only in the module of its action."""
    robot.offer_action("count", FIBONACCI, count)
    decoded, raw, topic = [], [], ("/count/_action/feedback", f"{FIBONACCI}_FeedbackMessage")
    link.subscribe(*topic, lambda message: decoded.append(list(message["feedback"]["sequence"])))
    link.subscribe_raw(*topic, lambda message: raw.append(message.data))
    goal = robot.send_goal("count", FIBONACCI, {"order": 1})
    wait_until(lambda: decoded and raw, "the feedback arrives")
    goal.cancel()
    assert decoded[0] == [1]
    assert raw[0].endswith(b"\1\0\0\0\1\0\0\0")
