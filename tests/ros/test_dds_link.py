"""The link over DDS beside a node of another process, which knows nothing of it."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from functools import partial

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.other_node import OtherNode
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import fails_run
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import keep_commanding_zero
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.robot import Qos
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.link_opening import open_dds_link

pytest.importorskip("cyclonedds", reason="it is not published built for every machine")

from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos

from robot_runner.ros import dds_reception, dds_session, dds_transport, graph_look
from robot_runner.ros.dds_qos import reader_profile
from robot_runner.ros.dds_reception import topic_wire_type
from robot_runner.ros.qos_policies import KEPT

DOMAIN = claim_domain()
STRING, PLACE, TWIST = "std_msgs/String", "lab_msgs/Place", "geometry_msgs/Twist"


def other_node(**options):
    chosen = {"domain": DOMAIN, "gid_bytes": 16, "reliable": True, "type_hashes": True, "tells_service": True}
    return OtherNode("bare_node.py", json.dumps(chosen | options))


@pytest.fixture(autouse=True)
def _loopback(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setattr("robot_runner.ros.dds_session.FINDING", 0.0)  # all are discovered within milliseconds here
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


@pytest.fixture
def closing():
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def other(closing):
    def start(**options):
        node = other_node(**options)
        closing.callback(node.close)
        return node

    return start


@pytest.fixture
def link(closing):
    def opened(**options):
        made = open_dds_link({"domain": str(DOMAIN)} | options, SystemClock())
        closing.callback(made.close)
        return made

    return opened


@pytest.mark.long
def test_a_node_that_is_no_link_hears_is_heard_and_answers(other, link):
    node, mine = other(), link()
    assert mine.wait_for("chatter", STRING, timeout=60.0) == {"data": "hello"}
    assert mine.call("lamp", "std_srvs/SetBool", {"data": True}) == {"success": True, "message": "lamp is True"}
    mine.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.25}})
    assert node.until(lambda fact: "velocity" in fact) == {"velocity": 0.25}


@pytest.mark.long
@pytest.mark.parametrize("others", ["nobody", "a node", "a listener of ours"])
def test_a_robot_that_is_discovered_late_is_sent_the_first_command(link, monkeypatch, others):
    """As one of Fast DDS on an interface without multicast: each announces itself every 3 s, in its own time."""
    monkeypatch.setattr(dds_session, "SETTLING", 0.1)
    domain, heard = {"domain": str(claim_domain()), "distro": "jazzy"}, []
    mine = link(**domain)
    if others != "nobody":  # such as a recorder, and the watch for others that command the robot
        topic, listener = ("odom", link(**domain)) if others == "a node" else ("cmd_vel", mine)
        listener.subscribe(topic, TWIST, lambda _: None)
        wait_until(lambda: mine.subscribers(topic))
    monkeypatch.setattr(dds_session, "FINDING", PATIENCE)
    publishing = threading.Thread(target=mine.publish, args=("cmd_vel", TWIST, {"linear": {"x": 0.25}}))
    publishing.start()
    publishing.join(10 * dds_session.SETTLING)
    assert publishing.is_alive(), "it is published before there is a robot"
    link(**domain).subscribe("cmd_vel", TWIST, heard.append)
    publishing.join(PATIENCE)
    assert wait_until(lambda: heard)[0]["linear"]["x"] == 0.25


@pytest.mark.long
def test_a_topic_is_reached_only_where_every_subscriber_is_connected(link, monkeypatch):
    mine, heard = link(), []
    for _ in range(2):
        link().subscribe("cmd_vel", TWIST, heard.append)
    wait_until(lambda: len(mine.subscribers("cmd_vel")) == 2 and mine.advertise("cmd_vel", TWIST))
    connected = dds_transport.matched_subscriptions
    monkeypatch.setattr(dds_transport, "matched_subscriptions", lambda writer: connected(writer)[:1])
    assert not mine.advertise("cmd_vel", TWIST)


@pytest.mark.long
def test_a_robot_that_is_gone_holds_up_the_stop_of_no_other(link, monkeypatch):
    monkeypatch.setattr(dds_session, "SETTLING", 0.1)
    monkeypatch.setattr(dds_session, "FINDING", PATIENCE)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.2)
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.5)
    domain, heard = {"domain": str(claim_domain()), "distro": "jazzy"}, []
    link(**domain).subscribe("bob/cmd_vel", TWIST, heard.append)
    robots = [("/alice/cmd_vel", TWIST), ("/bob/cmd_vel", TWIST)]
    stopping = threading.Thread(target=keep_commanding_zero, args=(link(**domain), robots))
    stopping.start()
    wait_until(lambda: heard, "it waits for alice", seconds=PATIENCE / 2)
    stopping.join(PATIENCE)


_FORKED = """
import os, sys
from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link
link = open_dds_link({"domain": sys.argv[1]}, SystemClock())
if not (pid := os.fork()):
    try:
        open_dds_link({"domain": sys.argv[1]}, SystemClock())
    except LinkError as error:
        print(error, flush=True)
    os._exit(0)
