"""What the graph link itself owns, on a transport that notes what it is asked for."""

from __future__ import annotations

import logging
import threading
from types import SimpleNamespace

import pytest
from tests.waiting import PATIENCE

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Qos, RawMessage, RobotLink
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.ros2_actions import Ros2Actions
from robot_runner.ros.type_catalogue import TypeCatalogue

TWIST = "geometry_msgs/Twist"
STRING = "std_msgs/String"
TRIGGER = "std_srvs/Trigger"


class Noted:
    """A publisher, subscription or offer that notes what is done with it."""

    def __init__(self, transport, name):
        self.transport = transport
        self.name = name

    def publish(self, message):
        self.transport.note("publish", self.name)
        if self.transport.is_lost:
            raise LinkError("the connection is lost", where=self.name, fix="Switch the robot on.")
        self.transport.published.append(message)

    def reach(self):
        self.transport.note("reach", self.name)
        return True

    def is_heard(self):
        return self.transport.has_subscribers

    def flush(self, seconds):
        self.transport.note("flush", self.name)

    def explain(self):
        return "Start the node."

    def close(self):
        self.transport.note("close", self.name)


class NotingTransport:
    has_threads = True
    encoding = Encoding.CDR

    def __init__(self):
        self.types = TypeCatalogue.of(2)
        self.actions = Ros2Actions(self)
        self.done = []
        self.published = []
        self.receivers = {}
        self.is_lost = False
        self.has_subscribers = False

    def note(self, what, name):
        self.done.append(f"{what} {name}")

    def advertise(self, topic, message_type, qos):
        self.note("advertise", topic)
        return Noted(self, topic)

    def subscribe(self, topic, message_type, receive, *, qos, lane):
        self.receivers[topic] = receive
        return Noted(self, topic)

    def call(self, service, service_type, request, timeout):
        return {"asked": request}

    def serve(self, service, service_type, answer):
        self.answer = answer
        return Noted(self, service)

    def topics(self):
        return {"/chatter": "", "/odom": "nav_msgs/Odometry", "/other": ""}

    def services(self):
        return {}

    def nodes(self):
        return ["/b", "/a"]

    def wait(self, event, seconds):
        for receive in list(self.receivers.values()):
            receive(reception({"data": "a"}))

    def close(self):
        self.note("leave", "the graph")


def reception(message):
    return SimpleNamespace(message=lambda: message, raw=lambda: RawMessage(b"bytes", 7))


@pytest.fixture
def transport():
    return NotingTransport()


@pytest.fixture
def link(transport):
    return GraphLink(lambda: transport)


def test_it_is_a_robot_link(link, transport):
    assert isinstance(link, RobotLink)
    assert link.encoding is transport.encoding


def test_a_namespace_that_cannot_be_is_refused_before_the_graph_is_joined():
    with pytest.raises(LinkError, match="'3x' cannot be the name of a namespace"):
        GraphLink(lambda: pytest.fail("the graph was joined"), "3x")


def test_the_robot_is_stopped_first_and_the_rest_is_closed_in_reverse_order(link, transport):
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    link.subscribe("odom", "nav_msgs/Odometry", print)
    link.publish("chatter", STRING, {"data": "a"})
    link.offer("lamp", TRIGGER, lambda _: {})
    transport.done.clear()
    link.close()
    assert transport.done == [
        *("publish /cmd_vel", "flush /cmd_vel"),
        *("close /chatter", "close /cmd_vel", "close /lamp", "close /odom"),
        "leave the graph",
    ]
    assert transport.published[-1]["linear"] == {"x": 0.0, "y": 0.0, "z": 0.0}


def test_a_stop_that_cannot_be_delivered_is_raised_when_everything_is_closed(link, transport):
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    link.subscribe("odom", "nav_msgs/Odometry", print)
    transport.is_lost = True
    with pytest.raises(LinkError, match="could not be told to stand still: the connection is lost") as caught:
        link.close()
    assert caught.value.where == "/cmd_vel"
    assert "watchdog" in caught.value.fix
    assert transport.done[-3:] == ["close /cmd_vel", "close /odom", "leave the graph"]
    link.close()


