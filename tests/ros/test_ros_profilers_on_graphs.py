"""The profilers of a graph on real ones: DDS on loopback, and a ROS 1 master."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import quiet_about_rospy, ros1_environment
from tests.waiting import wait_until

from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Qos
from robot_runner.ros.link_opening import open_dds_link, open_ros1_link
from robot_runner.ros.recorded_bag import RecordedBag
from robot_runner.ros.ros_bag import RosBag
from robot_runner.ros.ros_graph import RosGraph
from robot_runner.ros.ros_topics import RosTopics
from robot_runner.testing import make_context, rehearse

RATE = 50.0
SECONDS = 2.0


@contextmanager
def _odometry(link):
    """Have odometry published at 50 Hz by a thread; yield when each message was published."""
    is_over = threading.Event()
    published = []

    def publish():
        begun, number = time.monotonic(), 0
        while not is_over.wait(max(0.0, begun + number / RATE - time.monotonic())):
            now = time.time_ns()
            stamp = {"sec": now // 10**9, "nanosec": now % 10**9}
            link.publish("odom", "nav_msgs/Odometry", {"header": {"stamp": stamp, "frame_id": "odom"}})
            published.append(time.monotonic())
            number += 1

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield published
    finally:
        is_over.set()
        thread.join(60.0)
        link.close()


def _measured(tmp_path, robot, speaker, *plugins):
    """Return the measures, the context, and when each message was published, s."""
    context = make_context(tmp_path, *plugins, robot=robot, clock=SystemClock())
    with _odometry(speaker) as published:
        try:
            measures = rehearse(context, *plugins, mission=lambda: time.sleep(SECONDS))
        finally:
            context.resources.close()
    return measures, context, published


def _check(measures, context, published):
    (bag,) = [path for path in (context.run_path / "RosBag").iterdir() if path.suffix in {".bag", ".mcap"}]
    with AnyReader([bag], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        (connection,) = reader.connections
        assert connection.topic == "/odom"
        if bag.suffix == ".mcap":  # a graph of ROS 2 tells how its publishers offer what they publish
            assert [each.reliability.name for each in connection.ext.offered_qos_profiles] == ["RELIABLE"]
        stamps = [
            (stamp, reader.deserialize(data, connection.msgtype).header.stamp) for _, stamp, data in reader.messages()
        ]
    assert len(stamps) == measures["BagMessages"]
    lags = [(received - stamp.sec * 10**9 - stamp.nanosec) / 1e9 for received, stamp in stamps]
    assert min(lags) >= 0.0
    # A busy machine publishes late and in bursts, and hands messages over late: whatever was published within the
    # mission, less the longest of these delays, was received in it, and nothing that was published before that.
    window, lag = context.window, max(lags) + 0.01
    least = sum(window.start < time < window.end - lag for time in published)
    most = sum(window.start - lag < time < window.end for time in published)
    assert least - 1 <= measures["OdomRate"] * window.duration <= most + 1
    assert measures["OdomBandwidth"] == pytest.approx(measures["OdomRate"] * 720, rel=0.2)
    assert 0.0 < measures["OdomAge"] <= lag
    assert least <= measures["BagMessages"] <= len(published)
    assert measures["Nodes"] >= 1


@pytest.mark.long
def test_topics_bag_and_graph_over_dds(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    options = {"domain": str(claim_domain()), "distro": "jazzy"}
    robot = "dds:" + ",".join(f"{name}={value}" for name, value in options.items())
    speaker = open_dds_link(options, SystemClock())
    plugins = RosTopics({"odom": RATE}, losses=True), RosBag(["odom"], by="link"), RosGraph()
    measures, context, published = _measured(tmp_path, robot, speaker, *plugins)
    _check(measures, context, published)
    assert measures["OdomDropped"] is None  # and not 0: nothing in DDS tells it
    assert any("nothing numbers the messages" in each.problem for each in context.broker.findings)
    graph = json.loads((context.run_path / "RosGraph" / "graph.json").read_text())
    assert graph["stop"]["topics"] == {"/odom": "nav_msgs/Odometry"}


@pytest.mark.long
@quiet_about_rospy
@pytest.mark.skipif(shutil.which("rosbag") is None, reason="rosbag is not installed")
def test_a_bag_of_ros_own_recorder_has_the_mission_from_its_beginning_or_says_what_it_lacks(tmp_path, master_uri):
    speaker = open_ros1_link({"master": master_uri}, SystemClock(), "")
    speaker.publish("odom", "nav_msgs/Odometry", {})
    plugin = RosBag(["odom"], by="program")
    _, context, _ = _measured(tmp_path, f"ros1:master={master_uri}", speaker, plugin)
    with AnyReader([context.run_path / "RosBag" / "bag.bag"]) as reader:
        first = next(stamp for _, stamp, _ in reader.messages())
    late = (first - plugin._measured_from_ns) * 1e-9 - 1 / RATE
    told = [each.problem for each in context.broker.findings if "begins" in each.problem]
    assert late <= 0.02 or told


@quiet_about_rospy
def test_topics_bag_and_graph_over_ros_1(tmp_path, master_uri):
    import rospy

    speaker = open_ros1_link({"master": master_uri}, SystemClock(), "")
    speaker.publish("odom", "nav_msgs/Odometry", {})
    node = rospy.get_name()  # others may still be on the graph
    plugins = RosTopics({"odom": RATE}, losses=True), RosBag(["odom"], by="link"), RosGraph([node], rate_hz=20.0)
    measures, context, published = _measured(tmp_path, f"ros1:master={master_uri}", speaker, *plugins)
    _check(measures, context, published)
    assert measures["OdomDropped"] == 0
    label = node.strip("/").replace("/", "_")
    assert measures[f"CPU_{label}"] > 0.0  # the process of this test, found by the number that the node tells


@pytest.mark.long
@quiet_about_rospy
def test_what_a_publisher_of_ros_1_keeps_for_late_comers_is_in_the_bag_as_kept(tmp_path, master_uri):
    speaker = open_ros1_link({"master": master_uri}, SystemClock(), "/kept")
    speaker.publish("map_name", "std_msgs/String", {"data": "hall"}, qos=Qos.TRANSIENT_LOCAL)
    speaker.publish("said", "std_msgs/String", {"data": "before the mission"})
    plugin = RosBag(["map_name", "said"], by="link", namespace="/kept")
    context = make_context(tmp_path, plugin, robot=f"ros1:master={master_uri}", clock=SystemClock())
    said = []

    def mission():
        speaker.subscribe("said", "std_msgs/String", said.append)  # it is called once the plugin has the message
        speaker.publish("said", "std_msgs/String", {"data": "in it"})
        wait_until(lambda: said)

    with closing(context.resources), closing(speaker):
        rehearse(context, plugin, mission=mission)
    with RecordedBag(context.run_path / "RosBag") as bag:
        found = {topic.name: (topic.count, topic.qos) for topic in bag.chosen(None)}
    assert found == {"/kept/map_name": (1, Qos.TRANSIENT_LOCAL), "/kept/said": (1, Qos.DEFAULT)}


PUBLISHER = """
import sys, time, rospy
from rospy.impl.tcpros_base import TCPROSTransport
from sensor_msgs.msg import Image

