"""The nodes for ROS 1 on a real master, as processes of the system's own Python."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from tests.processor_wait import ProcessorWait, family
from tests.ros.ros1_master import RUDE, needs_ros1, ros1_environment

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_ros1_link

ROBOT = Path(__file__).parents[3] / "robot"
SOURCES = [ROBOT / "robot_runner_onboard" / "src", ROBOT / "robot_runner_ros1" / "src"]
SYSTEM_PYTHON = "/usr/bin/python3"
TRIGGER = "std_srvs/Trigger"
TWIST = "geometry_msgs/Twist"
#: A 1 x 1 picture, as a camera's node would send it compressed.
JPEG = bytes.fromhex("ffd8ffe000104a46494600010100000100010000ffd9")

pytestmark = [needs_ros1, *map(pytest.mark.filterwarnings, RUDE)]


class _Pages(BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.answered += 1
        self.send_response(200)
        self.send_header("Content-Length", "4")
        self.end_headers()
        self.wfile.write(b"page")

    def log_message(self, *_): ...


@pytest.fixture(scope="module")
def pages():
    server = HTTPServer(("127.0.0.1", 0), _Pages)
    server.answered = 0
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


@contextmanager
def node(name, environment, *arguments, python=SYSTEM_PYTHON):
    script = str(ROBOT / "robot_runner_ros1" / "nodes" / name)
    variables = {**environment, "PYTHONPATH": os.pathsep.join(map(str, SOURCES)), "no_proxy": "127.0.0.1"}
    process = subprocess.Popen([python, script, *arguments], env={**os.environ, **variables}, text=True)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    assert process.returncode == 0


@pytest.fixture(scope="module")
def robot(tmp_path_factory, master_uri, pages):
    """The nodes of a robot in the namespace /alice, and one more in /bob that records the camera's topic."""
    folder = tmp_path_factory.mktemp("robot")
    environment = ros1_environment(master_uri, folder)
    address = f"_network/address:=http://127.0.0.1:{pages.server_port}/"
    picture = ["_video/width:=320", "_video/height:=240", "_video/rate:=50.0"]
    with ExitStack() as nodes:
        alice = ["__ns:=/alice", address, f"_video/file:={folder}/alice.avi", "_video/source:=synthetic", *picture]
        # Where OpenCV is: that of the tests, which sees the system's rospy.
        nodes.enter_context(node("task_node", environment, *alice, python=sys.executable))
        nodes.enter_context(node("watchdog_node", environment, "__ns:=/alice"))
        bob = ["__ns:=/bob", f"_video/file:={folder}/bob.avi", "_video/source:=topic", "_video/topic:=/camera"]
        nodes.enter_context(node("task_node", environment, *bob))
        yield folder


@pytest.fixture(scope="module")
def alice(robot, master_uri):
    link = open_ros1_link({"master": master_uri}, SystemClock(), "/alice")
    last = {"/alice/robot_runner/watchdog/release", "/alice/task/network/stop", "/bob/task/network/stop"}
    until(lambda: last <= set(link.services()))
    yield link
    link.close()


@pytest.fixture(scope="module")
def bob(alice, master_uri):
    link = open_ros1_link({"master": master_uri}, SystemClock(), "/bob")
    yield link
    link.close()


