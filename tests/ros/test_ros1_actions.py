"""Actions on ROS 1 beside the server and the client of ROS' own actionlib, in another process."""

from __future__ import annotations

import importlib.util
import json
import queue
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.goals import ActionCanceled, GoalStatus
from robot_runner.plugins.systems import ActionMission, TopicMission
from robot_runner.ros.link_opening import open_ros1_link
from robot_runner.ros.ros1_master import Master
from robot_runner.testing import FakeLinks, make_context

# Its names are no other test's: the master that they share remembers the types of topics that are no more.
NODE = Path(__file__).with_name("actionlib_node.py")
COUNTING = "actionlib/Test"
PREEMPTED, SUCCEEDED = 2, 3  # actionlib_msgs/GoalStatus

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("actionlib") is None, reason="no actionlib (on Debian: apt install python3-actionlib)"
)


class OtherNode:
    def __init__(self):
        self.process = subprocess.Popen([sys.executable, str(NODE)], stdout=subprocess.PIPE, text=True)
        self.said = queue.Queue()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()
        assert self.said.get(timeout=60.0) == {"ready": True}

    def _read(self):
        for line in self.process.stdout:
            self.said.put(json.loads(line))

    def close(self):
        self.process.kill()
        self.process.wait(60)
        self.reader.join(60)
        self.process.stdout.close()


@pytest.fixture
def other(master_uri):
    with closing(OtherNode()) as node:
        yield node
    Master(master_uri).forget("/counter")  # it was killed, and for other tests no robot is on the graph


@pytest.fixture
def link(other, master_uri):
    with closing(open_ros1_link({"master": master_uri}, SystemClock(), "")) as opened:
        yield opened


@pytest.mark.long
@quiet_about_rospy
def test_goals_of_actionlib_are_sent_followed_cancelled_and_refused(link):
    assert {name: kind for name, kind in link.actions().items() if name in {"/tally", "/picky"}} == {
        "/tally": COUNTING,
        "/picky": COUNTING,
    }
    told = []
    result = link.send_goal("tally", COUNTING, {"goal": 10}, on_feedback=told.append).result(timeout=20.0)
    assert (result.status, result.result, result.text) == (GoalStatus.SUCCEEDED, {"result": 10}, "counted")
    assert {"feedback": 9} in told
    long = link.send_goal("tally", COUNTING, {"goal": 5000})
    long.cancel(timeout=20.0)
    assert long.result(timeout=20.0).status is GoalStatus.CANCELED
    assert long.result(timeout=20.0).text == "stopped as asked"
    given_up = link.send_goal("tally", COUNTING, {"goal": -3}).result(timeout=20.0)
    assert (given_up.status, given_up.text) == (GoalStatus.ABORTED, "it cannot count down")
    with pytest.raises(GoalRejectedError, match="rejects the goal"):
        link.send_goal("picky", COUNTING, {"goal": 1})


@pytest.mark.long
@quiet_about_rospy
def test_a_client_of_actionlib_is_served(link, other):
    def execute(execution):
        for number in range(execution.goal["goal"]):
            if execution.is_cancel_requested:
                raise ActionCanceled("as asked")
            execution.feedback({"feedback": number})
            time.sleep(0.02)
        return {"result": execution.goal["goal"]}

    link.offer_action("ours", COUNTING, execute)
    facts = []
    while "is_cancelled" not in (fact := other.said.get(timeout=60.0)):
        facts.append(fact)
    assert facts[-1] == {"state": SUCCEEDED, "result": 5, "text": ""}
    assert {"feedback": 4} in facts
    assert fact["state"] == PREEMPTED


@pytest.mark.long
@quiet_about_rospy
def test_make_safe_cancels_a_goal_also_where_the_server_connects_late(link, tmp_path, monkeypatch):
    ended = queue.Queue()
    link.subscribe("tally/result", "actionlib/TestActionResult", lambda told: ended.put(told["status"]["status"]))
    link.publish("tally/goal", "actionlib/TestActionGoal", {"goal_id": {"id": "alone"}, "goal": {"goal": 1000}})
    link.wait_for("tally/status", "actionlib_msgs/GoalStatusArray", lambda told: told["status_list"], timeout=20.0)
    monkeypatch.setattr("robot_runner.ros.ros1_publisher.CONNECTING", 0.0)  # as on a busy machine
    mission = ActionMission("tally", COUNTING, {"goal": 1000})
    context = make_context(tmp_path, mission, robot="ros1", links=FakeLinks(robot=link))
    mission.make_safe(context)
    assert ended.get(timeout=20.0) == PREEMPTED
    mission.make_safe(context)  # nothing is executed any more


@pytest.mark.long
@quiet_about_rospy
def test_make_safe_says_where_a_server_does_not_cancel(link, other, tmp_path):
    link.send_goal("tally", COUNTING, {"goal": 5000})
    other.process.send_signal(signal.SIGSTOP)
    mission = ActionMission("tally", COUNTING, {"goal": 5000}, cancel_timeout_s=1.0)
    with pytest.raises(LinkError, match="do not end within 1 s after it was asked to cancel"):
        mission.make_safe(make_context(tmp_path, mission, robot="ros1", links=FakeLinks(robot=link)))


@pytest.mark.long
@quiet_about_rospy
def test_a_safe_message_reaches_also_who_connects_late(link, tmp_path, monkeypatch):
    heard = queue.Queue()
    link.subscribe("siren", "std_msgs/String", lambda message: heard.put(message["data"]))
    monkeypatch.setattr("robot_runner.ros.ros1_publisher.CONNECTING", 0.0)
    mission = TopicMission("siren", "std_msgs/String", {"data": "on"}, until=1.0, afterwards={"data": "off"})
    mission.make_safe(make_context(tmp_path, mission, robot="ros1", links=FakeLinks(robot=link)))
    assert heard.get(timeout=20.0) == "off"


@pytest.mark.long
@quiet_about_rospy
def test_a_server_that_is_killed_in_the_middle_is_an_error_soon(link, other):
    goal = link.send_goal("tally", COUNTING, {"goal": 5000})
    other.process.kill()
    begun = time.monotonic()
    with pytest.raises(LinkError, match="the action server is gone"):
        goal.result(timeout=60.0)
    assert time.monotonic() - begun < 20.0