def send_slowly(self, data, send=TCPROSTransport.write_data):
    time.sleep(0.05 if len(data) > 1_000_000 else 0.0)  # 100 MB/s, as of a busy gigabit link
    return send(self, data)

TCPROSTransport.write_data = send_slowly
rospy.init_node("camera", disable_signals=True)
publisher = rospy.Publisher("/image", Image, queue_size=200)
publisher.publish(Image())
sys.stdin.readline()
image = Image(data=bytes(5_000_000))
for _ in range(100):
    image.header.stamp = rospy.Time.from_sec(time.time())
    publisher.publish(image)
    time.sleep(0.002)
print("published", flush=True)
sys.stdin.readline()
"""


@pytest.mark.long
@quiet_about_rospy
def test_large_messages_that_had_not_arrived_by_the_window_s_end_are_no_0_losses(tmp_path, master_uri):
    environment = os.environ | ros1_environment(master_uri, tmp_path)
    camera = subprocess.Popen(
        [sys.executable, "-c", PUBLISHER], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    plugin = RosTopics(["image"], losses=True, patience=60.0)
    context = make_context(tmp_path, plugin, robot=f"ros1:master={master_uri}", clock=SystemClock())

    def mission():
        camera.stdin.write("go\n")
        camera.stdin.flush()
        camera.stdout.readline()

    try:
        measures = rehearse(context, plugin, mission=mission)
    finally:
        context.resources.close()
        camera.kill()
        camera.communicate()
    arrived = measures["ImageRate"] * context.window.duration
    assert arrived < 80
    assert measures["ImageDropped"] is None
    (doubt,) = context.broker.findings
    assert "more were due when the window ended: it is not known whether they were lost" in doubt.problem
