"""What fails while a link is closed keeps nothing else from being stopped, and is told."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from functools import partial

import pytest
from tests.ros.test_graph_link import STRING, TWIST, NotingTransport
from tests.waiting import PATIENCE

from robot_runner.core.errors import LinkError
from robot_runner.core.events.resources import Resources
from robot_runner.core.links import commanded_topics
from robot_runner.ros import graph_link
from robot_runner.ros.first_message import FirstMessage
from robot_runner.ros.graph_link import GraphLink

FIBONACCI = "example_interfaces/Fibonacci"
#: What client libraries and the system raise beside what a transport is to raise.
FAULTS = (
    AttributeError("no such attribute"),
    OSError("no route to host"),
    RuntimeError("context is not valid"),
    KeyboardInterrupt(),
)


@pytest.fixture
def transport():
    return NotingTransport()


@pytest.fixture
def link(transport):
    return GraphLink(lambda: transport)


def fails(fault):
    def fail(*_):
        raise fault

    return fail


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: type(fault).__name__)
@pytest.mark.parametrize("step", ["publish", "flush", "close"])
def test_whatever_fails_at_one_topic_every_other_robot_is_stopped(link, transport, fault, step):
    for robot in ("alice", "bob", "carol"):
        link.publish(f"/{robot}/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    setattr(link._advertised["/bob/cmd_vel", "default"].publisher, step, fails(fault))
    transport.done.clear()
    with pytest.raises((LinkError, type(fault))) as caught:
        link.close()
    for robot in ("alice", "carol"):
        assert [each for each in transport.done if robot in each] == [
            f"publish /{robot}/cmd_vel",
            f"flush /{robot}/cmd_vel",
            f"close /{robot}/cmd_vel",
        ]
    assert transport.done[-1] == "leave the graph"
    if step != "close" and isinstance(fault, Exception):
        assert str(caught.value).startswith(
            f"/bob/cmd_vel: the robot could not be told to stand still: {type(fault).__name__}: {fault}"
        )


def test_where_nobody_is_known_to_have_commanded_zero_is_published_and_not_awaited(link, transport, monkeypatch):
    told = []
    monkeypatch.setattr(commanded_topics, "_listeners", [lambda each: told.append(each.topic)])
    link.advertise("/alice/cmd_vel", TWIST, is_commanded=False)
    link.advertise("/bob/cmd_vel", TWIST, is_commanded=False)
    link.publish("/bob/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    link._advertised["/alice/cmd_vel", "default"].publisher.flush = fails(LinkError("it is gone", where="/alice"))
    transport.done.clear()
    link.close()
    assert transport.done[:3] == ["publish /alice/cmd_vel", "publish /bob/cmd_vel", "flush /bob/cmd_vel"]
    assert told == ["/bob/cmd_vel"], "who stands by insists that the robot takes it"


def test_no_robot_is_commanded_until_whoever_stands_by_knows_of_it(link, transport, monkeypatch):
    """The second command was published where the first could not be told, as for a lack of room: nobody stopped it."""
    monkeypatch.setattr(commanded_topics, "_listeners", [fails(OSError("no space left on device"))])
    for _ in range(2):  # as in a mission that goes on whatever is raised
        with pytest.raises(OSError, match="no space left"):
            link.publish("/alice/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    assert transport.published == []
    told = []
    monkeypatch.setattr(commanded_topics, "_listeners", [lambda each: told.append(each.topic)])
    for _ in range(2):
        link.publish("/alice/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    assert (told, len(transport.published)) == (["/alice/cmd_vel"], 2)


def test_a_robot_that_others_have_claimed_is_not_told_to_stand_still(link, transport, monkeypatch):
    """Their run would have measured a stop that it had not commanded."""
    monkeypatch.setattr(commanded_topics, "claim_commanded", fails(LinkError("bob is in use", where="open_robot")))
    with pytest.raises(LinkError, match="bob is in use"):
        link.publish("/bob/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    link.close()
    assert transport.published == []


def test_every_robot_is_told_before_anybody_waits_for_one_that_is_out_of_reach(link, transport):
    for robot in ("alice", "bob"):
        link.publish(f"/{robot}/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    transport.done.clear()
    link.close()
    assert sorted(transport.done[:2]) == ["publish /alice/cmd_vel", "publish /bob/cmd_vel"]
    assert sorted(transport.done[2:4]) == ["flush /alice/cmd_vel", "flush /bob/cmd_vel"]


def test_the_robots_of_all_links_are_told_before_one_of_them_is_closed():
    resources, first, second = Resources(), NotingTransport(), NotingTransport()
    second.done = first.done  # one after the other, in the order in which it was done
    for robot, transport in (("alice", first), ("bob", second)):
        link = resources.open(robot, partial(GraphLink, lambda transport=transport: transport))
        link.publish(f"/{robot}/cmd_vel", TWIST, {"linear": {"x": 0.2}})
        link.publish(f"/{robot}/lamp", STRING, {"data": "on"})
    first.done.clear()
    resources.close()
    assert sorted(first.done[:2]) == ["publish /alice/cmd_vel", "publish /bob/cmd_vel"]
    assert not [each for each in first.done if each.startswith("publish") and "lamp" in each]


def test_what_fails_as_a_robot_is_halted_is_told_as_its_link_is_closed(transport):
    resources = Resources()
    link = resources.open("alice", lambda: GraphLink(lambda: transport))
    link.publish("/alice/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    transport.is_lost = True
    with pytest.raises(LinkError, match="could not be told to stand still"):
        resources.close()
    assert transport.done[-1] == "leave the graph"


def test_that_a_robot_was_not_stopped_is_told_whatever_fails_afterwards(link, transport):
    link.publish("/alice/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    link.publish("/bob/cmd_vel", TWIST, {"linear": {"x": 0.2}})
    transport.is_lost = True
    transport.close = fails(LinkError("leaving took longer than 5 s", where="the graph", fix="Look at it."))
    with pytest.raises(LinkError, match="could not be told to stand still") as caught:
        link.close()
    told = {finding.where for finding in caught.value.findings}
    assert told == {"/alice/cmd_vel", "/bob/cmd_vel", "the graph"}


@pytest.mark.parametrize("step", ["ask_for_end", "close"])
def test_whatever_fails_at_one_goal_every_other_is_cancelled_and_the_robot_is_stopped(link, transport, step):
    asked, left = [], []

    class Client:
        cancels_at_once = False

        def __init__(self, action):
            self.action = action

        def send(self, _goal, sent, _timeout):
            sent.key = self.action

        def cancel(self, sent, _timeout):
            if step == "ask_for_end" and self.action == "/first":
                raise RuntimeError("context is not valid")
            asked.append(sent.key)
            sent.lose(LinkError("it ended", where=sent.key, fix="None."))

        def is_served(self):
            return True

        def close(self):
            if step == "close" and self.action == "/first":
                raise RuntimeError("context is not valid")
            left.append(self.action)

    transport.actions.client = lambda action, *_: Client(action)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    for action in ("first", "second"):
        link.send_goal(action, FIBONACCI, {"order": 1})
    if step == "ask_for_end":
        with pytest.raises(LinkError, match="could not be cancelled: RuntimeError: context is not valid"):
            link.close()
    else:
        link.close()
    assert "/second" in asked
    assert "/second" in left
    assert transport.published[-1]["linear"]["x"] == 0.0


class SlowServer:
    """The server of an action that answers to the request to end a goal once another server was asked, too."""

    cancels_at_once = False

    def __init__(self, action, asked, other):
        self.action, self.asked, self.other = action, asked, other
        self.is_late = False

    def send(self, _goal, sent, _timeout):
        sent.key = self.action

    def cancel(self, sent, _timeout):
        self.asked.set()
        self.is_late = not self.other.wait(PATIENCE) or self.is_late
        sent.lose(LinkError("it ended", where=sent.key, fix="None."))

    def is_served(self):
        return True

    def close(self):
        pass


@pytest.mark.parametrize("links", [1, 2])
def test_the_end_of_every_goal_is_asked_for_before_any_server_is_awaited(links):
    resources = Resources()
    first, second = threading.Event(), threading.Event()
    servers = {"/first": SlowServer("/first", first, second), "/second": SlowServer("/second", second, first)}
    for number, action in enumerate(servers):
        transport = NotingTransport()
        transport.actions.client = lambda name, *_: servers[name]
        opened = partial(GraphLink, lambda transport=transport: transport)
        resources.open(f"link {number % links}", opened).send_goal(action, FIBONACCI, {"order": 1})
    resources.close()
    assert not any(server.is_late for server in servers.values())


def test_the_end_of_goals_is_asked_for_in_the_one_thread_of_a_transport_that_has_no_others():
    resources, asked, transport = Resources(), threading.Event(), NotingTransport()
    server, threads = SlowServer("/first", asked, asked), []
    cancel = server.cancel
    server.cancel = lambda *told: (threads.append(threading.current_thread()), cancel(*told))
    transport.has_threads, transport.actions.client = False, lambda *_: server
    resources.open("link", lambda: GraphLink(lambda: transport)).send_goal("/first", FIBONACCI, {"order": 1})
    resources.close()
    assert threads == [threading.current_thread()]


def test_who_closes_a_link_that_another_thread_closes_goes_on_once_the_robot_was_told_to_stand_still(link, transport):
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    is_stopping, may_stop = threading.Event(), threading.Event()
    publisher = link._advertised["/cmd_vel", "default"].publisher
    goes_on = publisher.publish

    def publish(message):
        is_stopping.set()
        may_stop.wait(PATIENCE)
        goes_on(message)

    publisher.publish = publish
    closing = threading.Thread(target=link.close)
    closing.start()
    assert is_stopping.wait(PATIENCE)
    threading.Timer(0.2, may_stop.set).start()
    link.close()  # the process may end now
    assert transport.published[-1]["linear"]["x"] == 0.0
    closing.join(PATIENCE)


def test_who_closes_a_link_in_the_middle_of_closing_it_waits_for_nothing(link, transport, monkeypatch):
    monkeypatch.setattr(graph_link, "_STOPPING_SECONDS", 60.0)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    publisher = link._advertised["/cmd_vel", "default"].publisher
    publisher.publish = lambda _: link.close()  # as a callback does that is called in it
    began = time.monotonic()
    link.close()
    assert time.monotonic() - began < 30.0
    assert transport.done[-1] == "leave the graph"


def test_a_subscription_that_two_threads_close_is_closed_once(link, transport):
    subscription = link.subscribe("odom", "nav_msgs/Odometry", print)
    other = threading.Thread(target=subscription.close)

    class Asked:
        """Whether it is open; another thread closes it as soon as this was asked."""

        def __bool__(self):
            if other.ident is None:
                other.start()
                other.join(0.2)
            return True

    subscription.is_open = Asked()
    subscription.close()
    other.join(PATIENCE)
    assert transport.done == ["close /odom"]


class Closing(dict):
    """Books of a link, which another thread begins to close just before the first entry."""

    def __init__(self, link):
        super().__init__()
        self.closing = threading.Thread(target=link.close)

    def _close(self):
        if self.closing.ident is None:
            self.closing.start()
            self.closing.join(0.2)

    def setdefault(self, *entry):
        self._close()
        return super().setdefault(*entry)

    def __setitem__(self, *entry):
        self._close()
        super().__setitem__(*entry)


@pytest.mark.parametrize("books", ["_advertised", "_opened"])
def test_what_is_opened_in_the_moment_in_which_the_link_is_closed_is_closed(link, transport, books):
    setattr(link, books, Closing(link))
    with suppress(LinkError):  # a command does not follow
        if books == "_advertised":
            link.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
        else:
            link.subscribe("cmd_vel", TWIST, print)
    getattr(link, books).closing.join(PATIENCE)
    assert "close /cmd_vel" in transport.done
    assert [message["linear"]["x"] for message in transport.published][-1:] in ([], [0.0])


def test_a_condition_that_two_threads_look_at_keeps_the_first_message():
    first: FirstMessage

    def condition(message):
        if message["data"] == "late":
            first.take({"data": "first"})  # as another connection's thread does meanwhile
        return True

    first = FirstMessage(condition, 1.0)
    first.take({"data": "late"})
    assert first.result("/chatter", lambda: "") == {"data": "first"}


def test_what_a_client_library_says_of_a_link_that_was_closed_meanwhile_is_that_it_was_closed(link, transport):
    def closed_meanwhile(*_, **__):
        link.close()
        raise RuntimeError("context is not valid")

    transport.advertise = transport.subscribe = closed_meanwhile
    with pytest.raises(LinkError, match="the link was closed"):
        link.publish("chatter", STRING, {"data": "a"})


def test_a_message_that_cannot_be_published_is_a_link_error(link, transport):
    link.publish("chatter", STRING, {"data": "a"})
    link._advertised["/chatter", "default"].publisher.publish = fails(RuntimeError("context is not valid"))
    with pytest.raises(LinkError, match="cannot be published: RuntimeError: context is not valid") as caught:
        link.publish("chatter", STRING, {"data": "a"})
    assert caught.value.where == "/chatter"