def test_what_was_closed_before_is_not_closed_again(link, transport):
    subscription = link.subscribe("odom", "nav_msgs/Odometry", print)
    subscription.close()
    subscription.close()
    link.close()
    assert transport.done == ["close /odom", "leave the graph"]


def test_a_wrong_first_message_does_not_put_its_topic_on_the_graph(link, transport):
    with pytest.raises(LinkError, match="no field 'X'"):
        link.publish("cmd_vel", TWIST, {"X": 1})
    assert transport.done == []


def test_a_topic_has_a_publisher_for_each_qos_and_one_type(link, transport):
    link.publish("chatter", STRING, {"data": "a"})
    link.publish("chatter", "std_msgs/msg/String", {"data": "b"})
    link.publish("chatter", STRING, {"data": "c"}, qos=Qos.TRANSIENT_LOCAL)
    assert transport.done.count("advertise /chatter") == 2
    with pytest.raises(LinkError, match="carries std_msgs/String, not std_msgs/Int32"):
        link.publish("chatter", "std_msgs/Int32", {"data": 1})


def test_it_tells_whether_a_topic_has_subscribers_and_nothing_before_it_is_advertised(link, transport):
    assert link.is_heard("chatter"), "not known"
    link.publish("chatter", "std_msgs/String", {"data": "a"})
    assert not link.is_heard("chatter")
    transport.has_subscribers = True
    assert link.is_heard("chatter")


def test_a_wait_leaves_no_subscription_behind(link, transport):
    assert link.wait_for("chatter", STRING) == {"data": "a"}
    transport.receivers.clear()
    transport.wait = lambda event, seconds: None
    with pytest.raises(LinkError, match="no message that satisfies the condition came within") as caught:
        link.wait_for("chatter", STRING, lambda _: True, timeout=0.1)
    assert caught.value.fix == "Start the node."
    assert transport.done == ["close /chatter"] * 2
    link.close()
    assert transport.done[2:] == ["leave the graph"]


def test_the_first_fault_of_a_callback_is_logged_once_and_raised_by_closing(link, transport, caplog):
    link.subscribe("chatter", STRING, lambda message: message["no such field"])
    for _ in range(3):
        transport.receivers["/chatter"](reception({"data": "a"}))
    assert caplog.text.count("the callback of /chatter raised") == 1
    assert "Traceback" in caplog.text
    with pytest.raises(LinkError, match="a callback raised KeyError: 'no such field'") as caught:
        link.close()
    assert isinstance(caught.value.__cause__, KeyError)
    assert transport.done[-1] == "leave the graph"


def test_a_callback_that_is_at_work_while_its_subscription_ends_fails_nothing(link, transport, caplog):
    def write(_):
        subscription.close()
        raise ValueError("I/O operation on closed file")

    subscription = link.subscribe("chatter", STRING, write)
    with caplog.at_level(logging.ERROR):
        transport.receivers["/chatter"](reception({"data": "a"}))
    assert "closed file" in caplog.text
    link.close()


def test_what_comes_after_a_subscription_was_closed_is_dropped(link, transport):
    received = []
    subscription = link.subscribe_raw("chatter", STRING, received.append)
    transport.receivers["/chatter"](reception({}))
    subscription.close()
    transport.receivers["/chatter"](reception({}))
    assert received == [RawMessage(b"bytes", 7)]


def test_without_threads_a_fault_reaches_the_one_who_lets_time_go_by(link, transport):
    transport.has_threads = False
    link.subscribe("chatter", STRING, lambda message: message["no such field"])
    with pytest.raises(KeyError):
        transport.receivers["/chatter"](reception({}))
    link.close()


