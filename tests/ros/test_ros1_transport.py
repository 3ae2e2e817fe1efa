"""What the transport over rospy does while rospy has told others of something that it has not completed, or lost it."""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import sys
import threading
import time
import xmlrpc.client
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from types import SimpleNamespace

import pytest
from tests.loopback_port import claim_port
from tests.ros.ros1_master import quiet_about_rospy
from tests.ros.test_ros1_link import execute, opened
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import command_for_certain
from robot_runner.core.links.robot import Qos
from robot_runner.ros import ros1_publisher
from robot_runner.ros.ros1_types import message_class

__all__ = ["opened"]

TWIST, STRING = "geometry_msgs/Twist", "std_msgs/String"

pytestmark = pytest.mark.filterwarnings("ignore")


def publisher_of(topic):
    return import_module("rospy").topics.get_topic_manager().get_publisher_impl(topic)


def driven(opened):
    """Return a link that drives a robot, and what the robot hears."""
    robot, link, heard = opened(), opened(), []
    robot.subscribe("cmd_vel", TWIST, lambda message: heard.append(message["linear"]["x"]))
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    wait_until(lambda: heard == [0.2])
    return link, heard


@quiet_about_rospy
class TestCommands:
    def test_that_rospy_was_shut_down_is_told_as_it_says_nothing_of_commands_that_it_drops(self, opened, monkeypatch):
        link, _ = driven(opened)
        monkeypatch.setattr(import_module("rospy.core"), "is_shutdown_requested", lambda: True)
        with pytest.raises(LinkError, match=r"could not be told to stand still.*shut down") as caught:
            link.close()
        assert caught.value.where == "/cmd_vel"

    def test_a_connection_that_breaks_at_the_last_command_is_told(self, opened):
        link, _ = driven(opened)
        (connection,) = publisher_of("/cmd_vel").connections

        def reset(_):
            raise OSError(errno.ECONNRESET, "connection reset by peer")

        connection._connection.write_data = reset
        with pytest.raises(LinkError, match=r"could not be told to stand still.*connected any more"):
            link.close()

    def test_a_connection_that_breaks_to_who_has_gone_is_not_missed(self, opened, monkeypatch):
        link, _ = driven(opened)
        (connection,) = publisher_of("/cmd_vel").connections
        with monkeypatch.context() as changed:
            changed.setattr(connection, "_error", OSError(errno.ECONNRESET, "connection reset by peer"))
            # It was killed, and is at the master no more.
            changed.setattr(connection._connection, "endpoint_id", "/recorder")
            link._advertised["/cmd_vel", "default"].publisher.flush(1.0)

    def test_a_robot_that_is_there_and_not_connected_any_more_is_told(self, opened):
        link, heard = driven(opened)
        (connection,) = publisher_of("/cmd_vel").connections
        connection.close()
        wait_until(lambda: not publisher_of("/cmd_vel").connections)
        with pytest.raises(LinkError, match=r"could not be told to stand still.*connected any more"):
            link.close()
        assert heard == [0.2]

    def test_a_subscriber_that_has_left_is_not_missed(self, opened):
        robot, other, link = opened(), opened(), opened()
        heard = []
        robot.subscribe("cmd_vel", TWIST, lambda message: heard.append(message["linear"]["x"]))
        link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
        wait_until(lambda: heard == [0.2])
        robot.close()
        other.close()
        wait_until(lambda: not publisher_of("/cmd_vel").connections)
        link.close()


@pytest.fixture
def told_twice(monkeypatch):
    """Have rospy told twice of each publisher of /lamp as its first message has come; yield what it replaces then."""
    transport = import_module("rospy.impl.tcpros_base").TCPROSTransport
    handler, receive = import_module("rospy.impl.tcpros").get_tcpros_handler(), transport.receive_once
    replaced = []

    def receive_and_connect_anew(connection):
        messages = receive(connection)
        if connection.name == "/lamp" and not replaced:
            replaced.append(connection)
            handler.create_transport("/lamp", connection.endpoint_id, ["TCPROS", *connection.dest_address])
        return messages

    monkeypatch.setattr(transport, "receive_once", receive_and_connect_anew)
    return replaced


