"""What the link over DDS does where steps of its threads and of the graph come in the order that is seldom."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack, suppress
from types import SimpleNamespace

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.test_graph_link import STRING, TWIST
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Qos
from robot_runner.ros.link_opening import open_dds_link

pytest.importorskip("cyclonedds", reason="it is not published built for every machine")

from robot_runner.ros import dds_services, dds_transport
from robot_runner.ros.action_calls import CLOSING_SECONDS
from robot_runner.ros.dds_reception import RawSample, Reception
from robot_runner.ros.dds_transport import DdsTransport

DOMAIN = claim_domain()
TRIGGER = "std_srvs/Trigger"
FIBONACCI = "example_interfaces/Fibonacci"


@pytest.fixture(autouse=True)
def _loopback(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


@pytest.fixture
def opened():
    with ExitStack() as closing:

        def open_link():
            link = open_dds_link({"domain": str(DOMAIN), "distro": "jazzy"}, SystemClock())
            closing.callback(lambda: suppress(LinkError).__enter__() or link.close())
            return link

        yield open_link


def test_a_service_that_is_matched_after_it_was_discovered_is_called(opened, monkeypatch):
    robot, link = opened(), opened()
    robot.offer("lamp", TRIGGER, lambda _: {"success": True})
    matched, asked = dds_services.matched_subscriptions, []

    def matched_later(writer):  # of which nobody is told: DDS tells of who is discovered, and matches it afterwards
        asked.append(time.monotonic())
        return matched(writer) if time.monotonic() - asked[0] > 0.3 else []

    monkeypatch.setattr(dds_services, "matched_subscriptions", matched_later)
    assert link.call("lamp", TRIGGER, timeout=10.0)["success"]
    assert time.monotonic() - asked[0] < 5.0


def test_a_service_that_is_matched_later_is_called_from_a_callback(opened, monkeypatch):
    robot, link, answers = opened(), opened(), []
    robot.offer("lamp", TRIGGER, lambda _: {"success": True})
    matched, asked, is_over = dds_services.matched_subscriptions, [], threading.Event()

    def matched_later(writer):
        asked.append(time.monotonic())
        return matched(writer) if time.monotonic() - asked[0] > 0.3 else []

    def call(_):
        try:
            answers.append(link.call("lamp", TRIGGER, timeout=10.0)["success"])
        finally:
            is_over.set()

    monkeypatch.setattr(dds_services, "matched_subscriptions", matched_later)
    link.subscribe("chatter", STRING, call)
    robot.publish("chatter", STRING, {"data": "now"})
    assert is_over.wait(PATIENCE)
    assert answers == [True]
    assert time.monotonic() - asked[0] < 5.0


def test_a_message_comes_once_whose_callback_waits_while_its_subscription_adapts_to_the_publisher(opened, monkeypatch):
    robot, link, heard, made = opened(), opened(), [], []
    reading = dds_transport._Subscription._reading

    def reading_while_it_is_published(subscription):
        made.append(reading(subscription))
        if len(made) == 2:  # that for the publisher, beside the one that was there first
            robot.advertise("chatter", STRING)
            robot.publish("chatter", STRING, {"data": "now"})
            time.sleep(0.2)  # both readers have it
        return made[-1]

    def take(message):
        heard.append(message["data"])
        link._transport.wait(threading.Event(), 0.2)

    monkeypatch.setattr(dds_transport._Subscription, "_reading", reading_while_it_is_published)
    link.subscribe("chatter", STRING, take)
    robot.advertise("chatter", STRING)
    wait_until(lambda: "now" in heard and not made[0].is_open)
    robot.publish("chatter", STRING, {"data": "last"})
    wait_until(lambda: "last" in heard)
    assert heard == ["now", "last"]


@pytest.mark.parametrize("is_taken", [False, True])
def test_what_has_come_is_not_lost_while_a_callback_waits_and_its_subscription_adapts_to_another(opened, is_taken):
    robot, other, link, heard = opened(), opened(), opened(), []
    graph = link._transport._session.graph

    def take(message):
        heard.append(message["data"])
        if heard == ["a"]:
            if not is_taken:
                tell("b", "c")
            other.publish("chatter", STRING, {"data": "weak"}, qos=Qos.SENSOR_DATA)
            while len(graph.writers("rt/chatter")) < 2:
                link._transport.wait(threading.Event(), 0.02)

    def tell(*words):
        for each in words:
            robot.publish("chatter", STRING, {"data": each})

    robot.advertise("chatter", STRING)
    robot.subscribe("chatter", STRING, lambda _: None, qos=Qos.SENSOR_DATA)  # one that the other may publish for
    link.subscribe("chatter", STRING, take)
    link.subscribe("begin", STRING, lambda _: tell("a", "b", "c") if is_taken else tell("a"))
    wait_until(lambda: robot.subscribers("chatter"))
    robot.publish("begin", STRING, {})
    wait_until(lambda: "c" in heard)
    wait_until(lambda: "last" in heard or other.publish("chatter", STRING, {"data": "last"}, qos=Qos.SENSOR_DATA))
    assert [each for each in heard if each in {"a", "b", "c"}] == ["a", "b", "c"]


def test_more_has_come_than_is_taken_at_once_before_a_subscription_adapts_and_all_of_it_is_handed_on(opened):
    robot, link, heard = opened(), opened(), []
    robot.advertise("chatter", STRING)
    opened().subscribe("chatter", STRING, lambda _: None, qos=Qos.SENSOR_DATA)  # one that it may publish for, weakly

    def begin(_):
        for number in range(600):
            robot.publish("chatter", STRING, {"data": str(number)})
        robot.publish("chatter", STRING, {"data": "weak"}, qos=Qos.SENSOR_DATA)
        time.sleep(0.3)  # all of it is there before anything is taken

    link.subscribe("chatter", STRING, lambda message: heard.append(message["data"]))
    link.subscribe("begin", STRING, begin)
    wait_until(lambda: len(robot.subscribers("chatter")) > 1)
    robot.publish("begin", STRING, {})
    wait_until(lambda: "599" in heard)
    assert [each for each in heard if each != "weak"] == [str(number) for number in range(600)]


def test_a_link_that_is_closed_by_a_callback_cancels_its_goals_at_once(opened):
    robot, link, ended, closed = opened(), opened(), [], []

    def count(execution):
        while not execution.is_cancel_requested:
            time.sleep(0.01)
        ended.append(time.monotonic())
        return {"sequence": []}

    def leave(_):
        begun = time.monotonic()
        link.close()
        closed.append((ended[0] - begun, time.monotonic() - begun))

    robot.offer_action("count", FIBONACCI, count)
    link.send_goal("count", FIBONACCI, {"order": 5}, timeout=20.0)
    link.subscribe("bye", STRING, leave)
    wait_until(lambda: closed or robot.publish("bye", STRING, {}))
    assert max(closed[0]) < CLOSING_SECONDS


def test_a_reply_to_another_client_that_comes_while_a_client_is_made_is_left_out(opened, monkeypatch):
    robot, link = opened(), opened()
    robot.offer("lamp", TRIGGER, lambda _: {"success": True})
    goes_on, came = Reception.add, []

    def add(reception, reader, handler, where):
        source = goes_on(reception, reader, handler, where)
        if where == "/lamp":
            sample = RawSample(bytes(28))
            sample.sample_info = SimpleNamespace(valid_data=True)
            handler(sample)
            came.append(where)
        return source

    monkeypatch.setattr(Reception, "add", add)
    assert link.call("lamp", TRIGGER)["success"]
    assert came == ["/lamp"]


def test_that_a_robot_does_not_take_the_last_command_is_told(opened):
    robot, link = opened(), opened()
    robot.subscribe("cmd_vel", TWIST, print)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    transport: DdsTransport = link._transport
    assert isinstance(transport, DdsTransport)
    publisher = link._advertised["/cmd_vel", "default"].publisher
    publisher._writer = Unheard(publisher._writer)
    with pytest.raises(
        LinkError, match=r"could not be told to stand still: a subscriber does not take it within 7\.5 s"
    ):
        link.close()


class Unheard:
    """A writer whose reader does not acknowledge anything: cyclonedds 11.0 fails where the time is over."""

    def __init__(self, writer):
        self._writer = writer

    def wait_for_acks(self, _):
        raise AttributeError("type object 'DDSException' has no attribute 'DDS_RETCODE_TIMEOUT'")

    def __getattr__(self, name):
        return getattr(self._writer, name)

    def __del__(self):
        self._writer.__del__()
