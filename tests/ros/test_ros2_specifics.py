"""What is particular to rclpy: late publishers, kinds of field, callbacks that call. Executed where ROS 2 is there."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.commanded_topics import keep_commanding_zero
from robot_runner.core.links.goal_cancelling import cancel_all_goals
from robot_runner.core.links.robot import Qos
from robot_runner.ros.link_opening import open_dds_link, open_ros2_link
from robot_runner.testing.action_contract import faults_told

pytestmark = pytest.mark.ros2

DOMAIN = str(1 + os.getpid() % 100)
SCAN = "sensor_msgs/LaserScan"
TRIGGER = "std_srvs/Trigger"


@pytest.fixture(autouse=True)
def on_loopback(monkeypatch):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def link():
    with closing(open_ros2_link({"domain": DOMAIN}, SystemClock())) as opened:
        yield opened


def until(claim, do=lambda: None):
    deadline = time.monotonic() + 60.0
    while not claim():
        assert time.monotonic() < deadline
        do()
        time.sleep(0.02)


def test_a_subscription_fits_a_publisher_that_comes_later(link):
    heard = []
    link.subscribe("scan", SCAN, heard.append)
    until(lambda: heard, lambda: link.publish("scan", SCAN, {"angle_max": 1.0}, qos=Qos.SENSOR_DATA))
    assert heard[0]["angle_max"] == 1.0


def test_qos_that_is_not_offered_is_named(link):
    link.publish("scan", SCAN, {}, qos=Qos.SENSOR_DATA)
    until(lambda: "/scan" in link.topics())
    with pytest.raises(LinkError, match="reliability: it is published best effort, and subscribed reliable"):
        link.subscribe("scan", SCAN, print, qos=Qos.RELIABLE)
    link.publish("map_name", "std_msgs/String", {})
    until(lambda: "/map_name" in link.topics())
    with pytest.raises(LinkError, match="durability"):
        link.subscribe("map_name", "std_msgs/String", print, qos=Qos.TRANSIENT_LOCAL)


def test_every_kind_of_field_arrives(link):
    sent = {
        "std_msgs/ByteMultiArray": {"data": b"\x00\xff"},
        "std_msgs/Byte": {"data": 200},
        "std_msgs/Int64MultiArray": {"data": [-(2**63), 2**63 - 1]},
        "std_msgs/Bool": {"data": True},
        "std_msgs/Char": {"data": 65},
        "sensor_msgs/JointState": {"name": ["a", "é"], "position": [0.5]},
        "geometry_msgs/PoseWithCovariance": {"covariance": [float(number) for number in range(36)]},
    }
    for message_type, message in sent.items():
        topic, heard = message_type.replace("/", "_"), []
        link.subscribe(topic, message_type, heard.append)
        until(lambda heard=heard: heard, lambda a=topic, b=message_type, c=message: link.publish(a, b, c))
        assert {name: heard[0][name] for name in message} == message


def test_a_field_that_is_left_out_holds_its_default(link):
    heard = []
    link.subscribe("turn", "geometry_msgs/Quaternion", heard.append)
    until(lambda: heard, lambda: link.publish("turn", "geometry_msgs/Quaternion", {}))
    assert heard[0] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def test_an_array_of_messages_with_default_arrays_arrives(link):
    heard = []
    link.subscribe("nested", "test_msgs/MultiNested", heard.append)
    sent = {"unbounded_sequence_of_arrays": [{"bool_values": [True, False, True]}]}
    until(lambda: heard, lambda: link.publish("nested", "test_msgs/MultiNested", sent))
    (arrays,) = heard[0]["unbounded_sequence_of_arrays"]
    assert arrays["bool_values"] == [True, False, True]
    assert arrays["int32_values_default"] == [0, 2**31 - 1, -(2**31)]


def test_another_version_of_a_type_is_refused_as_its_values_would_be_taken_for_others(link, tmp_path):
    (tmp_path / "test_msgs" / "msg").mkdir(parents=True)
    text = Path(sys.prefix, "share", "test_msgs", "msg", "Builtins.msg").read_text()
    first, second = (line for line in text.splitlines() if line and not line.startswith("#"))
    (tmp_path / "test_msgs" / "msg" / "Builtins.msg").write_text(f"{second}\n{first}\n")
    options = {"domain": DOMAIN, "distro": "jazzy", "types": str(tmp_path)}
    with closing(open_dds_link(options, SystemClock())) as other:
        other.advertise("times", "test_msgs/Builtins")
        until(lambda: "/times" in link.topics())
        for use in (partial(link.subscribe, callback=print), link.advertise):
            with pytest.raises(LinkError, match="another version of test_msgs/Builtins than"):
                use("times", "test_msgs/Builtins")
        until(lambda: len(link.publishers("times")) == 1)  # rmw tells a moment later that ours is gone


def test_a_callback_may_call_a_service(link):
    link.offer("lamp", TRIGGER, lambda _: {"success": True, "message": "on"})
    answers = []
    link.subscribe("chatter", "std_msgs/String", lambda _: answers.append(link.call("lamp", TRIGGER)))
    until(lambda: answers, lambda: link.publish("chatter", "std_msgs/String", {}))
    assert answers[0]["message"] == "on"


def test_a_process_is_one_node_whatever_the_number_of_robots_and_a_hidden_one_until_it_opens_something(link):
    with closing(open_ros2_link({"domain": DOMAIN}, SystemClock(), "/alice")) as alice:
        assert alice.nodes() == []
        alice.publish("chatter", "std_msgs/String", {"data": "hello"})
        link.publish("chatter", "std_msgs/String", {"data": "hello"})
        until(link.nodes)
        assert len(link.nodes()) == 1
        assert alice.nodes() == link.nodes()


def test_nothing_is_left_behind(link):
    before = threading.active_count()
    simulated = SimpleNamespace(now=lambda: 0.0, sleep=lambda _: None, is_simulated=True)
    with closing(open_ros2_link({"domain": DOMAIN}, simulated)) as other:
        assert other.is_simulated
        other.offer("lamp", TRIGGER, lambda _: {})
    assert threading.active_count() <= before


@pytest.mark.parametrize(("limit", "told_of"), [("_MOST_WAITING", "5 messages of 0 MiB"), ("_MOST_WAITING_BYTES", "")])
def test_callbacks_that_take_less_than_comes_fail_the_run_once_and_do_not_fill_the_memory(
    link, monkeypatch, limit, told_of
):
    from robot_runner.ros import ros2_node

    monkeypatch.setattr(ros2_node, limit, 5 if told_of else 300)
    released, taken = threading.Event(), []

    def take(scan):
        taken.append(scan)
        released.wait(60.0)

    with faults_told() as told:
        link.subscribe("scan", SCAN, take)
        until(lambda: told, lambda: link.publish("scan", SCAN, {}))
        for _ in range(5):
            link.publish("scan", SCAN, {})
        released.set()
        until(lambda: len(taken) > 1)
    assert len(told) == 1
    assert f"callbacks are too slow: {told_of}" in told[0]


def test_a_robot_is_stopped_that_is_discovered_later_than_a_subscriber_that_asks_for_more(link):
    from geometry_msgs.msg import Twist
    from rclpy import Context, create_node
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import DurabilityPolicy, QoSProfile

    context = Context()
    context.init(domain_id=int(DOMAIN))
    base, heard = create_node("base", context=context), []
    base.create_subscription(Twist, "cmd_vel", print, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    until(lambda: link.subscribers("cmd_vel"))
    link.publish("cmd_vel", "geometry_msgs/Twist", {})  # which nobody can receive yet
    base.create_subscription(Twist, "cmd_vel", heard.append, 1)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(base)
    until(lambda: heard, lambda: (link.publish("cmd_vel", "geometry_msgs/Twist", {}), executor.spin_once(0.05)))
    executor.shutdown()
    base.destroy_node()
    context.shutdown()


@pytest.mark.parametrize(
    ("asked", "problem"),
    [
        ({"durability": "TRANSIENT_LOCAL"}, "durability: it is published volatile, and subscribed transient local"),
        ({"deadline": 0.5}, "deadline: messages are to be at most 0.5 s apart, which is not promised"),
        ({"liveliness_lease_duration": 1.0}, "liveliness: the publisher is to keep telling that it is alive"),
        ({"liveliness": "MANUAL_BY_TOPIC"}, "liveliness: the publisher is to keep telling that it is alive"),
    ],
)
def test_a_subscriber_that_asks_for_more_than_is_published_is_an_error_before_and_after_it_is_advertised(
    link, asked, problem
):
    from geometry_msgs.msg import Twist
    from rclpy import Context, create_node
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile

    kinds = {"durability": DurabilityPolicy, "liveliness": LivelinessPolicy}
    policies = {
        name: getattr(kinds[name], value) if name in kinds else Duration(seconds=value) for name, value in asked.items()
    }
    context = Context()
    context.init(domain_id=int(DOMAIN))
    base = create_node("base", context=context)
    link.advertise("late", "geometry_msgs/Twist")
    for topic in ("early", "late"):
        link.subscribe(topic, "geometry_msgs/Twist", print)  # as who watches for rivals does
        base.create_subscription(Twist, topic, print, QoSProfile(depth=1, **policies))
        until(lambda topic=topic: any(not each.is_own for each in link.subscribers(topic)))
        with pytest.raises(LinkError, match=problem) as caught:
            link.advertise(topic, "geometry_msgs/Twist")
        assert caught.value.where == f"/{topic}"
    base.destroy_node()
    context.shutdown()


def test_a_publisher_that_misfits_while_a_subscription_is_made_is_adapted_to(link, monkeypatch):
    from robot_runner.ros import ros2_transport

    creates, made = ros2_transport._Subscription._created, []

    def created(subscription, asked):
        made.append(creates(subscription, asked))
        if len(made) == 1:
            subscription._note_mismatch(None)  # as the node's thread does, before the subscription is known here
            time.sleep(0.2)
        return made[-1]

    monkeypatch.setattr(ros2_transport._Subscription, "_created", created)
    subscription = link.subscribe("scan", SCAN, print)
    until(lambda: len(made) > 1 and subscription.inner._subscription is made[-1])


def test_a_command_that_is_not_taken_is_told_and_one_of_which_that_is_not_known_is_not(link, monkeypatch):
    outcomes = [True, RuntimeError("not supported"), False]

    def wait_for_all_acked(_):
        outcome = outcomes.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    link.advertise("cmd_vel", "geometry_msgs/Twist")
    publisher = link._advertised["/cmd_vel", "default"].publisher
    with monkeypatch.context() as changed:
        changed.setattr(publisher, "_publisher", SimpleNamespace(wait_for_all_acked=wait_for_all_acked))
        publisher.flush(0.1)
        publisher.flush(0.1)
        with pytest.raises(LinkError, match=r"a subscriber does not take it within 7\.5 s"):
            publisher.flush(1.0)


#: Its author has not said whether goals may be cancelled.
SERVER = """
import sys, time
import rclpy
from rclpy.action import ActionServer
from rclpy.executors import MultiThreadedExecutor
from test_msgs.action import Fibonacci

rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("base")
ActionServer(node, Fibonacci, "dig", lambda _: time.sleep(600))
executor = MultiThreadedExecutor(2)
executor.add_node(node)
executor.spin()
"""


@pytest.mark.long
def test_a_server_that_refuses_and_answers_that_there_was_no_error_is_told():
    link = open_ros2_link({"domain": DOMAIN}, SystemClock())
    with subprocess.Popen([sys.executable, "-c", SERVER, DOMAIN]) as server:
        try:
            until(lambda: "/dig" in link.actions())
            link.send_goal("dig", "test_msgs/Fibonacci", {"order": 3})
            with pytest.raises(LinkError, match="do not end within 5 s after it was asked to cancel"):
                cancel_all_goals(link, "/dig")
        finally:
            with suppress(LinkError):  # the same, in other words
                link.close()
            server.kill()


LISTENER = """
import rclpy, sys
from geometry_msgs.msg import Twist
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("base")
node.create_subscription(Twist, "cmd_vel", lambda _: None, 10)
rclpy.spin(node)
"""


@pytest.mark.long
def test_a_subscriber_of_another_process_is_reached_however_seldom_it_acknowledges():
    with subprocess.Popen([sys.executable, "-c", LISTENER, DOMAIN]) as listener:
        try:
            with closing(open_ros2_link({"domain": DOMAIN}, SystemClock())) as link:
                until(lambda: list(link.subscribers("cmd_vel")))
                for _ in range(2):
                    link.publish("cmd_vel", "geometry_msgs/Twist", {})
                    assert link.advertise("cmd_vel", "geometry_msgs/Twist"), "Fast DDS asks each 3 s what was taken"
        finally:
            listener.kill()


OURS = """
import sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_ros2_link

link = open_ros2_link({"domain": sys.argv[1]}, SystemClock())
link.subscribe("cmd_vel", "geometry_msgs/Twist", lambda _: None)
time.sleep(600)
"""


@pytest.mark.long
def test_a_run_that_was_killed_while_it_subscribed_a_command_is_not_waited_for():
    """Fast DDS lists it for 20 s, in which it acknowledges nothing."""

    def subscribers():
        return {each.node for each in link.subscribers("cmd_vel")}

    with ExitStack() as stack:
        robot, run = (
            stack.enter_context(subprocess.Popen([sys.executable, "-c", each, DOMAIN])) for each in (LISTENER, OURS)
        )
        stack.callback(robot.kill)
        stack.callback(run.kill)
        link = stack.enter_context(closing(open_ros2_link({"domain": DOMAIN}, SystemClock())))
        until(lambda: subscribers() >= {"/base", f"/robot_runner_{run.pid}"})
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        run.kill()
        run.wait()
        assert keep_commanding_zero(link, [("cmd_vel", "geometry_msgs/Twist")]) == []
