"""What the link through a rosbridge does where steps of its threads and of the server come in the seldom order."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing, contextmanager, suppress

import pytest
from tests.conftest import HEAD
from tests.ros.test_rosbridge_security import lab, served
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.goals import GoalStatus
from robot_runner.core.links.robot import Qos
from robot_runner.ros import rosbridge_actions, rosbridge_frames
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.testing import RosbridgeServer

__all__ = ["lab"]

STRING, TWIST, TRIGGER = "std_msgs/String", "geometry_msgs/Twist", "std_srvs/Trigger"
FIBONACCI = "example_interfaces/Fibonacci"


@pytest.fixture(params=[1, 2])
def server(request):
    with closing(RosbridgeServer(generation=request.param)) as opened:
        yield opened


@pytest.fixture
def server_of_ros2():
    with closing(RosbridgeServer(generation=2)) as opened:
        yield opened


@pytest.fixture
def opened():
    with ExitStack() as leaving:

        def open_link(server):
            link = open_rosbridge_link(server.url, SystemClock())
            leaving.push(lambda *_: True)
            leaving.callback(link.close)
            return link

        yield open_link


def test_a_kept_message_that_comes_before_its_subscription_is_confirmed_is_received(server, opened, monkeypatch):
    server.publish("/map", STRING, {"data": "kept"}, is_latched=True)
    link = opened(server)
    confirms = link._transport._rosapi.confirm_subscription

    def confirm_late(*given):
        time.sleep(0.2)
        return confirms(*given)

    monkeypatch.setattr(link._transport._rosapi, "confirm_subscription", confirm_late)
    assert link.wait_for("map", STRING, timeout=PATIENCE) == {"data": "kept"}


def test_a_subscription_that_the_server_refuses_leaves_nobody_who_receives(server, opened, monkeypatch):
    link, heard = opened(server), []

    def refuse(*_):
        raise LinkError("the server does not take it", where="/map")

    monkeypatch.setattr(link._transport._rosapi, "confirm_subscription", refuse)
    with pytest.raises(LinkError, match="does not take it"):
        link.subscribe("map", STRING, heard.append)
    server.publish("/map", STRING, {"data": "a"})
    assert link._transport._topics == {}
    assert heard == []


def test_a_subscription_that_was_interrupted_as_it_began_begins_anew(server, opened, monkeypatch):
    def interrupt(*_args, **_more):
        raise RunInterrupted

    link, heard = opened(server), []
    with monkeypatch.context() as patch:
        patch.setattr(link._transport._session, "request", interrupt)
        with pytest.raises(RunInterrupted):
            link.subscribe("chatter", STRING, heard.append)
    link.subscribe("chatter", STRING, heard.append)
    server.publish("/chatter", STRING, {"data": "a"})
    wait_until(lambda: heard == [{"data": "a"}])


def test_a_message_that_comes_while_another_subscription_begins_comes_once(server, opened):
    link, heard = opened(server), []
    first = link.subscribe("map", STRING, print)
    (topic,) = link._transport._topics.values()

    class Keeping(type(topic.kept[False])):
        """Kept messages; another subscription begins as soon as one was added."""

        def append(self, each):
            super().append(each)
            beginning = threading.Thread(
                target=lambda: link.subscribe("map", STRING, heard.append, qos=Qos.TRANSIENT_LOCAL)
            )
            beginning.start()
            beginning.join(0.3)

    topic.kept[False] = Keeping(maxlen=1)
    server.publish("/map", STRING, {"data": "once"})
    wait_until(lambda: heard)
    time.sleep(0.1)
    assert heard == [{"data": "once"}]
    first.close()


def test_a_stop_that_fails_for_one_robot_is_still_sent_to_the_others(server, opened):
    link = opened(server)
    for robot in ("alice", "bob"):
        link.publish(f"/{robot}/cmd_vel", TWIST, {"linear": {"x": 0.2}})

    def fail():
        raise RuntimeError("no such attribute")

    link._transport._publishers["/alice/cmd_vel"].stop = fail
    assert [operation["topic"] for operation in link._transport._stops()] == ["/bob/cmd_vel"]


@contextmanager
def claimed_by_others(monkeypatch):
    def refuse(*_):
        raise LinkError("bob is in use", where="open_robot")

    with monkeypatch.context() as patch:
        patch.setattr(commanded_topics, "claim_commanded", refuse)
        yield


def test_a_server_that_falls_silent_is_sent_no_stop_for_a_robot_that_others_have_claimed(server, opened, monkeypatch):
    """Their run would have measured a stop that it had not commanded."""
    link = opened(server)
    link.publish("/alice/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    with claimed_by_others(monkeypatch), pytest.raises(LinkError, match="bob is in use"):
        link.publish("/bob/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    assert [operation["topic"] for operation in link._transport._stops()] == ["/alice/cmd_vel"]
    link.publish("/bob/cmd_vel", TWIST, {"linear": {"x": 0.2}})  # the others are done
    stopped = [operation["topic"] for operation in link._transport._stops()]
    assert stopped == ["/alice/cmd_vel", "/bob/cmd_vel"]


def test_a_server_that_falls_silent_is_not_asked_to_cancel_the_goals_of_others_who_have_the_robot(
    server, opened, monkeypatch
):
    """In ROS 1, the request of whoever had sent no goal would have cancelled those of all clients."""
    robot, link = opened(server), opened(server)
    action_type = "actionlib/Test" if link._transport.types.generation == 1 else FIBONACCI
    robot.offer_action("/bob/dig", action_type, lambda _: {})
    with claimed_by_others(monkeypatch), pytest.raises(LinkError, match="bob is in use"):
        link.send_goal("/bob/dig", action_type, timeout=PATIENCE)
    assert link._transport._stops() == []
    link.send_goal("/bob/dig", action_type, timeout=PATIENCE).result(timeout=PATIENCE)


@contextmanager
def network(server, before_each):
    """Yield the address of a proxy that calls `before_each` before it hands on what a link has sent."""
    with ExitStack() as leaving:
        listening = leaving.enter_context(socket.create_server(("127.0.0.1", 0)))
        leaving.callback(listening.shutdown, socket.SHUT_RDWR)  # wakes who accepts

        def forward(source, target, look):
            with suppress(OSError):
                while data := source.recv(1 << 16):
                    look()
                    target.sendall(data)

        def take():
            with suppress(OSError):
                while True:
                    near = leaving.enter_context(listening.accept()[0])
                    far = leaving.enter_context(socket.create_connection(("127.0.0.1", server.port)))
                    threading.Thread(target=forward, args=(near, far, before_each), daemon=True).start()
                    threading.Thread(target=forward, args=(far, near, lambda: None), daemon=True).start()

        threading.Thread(target=take, daemon=True).start()
        yield f"127.0.0.1:{listening.getsockname()[1]}"


@contextmanager
def link_behind(server, before_each, lab, *, by_tls):
    with network(server, before_each) as address:
        url = f"rosbridge+tls://{address}?ca={lab.ca}" if by_tls else f"rosbridge://{address}"
        link = open_rosbridge_link(url, SystemClock())
        try:
            yield link
        finally:
            with suppress(LinkError):
                link.close()


def slow_server(lab, *, by_tls):
    return served(lab.certificate("slow", "127.0.0.1") if by_tls else None)


@pytest.mark.parametrize("by_tls", [False, True])
def test_a_server_that_takes_nothing_is_given_up_while_a_message_is_sent(by_tls, lab, monkeypatch):
    monkeypatch.setattr(rosbridge_frames, "_SENDING", 0.5)
    goes_on = threading.Event()
    goes_on.set()
    with slow_server(lab, by_tls=by_tls) as server, link_behind(server, goes_on.wait, lab, by_tls=by_tls) as link:
        link.advertise("chatter", STRING)
        goes_on.clear()
        faults = []

        def send():
            try:
                for _ in range(40):
                    link.publish("chatter", STRING, {"data": "a" * 1_000_000})
            except LinkError as error:
                faults.append(error.problem)

        sending = threading.Thread(target=send, daemon=True)
        sending.start()
        sending.join(20.0)
        assert faults
        assert "the connection is lost" in faults[0]
    goes_on.set()


@pytest.mark.long
@pytest.mark.parametrize("by_tls", [False, True])
def test_a_stop_command_after_a_message_whose_sending_was_interrupted_is_received(by_tls, lab, monkeypatch):
    monkeypatch.setattr(rosbridge_frames, "_SENDING", PATIENCE)
    is_large, goes_on, heard = threading.Event(), threading.Event(), []

    def interrupt(*_):
        raise RunInterrupted

    def wait_in_the_midst():
        if is_large.is_set():
            is_large.clear()
            signal.pthread_kill(threading.main_thread().ident, signal.SIGUSR1)
            goes_on.wait(PATIENCE)

    with slow_server(lab, by_tls=by_tls) as server, ExitStack() as leaving:
        leaving.callback(signal.signal, signal.SIGUSR1, signal.signal(signal.SIGUSR1, interrupt))
        robot = leaving.enter_context(
            closing(open_rosbridge_link(f"{server.url}?ca={lab.ca}" if by_tls else server.url, SystemClock()))
        )
        robot.subscribe("cmd_vel", TWIST, lambda message: heard.append(message["linear"]["x"]))
        link = leaving.enter_context(link_behind(server, wait_in_the_midst, lab, by_tls=by_tls))
        link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
        link.advertise("chatter", STRING)
        is_large.set()
        with pytest.raises(RunInterrupted):
            link.publish("chatter", STRING, {"data": "a" * 30_000_000})
        goes_on.set()
        link.publish("cmd_vel", TWIST, {})
        wait_until(lambda: heard == [0.2, 0.0])


_SCRIPT = """
import atexit, os, sys
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_rosbridge_link

