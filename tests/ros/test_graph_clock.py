"""A run on a graph with a time of its own lives by that time."""

from __future__ import annotations

import threading
from contextlib import closing

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock, SystemClock
from robot_runner.core.links.robot import Encoding, GraphEndpoint, RawMessage
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros import graph_clock
from robot_runner.ros.graph_clock import GraphClock
from robot_runner.ros.graph_links import clock_fix
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.testing import FakeClock, FakeRobotLink


@pytest.fixture
def link():
    return FakeRobotLink(FakeClock())


def tell(link, seconds):
    whole = int(seconds)
    link.deliver("/clock", {"clock": {"sec": whole, "nanosec": round((seconds - whole) * 1e9)}})


def test_it_shows_what_was_told_last_and_never_goes_back(link):
    clock = GraphClock(link)
    assert isinstance(clock, Clock)
    tell(link, 12.5)
    clock.start()
    assert clock.now() == 12.5
    tell(link, 3.0)
    assert clock.now() == 12.5
    tell(link, 5.0)
    assert clock.now() == 14.5, "after a reset of the simulator it goes on from where it stood"
    tell(link, 4.9)
    assert clock.now() == 14.5
    clock.close()
    tell(link, 20.0)
    assert clock.now() == 14.5


def test_a_sleep_lasts_until_the_graph_s_time_has_come(link):
    clock = GraphClock(link)
    tell(link, 100.0)
    woken = []

    def sleep():
        began = clock.now()
        clock.sleep(2.0)
        woken.append(clock.now() - began)

    sleeping = threading.Thread(target=sleep)
    sleeping.start()
    for tenth in range(1, 6000):
        tell(link, 100.0 + tenth / 10)
        sleeping.join(0.01)
        if woken:
            break
    sleeping.join(60.0)
    assert woken
    assert woken[0] >= 2.0
    clock.sleep(-1.0)


def test_it_goes_on_while_a_callback_of_the_run_is_at_work(monkeypatch):
    pytest.importorskip("cyclonedds", reason="it is not published built for every machine")
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    options = {"domain": str(claim_domain()), "distro": "jazzy"}
    with (
        closing(open_dds_link(options, SystemClock())) as robot,
        closing(open_dds_link(options, SystemClock())) as link,
    ):
        began, released = threading.Event(), threading.Event()

        def work(_):
            began.set()
            released.wait(PATIENCE)

        clock = GraphClock(link)
        link.subscribe("chatter", "std_msgs/String", work)
        wait_until(lambda: robot.publish("chatter", "std_msgs/String", {"data": "a"}) or began.is_set())
        told = {"clock": {"sec": 12, "nanosec": 500_000_000}}
        wait_until(lambda: robot.publish("/clock", "rosgraph_msgs/Clock", told) or clock.now() == 12.5, seconds=20.0)
        released.set()


def test_the_time_of_ros_1_is_read(link):
    link.encoding = Encoding.ROS1
    heard = []
    link.subscribe_raw = lambda topic, kind, callback: heard.append(callback)
    clock = GraphClock(link)
    heard[0](RawMessage(bytes([12, 0, 0, 0, 0, 101, 205, 29]), 0))
    assert clock.now() == 12.5


def test_a_clock_that_nobody_tells_is_an_error(link, monkeypatch):
    monkeypatch.setattr(graph_clock, "_PATIENCE", 0.05)
    with pytest.raises(LinkError, match="nothing came on it") as caught:
        GraphClock(link, fix=clock_fix(RobotName.parse("ros1"))).start()
    assert "/use_sim_time" in caught.value.fix
    for name in ("ros2:clock=graph", "dds:clock=graph"):
        assert "leave clock=graph out" in clock_fix(RobotName.parse(name))
        assert "/use_sim_time" not in clock_fix(RobotName.parse(name))


def test_a_clock_that_stands_still_ends_a_sleep(link, monkeypatch):
    monkeypatch.setattr(graph_clock, "_PATIENCE", 0.05)
    clock = GraphClock(link)
    tell(link, 7.0)
    with pytest.raises(LinkError, match=r"stood still at 7\.000 s"):
        clock.sleep(1.0)


def test_two_nodes_that_tell_a_time_fail_the_run_and_only_one_is_believed_from_then_on(link):
    clock = GraphClock(link)
    link.known_publishers["/clock"] = [GraphEndpoint(node, "rosgraph_msgs/Clock") for node in ("/gazebo", "/player")]
    for seconds in (100.0, 5.0, 100.1):
        tell(link, seconds)
    with pytest.raises(LinkError, match="/gazebo and /player tell the graph's time") as caught:
        tell(link, 5.1)
    assert "/clock" in caught.value.where
    failed_at = clock.now()
    for seconds in (100.2, 5.2, 100.3, 5.3):
        tell(link, seconds)
    assert clock.now() == pytest.approx(failed_at + 0.2)


def test_a_simulator_that_was_reset_may_lose_messages(link):
    clock = GraphClock(link)
    for seconds in (100.0, 0.0, 3.0, 10.0, 40.0, 80.0, 110.0):
        tell(link, seconds)
    assert clock.now() == 210.0


def test_a_simulator_that_is_reset_stands_still_and_is_reset_later_is_one_node(link, monkeypatch):
    clock = GraphClock(link)
    now = [0.0]
    monkeypatch.setattr(graph_clock.time, "monotonic", lambda: now[0])
    for wall, seconds in ((0.0, 3.0), (0.1, 0.0), (1.7, 1.6), (8.0, 0.0), (8.1, 0.1)):
        now[0] = wall
        tell(link, seconds)
    assert clock.now() == pytest.approx(4.7)