@quiet_about_rospy
def test_what_makes_a_robot_safe_comes_although_its_node_connects_anew_and_loses_what_it_has_read(opened, told_twice):
    """As where the master tells a node twice of a publisher, as where one begins and another one is killed."""
    link, heard = opened(), []
    hear = lambda message: heard.append(message.data)  # noqa: E731
    robot = import_module("rospy").Subscriber("/lamp", message_class(STRING), hear)
    command_for_certain(link, "lamp", STRING, {"data": "off"})
    wait_until(lambda: "off" in heard)
    robot.unregister()
    assert [each.done for each in told_twice] == [True]


@quiet_about_rospy
def test_a_subscription_that_is_told_twice_of_its_publisher_loses_nothing(opened, told_twice):
    robot, link, heard = opened(), opened(), []
    link.subscribe("lamp", STRING, lambda message: heard.append(message["data"]))
    for word in ("off", "on"):
        robot.publish("lamp", STRING, {"data": word})
    wait_until(lambda: "on" in heard)
    assert heard == ["off", "on"]
    assert [each.done for each in told_twice] == [False]


def test_a_connection_that_rospy_has_nothing_to_send_on_is_idle():
    lock, queue = threading.Lock(), []
    waiting = threading.Condition(lock)
    connection = SimpleNamespace(_cond_data_available=waiting, _lock=lock, _queue=queue, done=False)
    assert ros1_publisher._is_idle(connection) is False
    waiting._waiters.append(None)
    assert ros1_publisher._is_idle(connection) is True
    queue.append(b"")
    assert ros1_publisher._is_idle(connection) is False


def test_a_connection_that_was_closed_meanwhile_leaves_nothing_to_wait_for():
    """Where a subscriber had ended in that moment, the robot was said not to be told to stand still."""
    closed = socket.socket()
    closed.close()
    for each in (closed, None):
        assert ros1_publisher._is_unacknowledged(SimpleNamespace(socket=each)) is False


@pytest.mark.parametrize(
    "connection",
    [
        SimpleNamespace(),
        SimpleNamespace(_cond_data_available=object(), _lock=threading.Lock(), _queue=[], done=False),
        SimpleNamespace(_cond_data_available=threading.Condition(), done=False),
        SimpleNamespace(_cond_data_available=threading.Condition(), _lock=object(), _queue=[], done=False),
    ],
)
def test_a_connection_of_another_version_of_rospy_keeps_no_command_from_being_sent(connection):
    assert ros1_publisher._is_idle(connection) is None


@quiet_about_rospy
class TestRegistration:
    def test_who_connects_before_a_publisher_is_complete_is_told_that_it_keeps_its_message(self, opened, monkeypatch):
        goes_on = import_module("rospy.topics")._PublisherImpl.add_subscriber_listener

        def go_on(impl, listener):  # rospy has told the master of the publisher by now, and completes it afterwards
            wait_until(impl.has_connections)
            goes_on(impl, listener)

        monkeypatch.setattr(import_module("rospy.topics")._PublisherImpl, "add_subscriber_listener", go_on)
        robot, link = opened(), opened()
        robot.subscribe("kept", STRING, print)
        subscriber = import_module("rospy").topics.get_topic_manager().get_subscriber_impl("/kept")
        monkeypatch.setattr(subscriber, "tcp_nodelay", False)  # else the publisher does as it is asked
        link.advertise("kept", STRING, qos=Qos.TRANSIENT_LOCAL)
        (connection,) = publisher_of("/kept").connections
        assert connection.protocol.is_latch
        wait_until(lambda: subscriber.connections[0].is_latched)

    def test_whom_a_subscription_is_told_of_before_it_is_complete_is_asked_not_to_hold_messages_back(
        self, opened, monkeypatch
    ):
        goes_on = import_module("rospy.topics")._SubscriberImpl.set_tcp_nodelay

        def go_on(impl, is_asked):  # rospy has told the master of the subscription by now, and completes it afterwards
            if not impl.ref_count:
                return goes_on(impl, is_asked)
            wait_until(impl.has_connections)
            return goes_on(impl, is_asked)

        monkeypatch.setattr(import_module("rospy.topics")._SubscriberImpl, "set_tcp_nodelay", go_on)
        robot, link = opened(), opened()
        robot.advertise("undelayed", STRING)
        link.subscribe("undelayed", STRING, print)
        (connection,) = import_module("rospy").topics.get_topic_manager().get_subscriber_impl("/undelayed").connections
        assert connection.protocol.tcp_nodelay
        (sender,) = publisher_of("/undelayed").connections
        assert sender.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)

    def test_a_kept_message_that_comes_while_its_subscription_begins_comes_once(self, opened, monkeypatch):
        goes_on = import_module("rospy.topics")._SubscriberImpl.receive_callback

        def go_on(impl, messages, connection):  # rospy has kept the message by now, for those who come later
            wait_until(lambda: impl.callbacks)
            time.sleep(0.1)
            goes_on(impl, messages, connection)

        monkeypatch.setattr(import_module("rospy.topics")._SubscriberImpl, "receive_callback", go_on)
        subscriber = import_module("rospy.topics")._SubscriberImpl
        adds = subscriber.add_callback

        def add(impl, *given):
            wait_until(lambda: any(each.latch is not None for each in impl.connections))
            adds(impl, *given)

        monkeypatch.setattr(subscriber, "add_callback", add)
        robot, link = opened(), opened()
        robot.publish("kept", STRING, {"data": "once"}, qos=Qos.TRANSIENT_LOCAL)
        heard = []
        link.subscribe("kept", STRING, lambda message: heard.append(message["data"]))
        robot.publish("kept", STRING, {"data": "then"}, qos=Qos.TRANSIENT_LOCAL)
        wait_until(lambda: "then" in heard)
        assert heard == ["once", "then"]