def until(holds, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def call(link, service):
    response = link.call(service, TRIGGER)
    return response["success"], response["message"]


def test_the_computation_is_started_and_stopped(alice):
    assert call(alice, "task/computation/start") == (True, "computation started")
    assert call(alice, "task/network/start") == (False, "computation is running already")
    success, message = call(alice, "task/computation/stop")
    assert success
    assert message.endswith("numbers of Fibonacci")
    assert call(alice, "task/computation/stop") == (False, "computation is not running")
    assert call(alice, "task/stop") == (True, "nothing was running")


def test_the_network_task_fetches_pages(alice, pages):
    before = pages.answered
    assert call(alice, "task/network/start")[0]
    until(lambda: pages.answered > before + 5)
    success, message = call(alice, "task/network/stop")
    assert success
    assert " requests, 0 failed, " in message


def test_an_address_that_was_not_set_is_told(bob):
    success, message = call(bob, "task/network/start")
    assert not success
    assert message.startswith("network cannot be started: network/address is ''")


def test_a_synthetic_camera_is_recorded(alice, robot):
    cv2 = pytest.importorskip("cv2")
    assert call(alice, "task/video/start") == (True, "video started")
    success, message = call(alice, "task/stop")
    assert success
    assert " frames, 320x240, " in message
    assert message.endswith(f"{robot}/alice.avi")
    assert cv2.VideoCapture(str(robot / "alice.avi")).read()[1].shape == (240, 320, 3)


def test_a_camera_topic_that_nobody_publishes_is_told(bob):
    success, message = call(bob, "task/video/start")
    assert not success
    assert "no node publishes /camera: start the camera's node, or set video/topic" in message


@pytest.fixture
def camera(master_uri):
    """A camera's node: it is gone after the test, or there would be one for all tests that come later."""
    link = open_ros1_link({"master": master_uri}, SystemClock(), "/bob")
    yield link
    link.close()


def test_the_topic_of_a_camera_is_recorded_without_opencv(bob, camera, robot):
    is_over = threading.Event()

    def film():
        while not is_over.wait(0.05):
            camera.publish("/camera", "sensor_msgs/CompressedImage", {"format": "jpeg", "data": JPEG})

    filming = threading.Thread(target=film)
    filming.start()
    try:
        assert call(bob, "task/video/start") == (True, "video started")
        success, message = call(bob, "task/video/stop")
    finally:
        is_over.set()
        filming.join()
    assert success
    assert "frames, JPEG, " in message
    data = (robot / "bob.mjpeg").read_bytes()
    assert data == JPEG * (len(data) // len(JPEG))
    assert data


def falls_silent(messages, seconds):
    """Whether none comes for so long, before 60 s have passed."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        count = len(messages)
        time.sleep(seconds)
        if len(messages) == count:
            return True
    return False


def test_the_watchdog_stops_a_robot_whose_run_falls_silent(alice):
    commands = []
    listening = alice.subscribe("cmd_vel", TWIST, lambda message: commands.append((time.monotonic(), message)))
    beats, wait = [], ProcessorWait(family())
    for count in range(1, 6):
        beats.append(time.monotonic())
        alice.publish("robot_runner/heartbeat", "std_msgs/UInt32", {"data": count})
        alice.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
        time.sleep(0.1)
    until(lambda: len(commands) > 7 and not commands[-1][1]["linear"]["x"])
    stops = [moment for moment, message in commands if not message["linear"]["x"]]
    stopped = next(moment for moment in stops if moment > beats[-1])
    wait.look()
    assert stopped - beats[-1] < 0.7 + wait.seconds
    # It never stops a robot whose run is heard; where the run itself had to wait for a processor it fell silent.
    assert all(moment - max(beat for beat in beats if beat < moment) > 0.3 - wait.seconds for moment in stops)
    alice.publish("robot_runner/heartbeat", "std_msgs/UInt32", {"data": 6})
    alice.publish("robot_runner/heartbeat", "std_msgs/UInt32", {"data": 0})
    assert falls_silent(commands, 0.6)  # after the farewell the robot is others'
    listening.close()


def test_a_person_can_release_a_robot_that_the_watchdog_holds(alice):
    commands = []
    listening = alice.subscribe("cmd_vel", TWIST, commands.append)
    alice.publish("robot_runner/heartbeat", "std_msgs/UInt32", {"data": 1})
    until(lambda: commands)
    assert call(alice, "robot_runner/watchdog/release")[0]
    assert falls_silent(commands, 0.3)
    listening.close()


@pytest.mark.long
def test_a_node_that_is_ended_ends_its_task(master_uri, tmp_path, alice):
    environment = ros1_environment(master_uri, tmp_path)
    carol = open_ros1_link({"master": master_uri}, SystemClock(), "/carol")
    with node("task_node", environment, "__ns:=/carol") as process:
        until(lambda: "/carol/task/network/stop" in carol.services())
        assert call(carol, "task/computation/start")[0]
        workers = children(process.pid)
        assert workers
        process.send_signal(signal.SIGINT)
        process.wait(60)
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    carol.close()


def children(pid):
    return [int(entry.name) for entry in Path("/proc").glob("[0-9]*") if _stat(entry).split()[1:2] == [str(pid)]]


def _stat(entry):
    try:
        return (entry / "stat").read_text().rpartition(")")[2]
    except OSError:
        return ""
