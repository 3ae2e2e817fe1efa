"""Latency along a chain of topics: against nodes that take a time which is known."""

from __future__ import annotations

import csv
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from tests.processor_wait import ProcessorWait
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.recordings import scans_of_ros2
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.play_bag import PlayBag
from robot_runner.ros.topic_latency import TopicLatency
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, ProfilerContract, make_context, rehearse

SCAN = "sensor_msgs/LaserScan"
#: A node that answers each scan after 30 ms, but for every fifth, which it drops; /late answers after 20 ms more.
NODE = """
import signal, sys, threading, time
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.connect import connect_robot
from robot_runner.testing import make_context
from pathlib import Path

context = make_context(Path(sys.argv[2]), robot=sys.argv[1], clock=SystemClock())
link, count, over = connect_robot(context), 0, threading.Event()
for topic in ("/fast", "/late"):
    link.advertise(topic, "sensor_msgs/LaserScan")

def answer(scan):
    global count
    count += 1
    if count % 5 == 0:
        return
    came = time.monotonic()
    time.sleep(0.03)
    header = {"stamp": scan["header"]["stamp"]}
    link.publish("/fast", "sensor_msgs/LaserScan", {"header": header})
    fast = time.monotonic() - came
    time.sleep(0.02)
    link.publish("/late", "sensor_msgs/LaserScan", {"header": header})
    print(fast, time.monotonic() - came, flush=True)

link.subscribe("/scan", "sensor_msgs/LaserScan", answer)
signal.signal(signal.SIGTERM, lambda *_: over.set())
print("ready", flush=True)
over.wait(60)
context.resources.close()
"""


class TestLatencyOfAnAnswer(ProfilerContract):
    def make_links(self, clock):
        robot = FakeRobotLink(clock)
        robot.known_topics |= {"scan": SCAN, "near": SCAN}

        def scan():
            stamp = {"sec": 5, "nanosec": round(clock.now() * 1e9) % 10**9}
            robot.deliver("scan", {"header": {"stamp": stamp}})
            clock.at(clock.now() + 0.02, lambda: robot.deliver("near", {"header": {"stamp": stamp}}))

        clock.every(0.1, scan)
        return FakeLinks(robot=robot)

    def make_plugin(self):
        return TopicLatency("scan", "near")


@pytest.fixture
def measure(tmp_path):
    """Measure two seconds of scans at 10 Hz, of which `answer` is told; return measures and context."""

    def execute(answer, plugin=None, types=(SCAN, SCAN)):
        clock = FakeClock(7.0)
        robot, plugin = FakeRobotLink(clock), plugin or TopicLatency("scan", "near")
        robot.known_topics |= dict(zip(("scan", "near"), types, strict=True))
        count = 0

        def scan():
            nonlocal count
            count += 1
            robot.deliver("scan", {"header": {"stamp": {"sec": 100, "nanosec": count}}})
            answer(count, lambda delay, nanosec: clock.at(clock.now() + delay, lambda: _deliver(nanosec)))

        def _deliver(nanosec):
            robot.deliver("near", {"header": {"stamp": {"sec": 100 if nanosec else 0, "nanosec": nanosec}}})

        clock.every(0.1, scan)
        context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
        return rehearse(context, plugin, mission=lambda: clock.sleep(2.05)), context

    return execute


