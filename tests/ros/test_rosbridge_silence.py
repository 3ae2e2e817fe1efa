"""A rosbridge that answers no more, and closes nothing: its network is cut, in one direction or both, or it hangs."""

from __future__ import annotations

import select
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing, contextmanager, suppress

import pytest
from tests.waiting import PATIENCE

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.goals import ActionCanceled
from robot_runner.ros import rosbridge_session
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.ros.rosbridge_session import Session
from robot_runner.testing import RosbridgeServer


@contextmanager
def answers_lost(server):
    """Yield the address of a proxy of the server, and what makes it forward no answer any more, only what is sent."""
    are_lost = threading.Event()

    def forward(source, target, way):
        with suppress(OSError):
            while data := source.recv(1 << 16):
                if not (way == "answers" and are_lost.is_set()):
                    target.sendall(data)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def take():
        with suppress(OSError):
            while True:
                near = opened.enter_context(listening.accept()[0])
                far = opened.enter_context(socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2]))))
                for each in ((near, far, "requests"), (far, near, "answers")):
                    threading.Thread(target=forward, args=each, daemon=True).start()

    with ExitStack() as opened, socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=take, daemon=True).start()
        yield f"rosbridge://127.0.0.1:{listening.getsockname()[1]}", are_lost


def until(claim):
    deadline = time.monotonic() + 60.0
    while not claim():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_robot_of_which_nothing_is_heard_any_more_is_told_to_stand_still_as_it_may_hear_us(monkeypatch):
    monkeypatch.setattr(rosbridge_session, "_PING_INTERVAL", 0.05)
    monkeypatch.setattr(rosbridge_session, "_PING_TIMEOUT", 60.0)
    heard = []
    with (
        closing(RosbridgeServer()) as server,
        answers_lost(server) as (url, are_lost),
        closing(open_rosbridge_link(server.url, SystemClock())) as robot,
        ExitStack() as leaving,
    ):
        answered = threading.Event()
        answered.set()
        monkeypatch.setattr(robot._transport._session._connection, "ping", lambda: answered)  # it is not impatient
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda message: heard.append(message["linear"]["x"]))
        link = open_rosbridge_link(url, SystemClock())
        leaving.push(lambda *_: True)  # that the robot could not be told to stand still
        leaving.callback(link.close)
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        until(lambda: heard == [0.2])
        are_lost.set()
        monkeypatch.setattr(rosbridge_session, "_PING_TIMEOUT", 0.1)
        until(lambda: heard == [0.2, 0.0])
        until(lambda: not link._transport._session.is_usable)
        with pytest.raises(LinkError, match="the robot does not answer any more"):
            link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
    assert heard == [0.2, 0.0]