os.waitpid(pid, 0)
link.close()
if not (pid := os.fork()):
    open_dds_link({"domain": sys.argv[1]}, SystemClock()).close()
    print("joined", flush=True)
    os._exit(0)
os.waitpid(pid, 0)
"""


@pytest.mark.long
def test_a_run_that_was_forked_beside_an_open_link_is_told_so_instead_of_waiting_for_ever():
    command = [sys.executable, "-W", "ignore", "-c", _FORKED, str(DOMAIN)]
    told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=PATIENCE).stdout.splitlines()
    assert "a link over dds was open as this process was forked" in told[0]
    assert told[-1] == "joined"


@pytest.mark.long
def test_a_service_that_nobody_can_understand_is_given_up_at_the_deadline(other, link):
    # It tells no identity, as those of Fast DDS, but expects the header of rmw_cyclonedds all the same.
    other(tells_service=False, gid_bytes=24, type_hashes=False)
    begun = time.monotonic()
    with pytest.raises(LinkError, match="does not answer within 2 s"):
        link().call("lamp", "std_srvs/SetBool", {"data": True}, timeout=2.0)
    assert time.monotonic() - begun < 20.0
    need = GraphNeed.service("/lamp", "std_srvs/SetBool")
    assert graph_look.look_at(RobotName.parse(f"dds:domain={DOMAIN}"), {"plugin Lamp": [need]}) == []


def test_what_is_awaited_before_a_service_is_called_counts_as_time_of_the_call(other, link, monkeypatch):
    other()
    mine = link()
    assert mine.call("lamp", "std_srvs/SetBool", {"data": True}, timeout=60.0)["success"]
    await_service = dds_transport.await_service

    def await_long(session, service, service_type, until):
        await_service(session, service, service_type, until)
        time.sleep(0.3)

    monkeypatch.setattr(dds_transport, "await_service", await_long)
    with pytest.raises(LinkError, match=r"does not answer within 0\.2 s"):
        mine.call("lamp", "std_srvs/SetBool", {"data": True}, timeout=0.2)


def test_the_graph_shows_the_other_node_and_the_other_node_this_one(other, link):
    node, mine = other(), link()
    mine.subscribe("chatter", STRING, lambda _: None)
    fact = node.until(lambda fact: fact.get("endpoints") == 1)
    assert fact["node"].startswith("/robot_runner_")
    assert set(mine.nodes()) == {"/lamp_node", fact["node"]}
    assert mine.topics() == {"/chatter": STRING, "/cmd_vel": "geometry_msgs/Twist"}
    assert mine.services() == {"/lamp": "std_srvs/SetBool"}


def test_a_subscriber_that_goes_while_it_is_to_acknowledge_is_not_said_to_be_reached(link, monkeypatch):
    mine, robot = link(), link()
    robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda message: None)
    wait_until(lambda: mine.advertise("cmd_vel", "geometry_msgs/Twist"), "they have discovered each other")
    kind = dds_transport._Publisher
    is_acknowledged = kind._is_acknowledged

    def goes_meanwhile(self, seconds):
        robot.close()
        wait_until(lambda: not dds_transport.matched_subscriptions(self._writer), "it counts as gone")
        return is_acknowledged(self, seconds)

    monkeypatch.setattr(kind, "_is_acknowledged", goes_meanwhile)
    assert not mine.advertise("cmd_vel", "geometry_msgs/Twist")


def test_a_car_that_was_driven_is_commanded_to_stand_still_as_the_link_is_closed(link, tmp_path):
    folder = tmp_path / "ackermann_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "AckermannDrive.msg").write_text("float32 steering_angle\nfloat32 speed\n")
    car, mine = (link(distro="jazzy", types=str(tmp_path)) for _ in range(2))
    heard = []
    car.subscribe("drive", "ackermann_msgs/AckermannDrive", lambda message: heard.append(message["speed"]))
    wait_until(lambda: mine.advertise("drive", "ackermann_msgs/AckermannDrive"), "the car is found")
    mine.publish("drive", "ackermann_msgs/AckermannDrive", {"speed": 1.0})
    mine.close()
    wait_until(lambda: heard == [1.0, 0.0])
    with pytest.raises(LinkError, match="is inf"):
        link(distro="jazzy", types=str(tmp_path)).publish(
            "drive", "ackermann_msgs/AckermannDrive", {"speed": float("inf")}
        )


@pytest.fixture
def with_place(link, tmp_path):
    """Open a link that knows lab_msgs/Place by this definition."""

    def opened(name, definition):
        folder = tmp_path / name / "lab_msgs" / "msg"
        folder.mkdir(parents=True)
        (folder / "Place.msg").write_text(f"{definition}\n")
        return link(distro="jazzy", types=str(tmp_path / name))

    return opened


def test_another_version_of_a_type_is_refused_as_its_values_would_be_taken_for_others(with_place):
    robot, mine = with_place("theirs", "float64 y\nfloat64 x"), with_place("ours", "float64 x\nfloat64 y")
    robot.publish("place", PLACE, {"x": 1.0, "y": 2.0})
    wait_until(lambda: "/place" in mine.topics())
    for use in (partial(mine.subscribe, callback=print), partial(mine.subscribe_raw, callback=print), mine.advertise):
        with pytest.raises(LinkError, match="another version of lab_msgs/Place than the one that is known") as refused:
            use("place", PLACE)
        assert "types=" in refused.value.fix


def test_a_comment_makes_no_other_version_of_a_type(with_place):
    robot, mine = with_place("theirs", "float64 x  # m\nfloat64 y"), with_place("ours", "float64 x\nfloat64 y")
    robot.publish("place", PLACE, {"x": 1.0, "y": 2.0}, qos=Qos.TRANSIENT_LOCAL)
    assert mine.wait_for("place", PLACE, timeout=60.0) == {"x": 1.0, "y": 2.0}


def test_a_publisher_of_another_version_that_comes_later_ends_what_is_believed_of_its_topic(with_place, monkeypatch):
    other, robot = with_place("theirs", "float64 y\nfloat64 x"), with_place("same", "float64 x\nfloat64 y")
    mine, heard = with_place("ours", "float64 x\nfloat64 y"), []
    mine.subscribe("place", PLACE, heard.append)
    monkeypatch.setattr(dds_transport, "_check_types", lambda *_: None)  # it is of no link
    wait_until(lambda: not robot.publish("place", PLACE, {"x": 1.0}) and heard)
    other.publish("place", PLACE, {"x": 1.0})
    (subscription,) = mine._transport._subscriptions
    wait_until(lambda: subscription.misfit)
    wait_until(lambda: not robot.publish("place", PLACE, {"x": 3.0}) and mine._first_fault)
    with pytest.raises(LinkError, match="another version of lab_msgs/Place"):
        mine.close()


@pytest.mark.long
def test_a_node_that_is_gone_is_shown_no_more(other, link):
    node, mine = other(), link()
    assert "/lamp_node" in mine.nodes()
    node.close()
    deadline = time.monotonic() + 60.0
    while "/lamp_node" in mine.nodes():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert "/chatter" not in mine.topics()


def test_humble_is_told_by_its_want_of_type_hashes(other, link):
    node, mine = other(gid_bytes=24, type_hashes=False), link()
    assert "/lamp_node" in mine.nodes()
    mine.subscribe("chatter", STRING, lambda _: None)
    assert node.until(lambda fact: "node" in fact and fact["node"] != "/lamp_node")


@pytest.mark.long
def test_a_link_that_has_opened_nothing_shows_no_node_and_is_nobody_else(other, link):
    idle, mine = link(), link()
    mine.subscribe("chatter", STRING, lambda _: None)
    _await(lambda: [name[:14] for name in idle.nodes()] == ["/robot_runner_"])
    with pytest.raises(LinkError) as raised:
        idle.wait_for("nothing", STRING, timeout=0.1)
    assert "Nobody else" not in raised.value.fix  # mine is there, and shows its node
    mine.close()
    idle_too = link()
    _await(lambda: list(idle_too.nodes()) == [])
    with pytest.raises(LinkError) as raised:
        idle_too.wait_for("nothing", STRING, timeout=0.1)
    assert "No other participant is on domain" in raised.value.fix
    idle.publish("chatter", STRING, {"data": "hello"})
    other()
    _await(lambda: "/lamp_node" in idle.nodes())


def _await(is_so, timeout=60.0):
    deadline = time.monotonic() + timeout
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.long
def test_the_distribution_can_be_named(other, link):
    other(gid_bytes=24, type_hashes=False)
    assert "/lamp_node" in link(distro="humble").nodes()


@pytest.mark.long
def test_a_qos_that_the_publisher_does_not_offer_is_an_error_that_names_the_policy(other, link):
    other(reliable=False)
    mine = link()
    with pytest.raises(LinkError, match="reliability: it is published best effort, and subscribed reliable"):
        mine.subscribe("chatter", STRING, lambda _: None, qos=Qos.RELIABLE)
    with pytest.raises(LinkError, match="best effort"):
        mine.subscribe("chatter", STRING, lambda _: None, qos=Qos.TRANSIENT_LOCAL)
    assert mine.wait_for("chatter", STRING, timeout=60.0) == {"data": "hello"}


@pytest.mark.long
def test_a_volatile_publisher_is_not_heard_transient_local(other, link):
    other()
    mine = link()
    with pytest.raises(LinkError, match="durability: it is published volatile, and subscribed transient local"):
        mine.subscribe("chatter", STRING, lambda _: None, qos=Qos.TRANSIENT_LOCAL)


def test_a_subscriber_that_asks_for_more_than_is_published_is_an_error_that_names_the_policy(other, link):
    node, mine = other(), link()
    with pytest.raises(LinkError, match="reliability: it is published best effort, and subscribed reliable"):
        mine.publish("cmd_vel", "geometry_msgs/Twist", {}, qos=Qos.SENSOR_DATA)
    mine.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.5}})
    assert node.until(lambda fact: "velocity" in fact) == {"velocity": 0.5}


def test_a_robot_is_stopped_that_is_discovered_later_than_a_subscriber_that_asks_for_more(link):
    base, mine, heard = link(distro="jazzy"), link(distro="jazzy"), []
    base.subscribe("cmd_vel", "geometry_msgs/Twist", print, qos=Qos.TRANSIENT_LOCAL)
    _await(lambda: mine.subscribers("cmd_vel"))
    mine.publish("cmd_vel", "geometry_msgs/Twist", {})  # which nobody can receive yet
    base.subscribe("cmd_vel", "geometry_msgs/Twist", heard.append)
    _await(lambda: heard or mine.publish("cmd_vel", "geometry_msgs/Twist", {}))


@pytest.mark.parametrize(
    ("asked", "problem"),
    [
        (Policy.Deadline(500_000_000), "deadline: messages are to be at most 0.5 s apart, which is not promised"),
        (Policy.Liveliness.ManualByTopic(10**9), "liveliness: the publisher is to keep telling that it is alive"),
    ],
)
def test_a_subscriber_that_asks_for_a_deadline_or_liveliness_is_an_error_that_names_it(link, asked, problem):
    base, mine = link(distro="jazzy"), link(distro="jazzy")
    mine.advertise("late", "std_msgs/String")
    session = base._transport._session
    wire_type = topic_wire_type(session.types.shape("std_msgs/String"))
    plain = reader_profile(Qos.DEFAULT, session.type_hash("std_msgs/String"))
    readers = []
    for topic in ("early", "late"):
        mine.subscribe(topic, "std_msgs/String", print)  # as who watches for rivals does
        readers.append(session.reader(f"rt/{topic}", wire_type, DdsQos(*plain, asked)))
        _await(lambda topic=topic: any(not each.is_own for each in mine.subscribers(topic)))
        with pytest.raises(LinkError, match=problem):
            mine.advertise(topic, "std_msgs/String")


def test_a_topic_of_another_type_is_an_error_that_names_both(other, link):
    other()
    mine = link()
    with pytest.raises(LinkError, match="carries std_msgs/String, not std_msgs/Int32") as caught:
        mine.wait_for("chatter", "std_msgs/Int32", timeout=30.0)
    assert caught.value.where == "/chatter"
    with pytest.raises(LinkError, match="is of the type std_srvs/SetBool, not std_srvs/Trigger"):
        mine.call("lamp", "std_srvs/Trigger", timeout=30.0)


def test_on_another_domain_nobody_is_there_and_the_error_says_so(other, closing):
    other()
    domain = claim_domain()
    mine = open_dds_link({"domain": str(domain), "distro": "jazzy"}, SystemClock())
    closing.callback(mine.close)
    with pytest.raises(LinkError, match=f"No other participant is on domain {domain}"):
        mine.wait_for("chatter", STRING, timeout=0.2)
    with pytest.raises(LinkError, match=f"No other participant is on domain {domain}"):
        mine.call("lamp", "std_srvs/SetBool", {"data": True}, timeout=0.2)


def test_the_domain_of_the_environment_is_taken(other, closing, monkeypatch):
    other()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    mine = open_dds_link({}, SystemClock())
    closing.callback(mine.close)
    assert mine.wait_for("chatter", STRING, timeout=60.0) == {"data": "hello"}


def test_a_subscription_that_was_there_first_adapts_to_its_publisher(link):
    hearing, speaking = link(distro="jazzy"), link(distro="jazzy")
    heard = []
    hearing.subscribe("map_name", STRING, heard.append)
    speaking.publish("map_name", STRING, {"data": "arena"}, qos=Qos.TRANSIENT_LOCAL)
    deadline = time.monotonic() + 60.0
    while not heard:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    late = []
    link(distro="jazzy").subscribe("map_name", STRING, late.append)
    while not late:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert heard == late == [{"data": "arena"}]


def test_a_publisher_that_is_discovered_while_its_topic_is_subscribed_is_adapted_to(link, monkeypatch):
    listening, speaking = link(), link()
    check_offers = dds_transport._Subscription._check_offers

    def check_and_discover(subscription):
        check_offers(subscription)
        speaking.publish("map_name", STRING, {"data": "hall"}, qos=Qos.TRANSIENT_LOCAL)
        deadline = time.monotonic() + 60.0
        while not listening.publishers("map_name"):
            assert time.monotonic() < deadline
            time.sleep(0.01)

    monkeypatch.setattr(dds_transport._Subscription, "_check_offers", check_and_discover)
    heard = queue.SimpleQueue()
    listening.subscribe("map_name", STRING, heard.put)
    assert heard.get(timeout=60.0) == {"data": "hall"}


def test_a_callback_may_call_and_wait(other, link):
    other()
    mine = link()
    answers = []

    def hear(_):
        if not answers:
            answers.append(mine.call("lamp", "std_srvs/SetBool", {"data": False}))
            answers.append(mine.wait_for("chatter", STRING, timeout=60.0))

    mine.subscribe("chatter", STRING, hear)
    deadline = time.monotonic() + 60.0
    while len(answers) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert answers == [{"success": True, "message": "lamp is False"}, {"data": "hello"}]


def test_who_was_woken_rests_again_also_where_a_turn_comes_in_the_middle_of_it(monkeypatch):
    class Guard:
        def __init__(self, participant):
            self.is_set = False

        def set(self, is_set):
            if is_set:
                reception._turn(0)
            self.is_set = is_set

    class Waiting:
        def __init__(self, participant):
            pass

        def attach(self, condition):
            pass

        def wait(self, timeout_ns):
            return 1

    monkeypatch.setattr(dds_reception, "GuardCondition", Guard)
    monkeypatch.setattr(dds_reception, "WaitSet", Waiting)
    reception = dds_reception.Reception(None)
    reception.wake()
    assert reception._guard.is_set
    reception._turn(0)
    assert not reception._guard.is_set, "the thread would turn without rest"


def test_a_link_leaves_no_thread_behind(link):
    mine = link(distro="jazzy")
    mine.close()
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("dds")]


def test_types_come_from_the_user_s_files(link, tmp_path):
    definition = tmp_path / "my_robot" / "msg" / "Wheel.msg"
    definition.parent.mkdir(parents=True)
    definition.write_text("float32 speed\nstring[<=2] names\n")
    speaking, hearing = (link(distro="jazzy", types=str(tmp_path)) for _ in range(2))
    heard = []
    hearing.subscribe("wheel", "my_robot/Wheel", heard.append)
    deadline = time.monotonic() + 60.0
    while not heard:
        speaking.publish("wheel", "my_robot/Wheel", {"speed": 0.5, "names": ["left"]})
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert heard[0] == {"speed": 0.5, "names": ["left"]}


def test_a_callback_may_close_the_link_and_its_thread_does_not_trip_over_what_is_gone(closing):
    robot, link = (open_dds_link({"domain": str(DOMAIN)}, SystemClock()) for _ in range(2))
    closing.callback(robot.close)
    faults, ended = [], threading.Event()
    receiving = [thread for thread in threading.enumerate() if thread.name == "dds reception"]
    closing.callback(setattr, threading, "excepthook", threading.excepthook)
    threading.excepthook = faults.append

    def leave(_):
        link.close()
        ended.set()

    link.subscribe("farewell", STRING, leave)
    deadline = time.monotonic() + 60.0
    while not ended.wait(0.05):
        robot.publish("farewell", STRING, {"data": "a"})
        assert time.monotonic() < deadline
    while sum(thread.is_alive() for thread in receiving) > len(receiving) - 1:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert [str(fault.exc_value) for fault in faults] == []


def test_a_subscription_that_is_closed_while_it_adapts_to_a_publisher_leaves_no_reader(closing, monkeypatch):
    robot, link = (open_dds_link({"domain": str(DOMAIN)}, SystemClock()) for _ in range(2))
    for each in (robot, link):
        closing.callback(each.close)
    reading, drain, ended, adapted = dds_transport._Subscription._reading, dds_reception.Reception.drain, [], []

    def noted(self):
        ended.append(reading(self))
        return ended[-1]

    def closed_meanwhile(self, source):  # as another thread may, between the new reader and its taking over
        drain(self, source)
        thread = threading.Thread(target=subscription.close)
        thread.start()
        thread.join()
        adapted.append(source)

    monkeypatch.setattr(dds_transport._Subscription, "_reading", noted)
    monkeypatch.setattr(dds_reception.Reception, "drain", closed_meanwhile)
    faults = []
    monkeypatch.setattr(threading, "excepthook", faults.append)
    subscription = link.subscribe("farewell", STRING, lambda _: None)
    deadline = time.monotonic() + 60.0
    while not adapted or any(source.is_open for source in ended):
        robot.publish("farewell", STRING, {"data": "a"}, qos=Qos.TRANSIENT_LOCAL)
        assert time.monotonic() < deadline, (adapted, ended, faults)
        time.sleep(0.01)
    assert len(ended) == 2
    assert faults == []


@pytest.mark.long
@pytest.mark.parametrize(("qos", "is_told"), [(None, True), (Qos.DEFAULT, False)])
def test_messages_that_callbacks_are_too_slow_for_are_not_dropped_without_a_word(link, qos, is_told):
    """Of 543,669 messages 4,006 came, and nobody knew; with a profile of one's own, dropping is what it says."""
    robot, is_busy, released, heard, failures = link(), threading.Event(), threading.Event(), [], []
    mine = open_dds_link({"domain": str(DOMAIN)}, SystemClock())

    def wait(message):
        is_busy.set()
        released.wait(60.0)
        heard.append(message["data"])

    publisher = robot._transport.advertise("/chatter", STRING, Qos.RELIABLE)
    mine.subscribe("chatter", STRING, wait, qos=qos)  # as reliable as it is published
    wait_until(publisher.is_heard)
    with fails_run(lambda error, where: failures.append((str(error), where))):
        publisher.publish({"data": "the first one"})
        assert is_busy.wait(60.0)
        for _ in range(KEPT + 300):
            publisher.publish({"data": "a"})
        publisher.publish({"data": "the last one"})
        publisher.flush(20.0)
        released.set()
        wait_until(lambda: heard[-1:] == ["the last one"])
    told = "/chatter: callbacks are too slow: 1,000 messages waited for them, and more may be lost"
    assert [(told in error, where) for error, where in failures] == [(True, "the callback of /chatter")] * is_told
    mine.close()
    publisher.close()