@quiet_about_rospy
def test_the_messages_of_two_publishers_come_one_after_the_other(opened):
    link, at_work, most, heard = opened(), [], [], []

    def take(message):
        at_work.append(message)
        most.append(len(at_work))
        time.sleep(0.02)
        at_work.pop()
        heard.append(message)

    inner = link.subscribe_raw("chatter", STRING, take).inner
    header = {"md5sum": "*", "callerid": "/other"}
    message = SimpleNamespace(_connection_header=header, _buff=b"")
    threads = [threading.Thread(target=inner._take, args=(message,)) for _ in range(4)]  # rospy has one for each
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert len(heard) == 4
    assert max(most) == 1
    assert [each.received_ns for each in heard] == sorted(each.received_ns for each in heard)


@pytest.mark.long
@quiet_about_rospy
def test_a_robot_is_not_taken_for_stopped_where_rospy_was_shut_down(master_uri):
    printed = execute(
        master_uri,
        """
        import rospy
        from robot_runner.core.events.context import SystemClock
        from robot_runner.ros.link_opening import open_ros1_link
        link = open_ros1_link({}, SystemClock())
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        rospy.signal_shutdown("a test")  # as `rosnode kill` does, and Ctrl-C where a config has initialised the node
        try:
            link.close()
        except Exception as error:
            print(error)
        """,
    )
    assert "could not be told to stand still" in printed