link = open_rosbridge_link(sys.argv[1], SystemClock())
link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
if sys.argv[2] == "fork":
    if (child := os.fork()) == 0:
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        os._exit(0)
    os.waitpid(child, 0)
atexit.register(link.close)
"""


@pytest.mark.long
@pytest.mark.parametrize("way", ["fork", "no fork"])
def test_a_script_stops_the_robot_as_its_interpreter_exits(way, server_of_ros2, opened):
    heard = []
    opened(server_of_ros2).subscribe("cmd_vel", TWIST, lambda message: heard.append(message["linear"]["x"]))
    subprocess.run([sys.executable, "-c", _SCRIPT, server_of_ros2.url, way], check=True, timeout=PATIENCE)
    wait_until(lambda: heard == ([0.2, 0.1, 0.0] if way == "fork" else [0.2, 0.0]))


@pytest.mark.long
@pytest.mark.parametrize("process", ["FORK", "IN_PROCESS"])
def test_a_link_that_a_callback_opened_by_itself_and_left_open_stops_the_robot_as_the_run_ends(
    server_of_ros2, opened, write_config, robot_runner, process
):
    heard = []
    opened(server_of_ros2).subscribe("cmd_vel", TWIST, lambda message: heard.append(message["linear"]["x"]))
    body = f"""
        run_process = RunProcess.{process}

        def launch_mission(self, context):
            self.left_open = open_robot({server_of_ros2.url!r})
            link, _ = self.left_open.__enter__()
            link.publish("cmd_vel", {TWIST!r}, {{"linear": {{"x": 0.2}}}})
    """
    head = HEAD.replace("import *", "import *\nfrom robot_runner.plugins import open_robot", 1)
    table = "    def create_run_table(self):\n        return RunTableModel([Factor('Task', ['Video'])])\n"
    answer = robot_runner(write_config(body, head=head, table=table))
    assert answer.code == 0, answer.out + answer.err
    wait_until(lambda: heard[-1:] == [0.0])
    assert heard[0] == 0.2


def test_whether_a_goal_is_taken_may_be_asked_of_the_robot(server_of_ros2, opened):
    robot, link = opened(server_of_ros2), opened(server_of_ros2)
    server_of_ros2.offer("/lamp", TRIGGER, lambda _: {"success": True})
    robot.offer_action(
        "count", FIBONACCI, lambda _: {"sequence": [1]}, accept=lambda _: robot.call("lamp", TRIGGER)["success"]
    )
    goal = link.send_goal("count", FIBONACCI, {"order": 1}, timeout=PATIENCE)
    assert goal.result(timeout=PATIENCE).has_succeeded


def test_a_goal_that_is_cancelled_before_it_was_taken_is_cancelled_once_it_is(server_of_ros2, opened):
    robot = opened(server_of_ros2)
    is_asked, may_accept, states = threading.Event(), threading.Event(), []

    def accept(_):
        is_asked.set()
        return may_accept.wait(PATIENCE)

    def execute(execution):
        with suppress(AssertionError):
            wait_until(lambda: execution.is_cancel_requested)
        states.append(execution.status)
        return {"sequence": []}

    robot.offer_action("count", FIBONACCI, execute, accept=accept)
    served = robot._transport.actions._served["/count"]
    goal = {"op": "send_action_goal", "id": "1", "action": "/count", "args": {"order": 1}}
    taking = threading.Thread(target=served.take, args=(goal,))
    taking.start()
    assert is_asked.wait(PATIENCE)
    served.take({"op": "cancel_action_goal", "id": "1", "action": "/count"})
    may_accept.set()
    wait_until(lambda: states)
    assert states == [GoalStatus.CANCELING]


def test_a_goal_that_is_none_does_not_end_the_connection(server_of_ros2, opened):
    robot = opened(server_of_ros2)
    robot.offer_action("count", FIBONACCI, lambda _: {"sequence": []})
    served = robot._transport.actions._served["/count"]
    ended = []
    served._tell_end = lambda key, result: ended.append((key, result.status))
    served.take({"op": "send_action_goal", "id": "1", "action": "/count", "args": {"no such field": 1}})
    wait_until(lambda: ended)
    assert ended == [("1", GoalStatus.ABORTED)]


def test_a_goal_whose_connection_is_left_as_it_is_given_up_is_an_error_of_the_link(server_of_ros2, opened, monkeypatch):
    robot, link = opened(server_of_ros2), opened(server_of_ros2)
    robot.offer_action("count", FIBONACCI, lambda _: {"sequence": []})
    server_of_ros2.actions.rejects["/count"] = lambda _: True
    monkeypatch.setattr(rosbridge_actions._Client, "cancel", lambda self, sent, timeout: self._leave(sent))
    with pytest.raises(LinkError, match="does not accept the goal"):
        link.send_goal("count", FIBONACCI, {"order": 1}, timeout=0.2)