@pytest.mark.parametrize("generation", [1, 2])
def test_a_goal_of_a_robot_of_which_nothing_is_heard_any_more_is_cancelled_as_it_may_hear_us(monkeypatch, generation):
    action_type = "actionlib/Test" if generation == 1 else "example_interfaces/Fibonacci"
    monkeypatch.setattr(rosbridge_session, "_PING_INTERVAL", 0.05)
    monkeypatch.setattr(rosbridge_session, "_PING_TIMEOUT", 60.0)
    is_cancelled, is_over = threading.Event(), threading.Event()

    def dig(execution):
        while not execution.is_cancel_requested and not is_over.wait(0.01):
            pass
        if execution.is_cancel_requested and not is_over.is_set():
            is_cancelled.set()
        raise ActionCanceled

    with (
        closing(RosbridgeServer(generation=generation)) as server,
        answers_lost(server) as (url, are_lost),
        closing(open_rosbridge_link(server.url, SystemClock())) as robot,
        ExitStack() as leaving,
    ):
        robot.offer_action("dig", action_type, dig)
        link = open_rosbridge_link(url, SystemClock())
        leaving.push(lambda *_: True)  # that the goal could not be cancelled
        leaving.callback(link.close)
        link.send_goal("dig", action_type, {})
        own, answered = link._transport._session, Session._is_answered
        # The robot's connection is not impatient, and neither is that of the goal, in ROS 2.
        monkeypatch.setattr(Session, "_is_answered", lambda each, pong: each is not own or answered(each, pong))
        are_lost.set()
        monkeypatch.setattr(rosbridge_session, "_PING_TIMEOUT", 0.1)
        is_cancelled.wait(PATIENCE)
        is_over.set()  # closing the links asks for the end, too
    assert is_cancelled.is_set()


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="a socket option of Linux")
def test_what_a_process_sent_before_it_was_killed_does_not_reach_the_robot_long_after_it_was_stopped(monkeypatch):
    def seconds():
        option = socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT
        return link._transport._session._connection.socket.getsockopt(*option) / 1000

    told = []
    with closing(RosbridgeServer()) as server, closing(open_rosbridge_link(server.url, SystemClock())) as link:
        # Less than it takes to repeat a lost packet once more after whoever stops the robot instead is done.
        assert rosbridge_session._PING_INTERVAL + rosbridge_session._PING_TIMEOUT < seconds() < 12.0
        monkeypatch.setattr(link._transport._session, "stop_operations", lambda: told.append(seconds()) or ())
        link._transport._session._give_up()
    assert told == [0.0], "but the stop command of a run that goes on does, however late"


#: What a process sends that has not arrived when the process ends.
TALKATIVE = """
import os, sys
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_rosbridge_link
link = open_rosbridge_link(sys.argv[1], SystemClock())
link.publish("/lamp", "std_msgs/String", {"data": ""})
print("ready", flush=True)
sys.stdin.readline()
for _ in range(5):
    link.publish("/lamp", "std_msgs/String", {"data": 8000 * "x"})
print("sent", flush=True)
sys.stdin.readline()
"""


@contextmanager
def requests_held(server):
    """Yield the address of a proxy of the server, what makes it take nothing more, and what then tells all that came.

    What is sent lies in the system of the sender then, as where the network is cut.
    """
    is_held, is_over, rest = threading.Event(), threading.Event(), []

    def forward(source, target, *, may_hold):
        with suppress(OSError):
            while not (may_hold and is_held.is_set()):
                if select.select([source], [], [], 0.01)[0]:
                    if may_hold and is_held.is_set():
                        break
                    if not (data := source.recv(1 << 12)):
                        return
                    target.sendall(data)
            is_over.wait()
            while data := source.recv(1 << 12):
                rest.append(data)

    def take():
        near = opened.enter_context(listening.accept()[0])
        far = opened.enter_context(socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2]))))
        threading.Thread(target=forward, args=(far, near), kwargs={"may_hold": False}, daemon=True).start()
        forward(near, far, may_hold=True)

    def received():
        is_over.set()
        taking.join(60.0)
        return b"".join(rest)

    with ExitStack() as opened, socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # and so has what it accepts
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        taking = threading.Thread(target=take, daemon=True)
        taking.start()
        yield f"rosbridge://127.0.0.1:{listening.getsockname()[1]}", is_held.set, received


@pytest.mark.long
@pytest.mark.parametrize("is_killed", [True, False], ids=["killed", "ended"])
def test_what_a_process_sent_and_the_network_has_not_delivered_dies_with_it_where_it_is_killed_alone(is_killed):
    """A robot that was told to stand still meanwhile would drive again."""
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with closing(RosbridgeServer()) as server, requests_held(server) as (url, hold, received):
        with subprocess.Popen([sys.executable, "-c", TALKATIVE, url], **piped) as process:
            try:
                assert process.stdout.readline() == "ready\n"
                hold()
                print(file=process.stdin, flush=True)
                assert process.stdout.readline() == "sent\n"
                if is_killed:
                    process.kill()
                else:
                    print(file=process.stdin, flush=True)
                process.wait(60.0)
            finally:
                process.kill()
        arrived = len(received())
    everything = 5 * 8000
    assert arrived < everything / 2 if is_killed else arrived > everything