def test_percentiles_are_those_of_the_delays_and_what_is_not_answered_is_counted(measure):
    delays = {number: 0.01 * number for number in range(1, 100)}
    measures, context = measure(lambda number, send: number % 4 and send(delays[number], number))
    causes = measures["ScanMessages"]
    known = [delays[number] for number in range(1, int(causes) + 1) if number % 4]
    assert measures["NearUnanswered"] == causes - len(known) == 5
    assert measures["NearLatency"] == pytest.approx(sum(known) / len(known))
    assert measures["NearMedianLatency"] == pytest.approx(known[(len(known) - 1) // 2])
    assert measures["NearMaxLatency"] == measures["NearP99Latency"] == pytest.approx(known[-1])
    with (context.raw_data_folder / "Near.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["latency_s"] for row in rows][2:4] == ["0.030000", ""]
    assert not context.broker.findings


def test_the_last_answers_are_awaited_and_those_that_never_come_are_not_for_long(measure):
    measures, _ = measure(lambda number, send: send(0.9, number))
    assert measures["NearUnanswered"] == 0
    assert measures["NearLatency"] == pytest.approx(0.9)
    begun = time.monotonic()
    measures, _ = measure(lambda number, send: send(1.5, number))
    assert time.monotonic() - begun < 10.0
    assert 0 < measures["NearUnanswered"] < measures["ScanMessages"]


@pytest.mark.parametrize(("every", "is_told"), [(2, True), (21, False)])
def test_answers_that_seem_to_take_no_time_are_told_where_they_are_many(measure, every, is_told):
    _, context = measure(lambda number, send: send(0.0 if number % every == 0 else 0.01, number))
    problems = " ".join(finding.problem for finding in context.broker.findings)
    assert ("10 of 20 answers were received no later than their causes" in problems) == is_told


@pytest.mark.parametrize(
    ("is_answered", "is_told"),
    [
        (lambda number: number > 6, True),  # a node that discovers the sensor late
        (lambda number: number > 6 and number % 5, True),  # the same, which drops some
        (lambda number: number > 2, False),  # a filter that begins with the third scan
        (lambda number: number % 5 == 0, False),  # a node that answers every fifth
    ],
)
def test_a_node_that_begins_to_answer_late_is_told_from_one_that_drops_messages(measure, is_answered, is_told):
    measures, context = measure(lambda number, send: send(0.01, number) if is_answered(number) else None)
    assert measures["NearUnanswered"] >= 2
    problems = " ".join(finding.problem for finding in context.broker.findings)
    assert ("none of the first 6 messages on scan has an answer" in problems) == is_told


@pytest.mark.parametrize(
    ("answer", "types", "problem"),
    [
        (lambda _, send: send(0.01, 77), (SCAN, SCAN), "has the stamp of one on scan"),
        (lambda _, send: None, (SCAN, SCAN), "nothing was published on it"),
        (lambda number, send: send(0.01, number), (SCAN, "std_msgs/String"), "std_msgs/String has no header"),
        (lambda number, send: send(0.01, number), ("std_msgs/String", SCAN), "std_msgs/String has no header"),
    ],
)
def test_what_cannot_be_matched_is_a_missing_value_with_its_reason(measure, monkeypatch, answer, types, problem):
    if "std_msgs/String" in types:
        answer = lambda *_: None  # noqa: E731 - nothing is delivered that the type could not have
    if types[0] != SCAN:
        monkeypatch.setattr(FakeRobotLink, "deliver", lambda *_: None)
    measures, context = measure(answer, types=types)
    assert measures["NearLatency"] is None
    assert any(problem in finding.problem for finding in context.broker.findings)


def test_parameters_that_cannot_be_are_refused():
    with pytest.raises(PluginError, match="no topic answers"):
        TopicLatency("/scan")
    with pytest.raises(PluginError, match="same columns"):
        TopicLatency("/scan", "scan")
    with pytest.raises(PluginError, match="timeout_s"):
        TopicLatency("/scan", "/near", timeout_s=-1)


@contextmanager
def _node(robot, folder):
    (folder / "node.py").write_text(NODE)
    words = [sys.executable, str(folder / "node.py"), robot, str(folder / "node")]
    node = subprocess.Popen(words, stdout=subprocess.PIPE, env=dict(os.environ))
    try:
        assert node.stdout.readline() == b"ready\n"
        yield node
    finally:
        node.send_signal(signal.SIGTERM)
        try:
            node.wait(20)
        except subprocess.TimeoutExpired:
            node.kill()
            node.wait()
        node.stdout.close()


def _times(told):
    """Return how long the node itself took for each of 32 answers, s: until the fast one and until the late one."""
    return [map(float, told.readline().split()) for _ in range(32)]


def _least(samples):
    cells = (line.split(",")[1] for line in samples.read_text().splitlines()[1:])
    return min(float(cell) for cell in cells if cell)  # those that were not answered have none


def _check_delays(robot, folder):
    """Play 40 scans at 20 Hz to a node that is another process, and compare with what it is known to take."""
    plugins = PlayBag(scans_of_ros2(folder / "hall", count=40), rate=0.8), TopicLatency("/scan", "/fast", "/late")
    with _node(robot, folder) as node:
        context = make_context(folder, *plugins, robot=robot, clock=SystemClock())
        wait = ProcessorWait([os.getpid(), node.pid])
        try:
            measures = rehearse(context, *plugins)
        finally:
            context.resources.close()
        wait.look()
        fast, late = (list(each) for each in zip(*_times(node.stdout), strict=True))
    assert measures["ScanMessages"] == 40
    assert measures["FastUnanswered"] == measures["LateUnanswered"] == 8
    # A busy machine lets the node sleep longer than it asked for, and messages wait: both take long, and none is early.
    assert 0.029 < measures["FastMedianLatency"] < statistics.median(fast) + 0.25
    assert 0.049 < measures["LateMedianLatency"] < statistics.median(late) + 0.25
    assert measures["FastMedianLatency"] < measures["LateMedianLatency"]
    # The quickest answers wait for no machine, unless all do; a scan may come here later than to the node, so they may
    # seem quicker.
    least = [_least(context.run_path / "TopicLatency" / name) for name in ("Fast.csv", "Late.csv")]
    assert least[0] < min(fast) + 0.02 + wait.seconds
    assert least[1] < min(late) + 0.02 + wait.seconds
    assert measures["FastMedianLatency"] <= measures["FastP95Latency"] <= measures["FastP99Latency"]
    assert (
        json.loads((context.run_path / "TopicLatency" / "quality.json").read_text())["topics"]["/fast"]["messages"]
        == 32
    )


@pytest.mark.long
def test_the_latency_of_a_node_with_a_known_delay_over_dds(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    _check_delays(f"dds:domain={claim_domain()},distro=jazzy", tmp_path)


@pytest.mark.long
@quiet_about_rospy
def test_the_latency_of_a_node_with_a_known_delay_over_ros_1(tmp_path, master_uri):
    _check_delays(f"ros1:master={master_uri}", tmp_path)