@contextmanager
def deaf_robot(master_uri, topic):
    """Have a node subscribe a topic of type String or Twist, and take nothing until it is read from; yield its socket.

    What is published lies in the system of the publisher then, as where the network is cut.
    """
    node, there = "/deaf_robot", f"http://127.0.0.1:{claim_port()}"
    with xmlrpc.client.ServerProxy(master_uri) as master, socket.socket() as connection:
        *_, publisher = master.registerSubscriber(node, topic, "*", there)[2]  # those before were killed
        with xmlrpc.client.ServerProxy(publisher) as other:
            _, _, (_, host, port) = other.requestTopic(node, topic, [["TCPROS"]])
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.settimeout(PATIENCE)
        connection.connect((host, port))
        fields = [f"topic={topic}", "md5sum=*", f"callerid={node}"]
        header = b"".join(struct.pack("<I", len(each)) + each.encode() for each in fields)
        connection.sendall(struct.pack("<I", len(header)) + header)
        (length,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
        connection.recv(length, socket.MSG_WAITALL)
        try:
            yield connection
        finally:
            master.unregisterSubscriber(node, topic, there)


@quiet_about_rospy
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell what is not acknowledged")
def test_a_robot_that_acknowledges_no_command_is_not_said_to_have_been_told_to_stand_still(
    opened, master_uri, monkeypatch
):
    command, link = ("/cmd_vel", TWIST), opened()
    link.publish(*command, {"linear": {"x": 0.2}})
    with deaf_robot(master_uri, "/cmd_vel"):
        for _ in range(1000):
            link.publish(*command, {"linear": {"x": 0.2}})
            time.sleep(0)
        (connection,) = publisher_of("/cmd_vel").connections
        wait_until(lambda: not connection._queue, "rospy has handed all of them to the system")
        monkeypatch.setattr(ros1_publisher, "CONNECTING", 0.2)
        monkeypatch.setattr(commanded_topics, "_TELLING", 0.1)
        monkeypatch.setattr(commanded_topics, "_REACHING", 0.5)
        with pytest.raises(LinkError, match="the robot's subscription is not reached"):
            commanded_topics.keep_commanding_zero(link, [command])
        with pytest.raises(LinkError, match=r"could not be told to stand still: a message is not taken.*deaf_robot"):
            link.close()


@quiet_about_rospy
@pytest.mark.parametrize("is_off", [True, False], ids=["silent", "refusing"])
def test_a_robot_that_does_not_answer_is_awaited_whoever_else_subscribes_to_its_commands(
    opened, master_uri, monkeypatch, is_off
):
    """As where its network is cut; where its machine refuses, its node was killed, and stays at the master."""
    command, link = ("/cmd_vel", TWIST), opened()
    opened().subscribe("cmd_vel", TWIST, lambda _: None)
    monkeypatch.setattr(ros1_publisher, "CONNECTING", 0.2)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.1)
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.5)
    with socket.socket() as listening, xmlrpc.client.ServerProxy(master_uri) as master, ExitStack() as leaving:
        listening.bind(("127.0.0.1", 0))
        if is_off:
            listening.listen()
            leaving.enter_context(pytest.raises(LinkError, match="the robot's subscription is not reached"))
        there = f"http://127.0.0.1:{listening.getsockname()[1]}"
        master.registerSubscriber("/silent_robot", "/cmd_vel", TWIST, there)
        leaving.callback(master.unregisterSubscriber, "/silent_robot", "/cmd_vel", there)
        commanded_topics.keep_commanding_zero(link, [command])


#: What a process publishes that a robot has not taken when the process ends.
TALKATIVE = """
import os, sys, time
import rospy
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_ros1_link
link = open_ros1_link({}, SystemClock())
link.publish("/lamp", "std_msgs/String", {"data": ""})
print("ready", flush=True)
sys.stdin.readline()
link.advertise("/lamp", "std_msgs/String")  # it waits until the robot is connected
for _ in range(5):
    link.publish("/lamp", "std_msgs/String", {"data": 8000 * "x"})
(connection,) = rospy.topics.get_topic_manager().get_publisher_impl("/lamp").connections
while connection._queue or not connection._cond_data_available._waiters:
    time.sleep(0.01)  # until rospy has handed all of it to the system
print("published", flush=True)
sys.stdin.readline()
link.close()
os._exit(0)
"""


@quiet_about_rospy
@pytest.mark.long
@pytest.mark.parametrize("is_killed", [True, False], ids=["killed", "closed"])
def test_what_a_process_published_and_a_robot_did_not_take_dies_with_it_where_it_is_killed_alone(master_uri, is_killed):
    """A robot that was stopped since would drive again: the system would go on delivering it for minutes."""
    received, environment = 0, {**os.environ, "ROS_MASTER_URI": master_uri, "ROS_IP": "127.0.0.1"}
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", TALKATIVE], env=environment, **piped) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            with deaf_robot(master_uri, "/lamp") as robot:
                print(file=process.stdin, flush=True)
                assert process.stdout.readline() == "published\n"
                if is_killed:
                    process.kill()
                else:
                    print(file=process.stdin, flush=True)
                process.wait(PATIENCE)
                with suppress(ConnectionResetError):
                    while piece := robot.recv(65536):
                        received += len(piece)
        finally:
            process.kill()
    everything = 5 * (4 + 4 + 8000)
    assert received < everything / 2 if is_killed else received == everything