def test_requests_and_responses_have_every_field(link, transport):
    link.offer("lamp", TRIGGER, lambda _: {"success": True})
    assert transport.answer({}) == {"success": True, "message": ""}
    assert link.call("lamp", "std_srvs/SetBool") == {"asked": {"data": False}}


def test_the_answer_of_an_offered_service_is_checked_and_its_fault_logged(link, transport, caplog):
    link.offer("lamp", TRIGGER, lambda _: {"sucess": True})
    with pytest.raises(LinkError, match="no field 'sucess'") as caught:
        transport.answer({})
    assert "the answer of /lamp" in caught.value.where
    assert "the service /lamp failed" in caplog.text


def test_types_that_the_graph_does_not_tell_are_those_of_own_subscriptions(link):
    link.subscribe("chatter", "std_msgs/msg/String", print)
    assert link.topics() == {"/chatter": STRING, "/odom": "nav_msgs/Odometry", "/other": "*"}
    assert link.nodes() == ["/a", "/b"]


def test_a_closed_link_is_of_no_use(link):
    link.close()
    for use in (link.topics, link.services, link.nodes, lambda: link.offer("lamp", TRIGGER, lambda _: {})):
        with pytest.raises(LinkError, match="the link was closed"):
            use()


def test_a_command_that_was_begun_when_the_link_is_closed_does_not_follow_the_last_stop(link, transport):
    class ClosingIt(dict):
        def get(self, *wanted):
            link.close()  # as another thread does while this one makes its message
            return super().get(*wanted)

    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    with pytest.raises(LinkError, match="the link was closed"):
        link.publish("cmd_vel", TWIST, ClosingIt(linear={"x": 0.3}))
    assert [message["linear"]["x"] for message in transport.published] == [0.2, 0.0]


@pytest.mark.parametrize("opened", ["a publisher", "a subscription"])
def test_what_is_on_its_way_to_the_graph_when_the_link_is_closed_comes_to_nothing(link, transport, opened):
    is_opening, is_closed, refused = threading.Event(), threading.Event(), []

    def slowly(opening):
        def open_it(*given, **named):
            is_opening.set()
            is_closed.wait(PATIENCE)
            return opening(*given, **named)

        return open_it

    transport.advertise, transport.subscribe = slowly(transport.advertise), slowly(transport.subscribe)

    def use():
        try:
            if opened == "a publisher":
                link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
            else:
                link.subscribe("cmd_vel", TWIST, print)
        except LinkError as error:
            refused.append(error.problem)

    using = threading.Thread(target=use)
    using.start()
    assert is_opening.wait(PATIENCE)
    link.close()
    is_closed.set()
    using.join()
    assert refused == ["the link was closed"]
    assert transport.done[-1] == "close /cmd_vel"
    assert transport.published == []


def test_a_goal_is_not_sent_once_the_link_is_closed(link, transport):
    client = SimpleNamespace(send=lambda *_: pytest.fail("the goal was sent"), is_served=lambda: True, close=print)

    def found_late(*_):
        link.close()  # as another thread does while the server is looked for
        return client

    transport.actions.client = found_late
    with pytest.raises(LinkError, match="the link was closed"):
        link.send_goal("spin", "example_interfaces/Fibonacci", {"order": 1})


def test_closing_asks_for_the_end_of_a_goal_that_has_a_key_and_of_no_other(link, transport):
    asked = []

    def accepted_late(_goal, sent, _timeout):
        link.close()
        assert asked == []  # the key of no goal stands for all goals of all clients, in ROS 1
        sent.key = "a"

    transport.actions.client = lambda *_: SimpleNamespace(
        send=accepted_late,
        is_served=lambda: True,
        cancels_at_once=False,
        cancel=lambda sent, _: asked.append(sent.key),
        close=lambda: None,
    )
    with pytest.raises(LinkError, match="the link was closed"):
        link.send_goal("spin", "example_interfaces/Fibonacci", {"order": 1})
    assert asked == ["a"]
