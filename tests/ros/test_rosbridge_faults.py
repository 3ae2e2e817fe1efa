"""What goes wrong with a rosbridge is an error with cause and remedy, within its deadline."""

from __future__ import annotations

import itertools
import math
import os
import socket
import threading
import time
from contextlib import ExitStack, closing, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import SimpleNamespace

import pytest
from tests.processor_wait import ProcessorWait

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import command_for_certain, keep_commanding_zero, zero_first
from robot_runner.core.links.robot import Encoding, Qos
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros import rosbridge_frames, rosbridge_session, rosbridge_transport, rosbridge_types
from robot_runner.ros.graph_addresses import RosbridgeAddress
from robot_runner.ros.graph_links import ROSBRIDGE
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.ros.shapes import completed
from robot_runner.ros.turtlebot3.motion import Wheels
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.ros.watchdog import velocity_of
from robot_runner.testing import FakeClock, RosbridgeServer

STRING = "std_msgs/String"
TRIGGER = "std_srvs/Trigger"


def linked(server, query=""):
    return open_rosbridge_link(server.url + query, SystemClock())


@pytest.fixture
def server():
    with closing(RosbridgeServer()) as served:
        yield served


def until(claim):
    deadline = time.monotonic() + 60.0
    while not claim():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_nobody_at_the_port_is_said():
    with closing(socket.socket()) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        with pytest.raises(LinkError, match="connection refused") as caught:
            open_rosbridge_link(f"rosbridge://127.0.0.1:{port}", SystemClock())
    assert "rosbridge_server" in caught.value.fix


@pytest.mark.parametrize("scheme", ["rosbridge", "rosbridge+tls"])
@pytest.mark.parametrize("host", ["no-such-robot.invalid", "robot..lab"])
def test_an_unknown_host_is_said(scheme, host):
    with pytest.raises(LinkError, match=f"'{host}' is not known"):
        open_rosbridge_link(f"{scheme}://{host}:9090", SystemClock())


@pytest.mark.parametrize("host", ["robot:0", "::1:9090"])
def test_what_cannot_be_an_address_is_said(host):
    with pytest.raises(LinkError, match="cannot be the address of a rosbridge") as caught:
        RosbridgeAddress.parse(f"rosbridge://{host}")
    assert "rosbridge://[fd00::7]:9090 (IPv6)" in caught.value.fix


def test_a_web_server_is_no_rosbridge():
    web = HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    serving = threading.Thread(target=web.handle_request)
    serving.start()
    try:
        with pytest.raises(LinkError, match="not a rosbridge"):
            open_rosbridge_link(f"rosbridge://127.0.0.1:{web.server_port}", SystemClock())
    finally:
        serving.join()
        web.server_close()


@pytest.mark.parametrize("name", ["rosbridge://", "rosbridge://robot:port", "rosbridge://robot?host=a"])
def test_a_malformed_address_is_a_finding(name):
    (finding,) = ROSBRIDGE.findings(RobotName.parse(name))
    assert finding.is_error
    assert finding.fix


def test_a_distribution_of_the_other_generation_is_a_finding():
    (finding,) = ROSBRIDGE.findings(RobotName.parse("rosbridge://robot?ros=1&distro=humble"))
    assert "humble" in finding.problem


def test_a_wait_ends_when_the_connection_is_lost(server):
    with closing(linked(server)) as link:
        threading.Timer(0.2, server.drop_connections).start()
        begun, wait = time.monotonic(), ProcessorWait([os.getpid()])
        with pytest.raises(LinkError, match="connection is lost"):
            link.wait_for("odom", "nav_msgs/Odometry", timeout=60.0)
        wait.look()
        assert time.monotonic() - begun - wait.seconds < 5.0
        with pytest.raises(LinkError, match="connection is lost"):
            link.publish("cmd_vel", "geometry_msgs/Twist", {})


def test_a_call_ends_when_the_connection_is_lost(server):
    server.offer("/last", TRIGGER, lambda _: server.drop_connections() or {})
    with closing(linked(server)) as link, pytest.raises(LinkError, match="connection is lost"):
        link.call("last", TRIGGER, timeout=60.0)


def test_a_type_that_the_robot_has_not_installed_is_refused(server, tmp_path):
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Lamp.msg").write_text("bool on\n")
    with closing(linked(server, f"?types={tmp_path}")) as link:
        with pytest.raises(LinkError, match="does not take the publisher of type my_robot/Lamp") as caught:
            link.publish("lamp", "my_robot/Lamp", {"on": True})
        assert "'my_robot'" in caught.value.fix


@pytest.mark.parametrize(
    ("kind", "use"),
    [
        ("publisher", lambda link: link.publish("lamp", "my_robot/Lamp", {"on": True})),
        ("subscription", lambda link: link.subscribe("lamp", "my_robot/Lamp", print)),
    ],
)
def test_a_type_that_only_the_robots_own_node_has_installed_is_refused(server, tmp_path, monkeypatch, kind, use):
    # The topic is there with its type, as the node uses it; a server that lacks the package tells only its log.
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Lamp.msg").write_text("bool on\n")
    answer, of_the_node = server._rosapi.answer, ["/lamp_driver"]
    told = {
        "/rosapi/topics": {"topics": ["/lamp"], "types": ["my_robot/Lamp"]},
        "/rosapi/topic_type": {"type": "my_robot/Lamp"},
        "/rosapi/publishers": {"publishers": of_the_node},
        "/rosapi/subscribers": {"subscribers": of_the_node},
    }
    monkeypatch.setattr(server._rosapi, "answer", lambda service, asked: told.get(service) or answer(service, asked))
    with (
        closing(linked(server, f"?types={tmp_path}")) as link,
        pytest.raises(LinkError, match=f"does not take the {kind} of type my_robot/Lamp"),
    ):
        use(link)


@pytest.mark.parametrize(
    ("question", "not_yet", "ask"),
    [
        ("topic_type", {"type": ""}, lambda link: link.publish("chatter", STRING, {"data": "a"})),
        ("subscribers", {"subscribers": []}, lambda link: link.subscribe("chatter", STRING, print)),
        ("service_type", {"type": ""}, lambda link: link.offer("lamp", TRIGGER, lambda _: {})),
    ],
    ids=["publisher", "subscription", "service"],
)
def test_a_rosbridge_that_confirms_late_is_waited_for_until_it_does(server, monkeypatch, question, not_yet, ask):
    monkeypatch.setattr(rosbridge_types, "_CONFIRMATION", 60.0)
    answer, looks = server._rosapi.answer, itertools.count(1)

    def lagging(service, request):
        if service == f"/rosapi/{question}" and next(looks) <= 5:
            return not_yet
        return answer(service, request)

    monkeypatch.setattr(server._rosapi, "answer", lagging)
    with closing(linked(server)) as link:
        begun, wait = time.monotonic(), ProcessorWait([os.getpid()])
        ask(link)
        wait.look()
        assert next(looks) == 7
        assert time.monotonic() - begun - wait.seconds < 5.0


def test_an_answer_that_comes_after_its_deadline_is_not_taken_for_the_next_one(server):
    asked, released = [], threading.Event()

    def answer(_):
        asked.append(released.wait(60.0))
        return {"success": True, "message": f"answer {len(asked)}"}

    server.offer("/lamp", TRIGGER, answer)
    with closing(linked(server)) as link:
        try:
            with pytest.raises(LinkError, match="does not answer within"):
                link.call("lamp", TRIGGER, timeout=0.1)
        finally:
            released.set()
        assert link.call("lamp", TRIGGER, timeout=60.0)["message"] == "answer 2"


def test_a_status_message_is_the_error():
    with (
        closing(RosbridgeServer(has_rosapi=False, tells=True)) as server,
        closing(linked(server, "?ros=1")) as link,
        closing(linked(server, "?ros=1")) as other,
    ):
        link.publish("chatter", STRING, {"data": "a"})
        with pytest.raises(LinkError, match="already established with type std_msgs/String"):
            other.publish("chatter", "std_msgs/Int32", {"data": 1})


def test_without_rosapi_the_graph_cannot_be_listed():
    with closing(RosbridgeServer(has_rosapi=False)) as server:
        server._rosapi.nodes[0] = "/bridge"
        with pytest.raises(LinkError, match="which generation") as caught:
            linked(server)
        assert "?ros=1" in caught.value.fix
        with closing(linked(server, "?ros=1")) as link:
            with pytest.raises(LinkError, match="rosapi does not answer"):
                link.topics()
            server.offer("/lamp", TRIGGER, lambda _: {"success": True})
            assert link.call("lamp", TRIGGER)["success"]


@pytest.mark.parametrize("generation", [1, 2])
def test_without_rosapi_the_server_s_own_node_tells_the_generation(generation):
    with closing(RosbridgeServer(generation=generation, has_rosapi=False)) as server, closing(linked(server)) as link:
        assert link.encoding is server.encoding


@pytest.mark.parametrize(("generation", "said"), [(1, "?ros=2"), (2, "?ros=1"), (2, "?distro=noetic")])
def test_an_address_that_says_the_other_generation_is_refused_at_once(generation, said):
    with closing(RosbridgeServer(generation=generation, has_rosapi=False)) as server:
        with pytest.raises(LinkError, match=f"says ROS {3 - generation}, and its rosbridge is one of ROS {generation}"):
            linked(server, said)
        with closing(linked(server, f"?ros={generation}")) as link:
            assert link.encoding is (Encoding.ROS1 if generation == 1 else Encoding.CDR)


@pytest.mark.parametrize("generation", [1, 2])
def test_a_robot_is_stopped_and_reached_anew_while_rosapi_hangs(generation, monkeypatch):
    with closing(RosbridgeServer(generation=generation)) as server, closing(linked(server)) as robot:
        heard = []
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda message: heard.append(message["linear"]["x"]))
        link = linked(server)
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        until(lambda: heard == [0.2])
        monkeypatch.setattr(rosbridge_types, "ANSWER", 0.3)
        server._rosapi.hangs = True
        with pytest.raises(LinkError, match="rosapi does not answer: the service does not answer within"):
            link.publishers("odom")
        link.close()
        until(lambda: heard == [0.2, 0.0])
        with closing(linked(server)) as standby:  # as after a run that was killed
            standby.publish("cmd_vel", "geometry_msgs/Twist", {})
        until(lambda: heard[2:] == [0.0, 0.0])
        server._rosapi.hangs = False


@pytest.mark.parametrize("hanging", ["rosapi", "every service"])
@pytest.mark.parametrize("generation", [1, 2])
def test_zero_is_commanded_before_anything_is_asked_of_what_may_hang(generation, hanging, monkeypatch):
    """As by who stands by for a dead run: the first command came after three deadlines of rosapi, 6 s."""
    driven = [("/cmd_vel", "geometry_msgs/Twist")]
    with closing(RosbridgeServer(generation=generation)) as server, closing(linked(server)) as robot:
        heard, asked, call = [], [], server.call
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda message: heard.append(message["linear"]["x"]))

        def hang(caller, number, service, request):
            asked.append(service)
            if hanging == "every service" or service.startswith("/rosapi/"):
                until(lambda: heard)  # it answers nothing before the robot stands still
                caller.asking.add(str(number))
            else:
                call(caller, number, service, request)

        monkeypatch.setattr(server, "call", hang)
        for patience in ("ANSWER", "_HANGING"):  # that of rosapi: nobody has it now, as goals are to be cancelled, too
            monkeypatch.setattr(rosbridge_types, patience, 3600.0)
        monkeypatch.setattr(rosbridge_types, "_IMPATIENCE", 0.1)
        monkeypatch.setattr(rosbridge_session, "ANSWER", 0.3 if hanging == "every service" else 5.0)
        monkeypatch.setattr(commanded_topics, "_TELLING", 0.0)
        monkeypatch.setattr(rosbridge_transport, "_CONNECTING", 0.0)
        monkeypatch.setattr(commanded_topics, "_REACHING", 0.0)
        with zero_first(driven), ExitStack() as left:
            if hanging == "every service":
                with pytest.raises(LinkError, match="what listens there does not answer"):
                    linked(server)
            else:
                link = left.enter_context(closing(linked(server)))
                (doubt,) = keep_commanding_zero(link, driven)
                assert "its subscribers are not known: the graph cannot be listed, because rosapi" in doubt
        assert asked
        assert set(heard) == {0.0}


@pytest.mark.long
def test_a_slow_rosapi_that_alone_tells_the_generation_is_waited_for_by_who_stops_a_robot(server, monkeypatch):
    server._rosapi.nodes[0] = "/bridge"
    call = server.call

    def hesitate(*asked):
        time.sleep(0.1)
        call(*asked)

    monkeypatch.setattr(server, "call", hesitate)
    monkeypatch.setattr(rosbridge_types, "_IMPATIENCE", 0.01)
    with zero_first([("/cmd_vel", "geometry_msgs/Twist")]), closing(linked(server)) as link:
        assert link.encoding is server.encoding


@pytest.mark.long
def test_a_command_goes_out_although_rosapi_begins_to_hang_while_it_confirms_the_publisher(server, monkeypatch):
    call = server.call

    def hang(caller, number, service, request):
        if service == "/rosapi/publishers":
            caller.asking.add(str(number))
        else:
            call(caller, number, service, request)

    monkeypatch.setattr(server, "call", hang)
    with closing(linked(server)) as robot, closing(linked(server)) as link:
        heard = []
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", heard.append)
        monkeypatch.setattr(rosbridge_types, "ANSWER", 0.1)
        link.publish("cmd_vel", "geometry_msgs/Twist", {})
        until(lambda: heard)


def test_a_connection_that_is_lost_as_zero_is_commanded_first_leaves_no_thread(server, monkeypatch):
    def lose(session):
        raise LinkError("the connection is lost", where=session.where)

    monkeypatch.setattr(rosbridge_session.Session, "command_zero_first", lose)
    with pytest.raises(LinkError, match="the connection is lost"):
        linked(server)
    assert not [each for each in threading.enumerate() if each.name == "rosbridge pings"]


def test_what_a_server_publishes_is_told_to_be_that_of_all_its_clients():
    with closing(RosbridgeServer()) as server, closing(linked(server)) as planner, closing(linked(server)) as link:
        planner.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        assert [(each.is_own, each.is_shared) for each in link.publishers("cmd_vel")] == [(True, True)]


def test_the_wheels_of_a_robot_are_stopped_by_the_type_that_was_commanded_once_rosapi_has_ended():
    stamped = "geometry_msgs/TwistStamped"
    with closing(RosbridgeServer(generation=2)) as server, closing(linked(server)) as robot:
        heard = []
        robot.subscribe("cmd_vel", stamped, lambda message: heard.append(message["twist"]["linear"]["x"]))
        with closing(linked(server)) as link:
            link.publish("cmd_vel", stamped, {"twist": {"linear": {"x": 0.2}}})
            until(lambda: heard == [0.2])
            server._rosapi.has_ended = True
            with pytest.raises(LinkError, match="rosapi does not answer"):
                link.subscribers("cmd_vel")
            Wheels(link).command(0.0, 0.0)  # of another part, or of who stands by for a process that died
            until(lambda: heard == [0.2, 0.0])
            with pytest.raises(LinkError, match="rosapi does not answer"):
                Wheels(link, topic="base/cmd_vel").command(0.0, 0.0)


def test_the_wheels_of_a_robot_that_restarts_are_stopped_by_the_type_that_was_commanded():
    stamped, topic, heard = "geometry_msgs/TwistStamped", "restarted/cmd_vel", []

    def started(server):
        robot = linked(server)
        robot.subscribe(topic, stamped, lambda message: heard.append(message["twist"]["linear"]["x"]))
        return robot

    with closing(RosbridgeServer(generation=2)) as server, closing(linked(server)) as link:
        with closing(started(server)):
            link.publish(topic, stamped, {"twist": {"linear": {"x": 0.2}}})
            until(lambda: heard == [0.2])
        until(lambda: not link.subscribers(topic))
        Wheels(link, topic=topic).command(0.0, 0.0)  # of `make_safe`, while the robot is away
        with closing(started(server)):
            until(lambda: link.subscribers(topic))
            Wheels(link, topic=topic).command(0.0, 0.0)
            until(lambda: heard == [0.2, 0.0])


@pytest.mark.parametrize("twist", ["geometry_msgs/Twist", "geometry_msgs/TwistStamped"])
def test_rosapi_is_not_asked_before_each_command_to_a_robot_that_is_a_client_of_the_server(server, monkeypatch, twist):
    topic, heard = "client/cmd_vel", []
    with closing(linked(server)) as robot, closing(linked(server)) as link:
        robot.subscribe(topic, twist, lambda message: heard.append(velocity_of(twist, message)["linear"]["x"]))
        until(lambda: link.subscribers(topic))
        asked, subscribers = [], link.subscribers
        monkeypatch.setattr(link, "subscribers", lambda name: asked.append(name) or subscribers(name))
        wheels = Wheels(link, topic=topic)
        wheels.get_ready()
        for _ in range(5):
            wheels.command(0.2, 0.0)  # each would wait for seconds where rosapi hangs, while the robot drives
        until(lambda: heard == [0.2] * 5)
        assert len(asked) == 1


@pytest.mark.parametrize("generation", [1, 2])
@pytest.mark.parametrize("compressions", [("none",), ("none", "cbor")])
def test_a_server_that_knows_fewer_compressions_is_heard(generation, compressions):
    with (
        closing(RosbridgeServer(generation=generation, compressions=compressions)) as server,
        closing(linked(server)) as link,
    ):
        heard, raw = [], []
        link.subscribe("image", "sensor_msgs/Image", heard.append)
        link.subscribe_raw("image", "sensor_msgs/Image", raw.append)
        stamp = {"sec": 5, "nanosec": 6}
        server.publish("/image", "sensor_msgs/Image", {"data": b"\x00\xff", "header": {"stamp": stamp}})
        until(lambda: heard and raw)
        encoding = Encoding.ROS1 if generation == 1 else Encoding.CDR
        again = TypeCatalogue.of(generation).deserialise("sensor_msgs/Image", raw[0].data, encoding)
        assert (heard[0]["data"], heard[0]["header"]["stamp"]) == (b"\x00\xff", stamp)
        assert (again["data"], again["header"]["stamp"]) == (b"\x00\xff", stamp)


@pytest.mark.parametrize("field", ["", "float32[2] limits", "string[] words"])
@pytest.mark.parametrize("generation", [1, 2])
def test_a_type_that_only_the_robot_knows_is_asked_of_it(generation, field, tmp_path):
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Arm.msg").write_text(
        f"float64[] angles\nuint8[] key\ngeometry_msgs/Point[] path\nstring name\n{field}\n"
    )
    values = {"": {}, "float32[2] limits": {"limits": [1.0, 2.0]}, "string[] words": {"words": ["a", ""]}}
    arm = values[field] | {
        "angles": [0.5, 1.5],
        "key": b"ab",
        "path": [{"x": 1.0, "y": 0.0, "z": 0.0}],
        "name": "a",
    }
    with closing(RosbridgeServer(generation=generation, types=[tmp_path])) as server, closing(linked(server)) as link:
        heard = []
        link.subscribe("arm", "my_robot/Arm", heard.append)
        server.publish("/arm", "my_robot/Arm", arm)
        until(lambda: heard)
        assert heard == [arm]
        assert "float64[] angles" in link.definition("my_robot/Arm")


@pytest.mark.parametrize("said", ["received", "sent"])
def test_what_is_too_big_for_a_server_or_for_us_is_said(server, said):
    with closing(linked(server)) as link:
        link._transport._session._lose(f"{said} 1009 (message too big)")
        with pytest.raises(LinkError, match="message too big") as caught:
            link.publish("chatter", STRING, {"data": "a"})
    assert caught.value.fix == "Send less at once: 64 MiB come at most, 10 MB go to ROS 2 (max_message_size)."


def test_types_that_two_threads_learn_at_once_are_both_known(monkeypatch):
    both = threading.Barrier(2)
    learn = TypeCatalogue.with_definition

    def learn_meanwhile(catalogue, *told):
        with suppress(threading.BrokenBarrierError):  # of threads that wait for each other there is one at a time
            both.wait(0.2)
        return learn(catalogue, *told)

    monkeypatch.setattr(TypeCatalogue, "with_definition", learn_meanwhile)
    texts = {"my_robot/Arm": "float64 angle\n", "my_robot/Leg": "float64 length\n"}
    rosapi = SimpleNamespace(raw_definitions=lambda: texts, version=lambda _: (2, None))
    types = rosbridge_types.RobotTypes(rosapi, RosbridgeAddress.parse("rosbridge://robot"))
    threads = [threading.Thread(target=types.shape, args=(name,)) for name in texts]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    rosapi.raw_definitions = dict
    assert [types.is_known_here(name) for name in texts] == [True, True]


@pytest.mark.parametrize("generation", [1, 2])
def test_of_a_topic_that_is_there_the_robot_tells_the_whole_definition_so_that_its_bytes_are_read(generation, tmp_path):
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Arm.msg").write_text("float64[2] angles\nHand hand\nint64 count\n")
    (tmp_path / "my_robot" / "msg" / "Hand.msg").write_text("geometry_msgs/Point place\nstring[] fingers\n")
    hand = {"place": {"x": math.inf, "y": -0.5, "z": 0.0}, "fingers": ["ä", ""]}
    arm = {"angles": [-math.inf, 1e-320], "hand": hand, "count": 2**53 + 1}
    with closing(RosbridgeServer(generation=generation, types=[tmp_path])) as server, closing(linked(server)) as link:
        server.publish("/arm", "my_robot/Arm", arm)
        heard, raw = [], []
        link.subscribe("arm", "my_robot/Arm", heard.append)
        link.subscribe_raw("arm", "my_robot/Arm", raw.append)
        server.publish("/arm", "my_robot/Arm", arm)
        until(lambda: heard and raw)
        assert heard == [arm]
        known = TypeCatalogue.of(generation, extra=[tmp_path])
        assert known.deserialise("my_robot/Arm", raw[0].data, link.encoding) == arm


def test_a_service_type_that_a_robot_of_ros_2_lacks_does_not_end_its_rosapi(monkeypatch):
    monkeypatch.setattr(rosbridge_types, "_CONFIRMATION", 0.1)
    with closing(RosbridgeServer(generation=2)) as server, closing(linked(server)) as link:
        with pytest.raises(LinkError, match="my_robot/Open"):
            link.call("door", "my_robot/Open")
        assert link.topics() is not None
        assert not [name for name in link.services() if "probe" in name]


def test_a_service_type_that_only_the_robot_knows_is_asked_of_it(tmp_path):
    (tmp_path / "my_robot" / "srv").mkdir(parents=True)
    (tmp_path / "my_robot" / "srv" / "Open.srv").write_text("float64 angle\n---\nbool is_open\n")
    with closing(RosbridgeServer(generation=2, types=[tmp_path])) as server, closing(linked(server)) as link:
        server.offer("/door", "my_robot/Open", lambda asked: {"is_open": asked["angle"] == 0.5})
        assert link.call("door", "my_robot/Open", {"angle": 0.5}) == {"is_open": True}
        assert list(link.services()) == ["/door"]


@pytest.mark.parametrize("generation", [1, 2])
def test_what_nobody_repeats_is_said_again_until_a_server_s_new_publisher_is_connected(generation, monkeypatch):
    clock = FakeClock()  # on a busy machine, a moment may be longer than that
    for module in (rosbridge_transport, commanded_topics):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock.now, sleep=clock.sleep))
    with (
        closing(RosbridgeServer(generation=generation)) as server,
        closing(linked(server)) as robot,
        closing(linked(server)) as link,
    ):
        heard = []
        robot.subscribe("land", STRING, heard.append)
        command_for_certain(link, "land", STRING, {"data": "now"})
        assert clock.now() >= rosbridge_transport._CONNECTING
        until(lambda: len(heard) > 1)


@pytest.mark.parametrize("generation", [1, 2])
def test_what_is_published_while_a_service_is_called_does_not_wait_for_its_answer(generation):
    with (
        closing(RosbridgeServer(generation=generation)) as server,
        closing(linked(server)) as robot,
        closing(linked(server)) as link,
    ):
        stopped, ended = threading.Event(), threading.Event()
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda _: stopped.set())
        robot.offer("dock", TRIGGER, lambda _: {"success": stopped.wait(60.0)})
        replies = []

        def call():
            replies.append(link.call("dock", TRIGGER, timeout=60.0))
            ended.set()

        threading.Thread(target=call, daemon=True).start()
        until(lambda: not ended.wait(0.2))
        link.publish("cmd_vel", "geometry_msgs/Twist", {})
        assert ended.wait(60.0)
        assert replies == [{"success": True, "message": ""}]
        assert link.call("dock", TRIGGER, timeout=60.0)["success"]


@pytest.mark.parametrize(("generation", "w"), [(1, 0.0), (2, 1.0)])
def test_an_orientation_left_out_of_a_type_that_only_the_robot_knows_has_ros_default(generation, w, tmp_path):
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Aim.msg").write_text("geometry_msgs/Pose pose\n")
    with closing(RosbridgeServer(generation=generation, types=[tmp_path])) as server, closing(linked(server)) as link:
        heard = []
        link.subscribe("aim", "my_robot/Aim", heard.append)
        link.publish("aim", "my_robot/Aim", {"pose": {"position": {"x": 1.0}}})
        until(lambda: heard)
        assert heard[0]["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": w}


@pytest.mark.parametrize(
    ("generation", "level"), [(1, {"one": -1, "all": [-2, 3]}), (2, {"one": 255, "all": b"\xfe\x03"})]
)
def test_a_byte_of_a_type_that_only_the_robot_knows_has_a_sign_in_ros_1_and_none_in_ros_2(generation, level):
    told = {"fieldnames": ["one", "all"], "fieldtypes": ["byte", "byte"], "fieldarraylen": [-1, 0]}
    details = lambda *_: [{"type": "my_robot/Level", **told}]  # noqa: E731
    rosapi = SimpleNamespace(details=details, raw_definitions=dict, version=lambda _: (generation, None))
    types = rosbridge_types.RobotTypes(rosapi, RosbridgeAddress.parse(f"rosbridge://robot?ros={generation}"))
    shape = types.shape("my_robot/Level")
    assert completed(shape, level, where="level") == level
    protocol = rosbridge_frames.to_protocol(shape, level)
    assert rosbridge_frames.from_protocol(shape, protocol, where="level") == level


def test_a_time_of_ros_1_is_one_though_rosapi_describes_it_as_a_message_of_secs_and_nsecs():
    described = {"fieldtypes": ["int32", "int32"], "fieldarraylen": [-1, -1], "fieldnames": ["secs", "nsecs"]}
    lap = {"fieldnames": ["start", "rests"], "fieldtypes": ["time", "duration"], "fieldarraylen": [-1, 0]}
    told = {"my_robot/Lap": lap, "time": described, "duration": described}
    details = lambda *_: [{"type": name, **each} for name, each in told.items()]  # noqa: E731
    rosapi = SimpleNamespace(details=details, raw_definitions=dict, version=lambda _: (1, None))
    shape = rosbridge_types.RobotTypes(rosapi, RosbridgeAddress.parse("rosbridge://robot?ros=1")).shape("my_robot/Lap")
    message = {"start": {"sec": 7, "nanosec": 5}, "rests": [{"sec": 1, "nanosec": 0}]}
    protocol = {"start": {"secs": 7, "nsecs": 5}, "rests": [{"secs": 1, "nsecs": 0}]}
    assert rosbridge_frames.to_protocol(shape, completed(shape, message, where="lap")) == protocol
    assert rosbridge_frames.from_protocol(shape, protocol, where="lap") == message


def test_who_subscribes_later_gets_the_fixed_frames_of_all_nodes_and_the_last_of_all_else(server):
    def told(child):
        return {"transforms": [{"header": {"frame_id": "base"}, "child_frame_id": child}]}

    with closing(linked(server)) as link:
        early, late = [], []
        for topic, kind in (("/tf_static", "tf2_msgs/TFMessage"), ("/map_name", STRING)):
            link.subscribe(topic, kind, early.append)
        for child, name in (("lidar", "arena"), ("camera", "hall")):
            server.publish("/tf_static", "tf2_msgs/TFMessage", told(child), is_latched=True)
            server.publish("/map_name", STRING, {"data": name}, is_latched=True)
        until(lambda: len(early) == 4)
        for topic, kind in (("/tf_static", "tf2_msgs/TFMessage"), ("/map_name", STRING)):
            link.subscribe(topic, kind, late.append, qos=Qos.TRANSIENT_LOCAL)
        children = [each["child_frame_id"] for message in late[:2] for each in message["transforms"]]
        assert children == ["lidar", "camera"]
        assert late[2:] == [{"data": "hall"}]


def test_a_callback_may_call_a_service(server):
    server.offer("/lamp", TRIGGER, lambda _: {"success": True, "message": "on"})
    with closing(linked(server)) as link:
        answers = []
        link.subscribe("chatter", STRING, lambda _: answers.append(link.call("lamp", TRIGGER)))
        server.publish("/chatter", STRING, {"data": "a"})
        until(lambda: answers)
        assert answers == [{"success": True, "message": "on"}]


def test_a_frame_that_no_memory_should_hold_ends_the_connection(server, monkeypatch):
    monkeypatch.setattr(rosbridge_frames, "LARGEST_FRAME", 100_000)
    with closing(linked(server)) as link:
        link.subscribe("chatter", STRING, lambda _: None)
        server.publish("/chatter", STRING, {"data": "a" * 200_000})
        with pytest.raises(LinkError, match="connection is lost"):
            link.wait_for("odom", "nav_msgs/Odometry", timeout=60.0)


def test_messages_that_callbacks_do_not_take_end_the_connection_and_fill_no_memory(server, monkeypatch):
    monkeypatch.setattr(rosbridge_session, "_MOST_WAITING_BYTES", 1_000_000)
    goes_on = threading.Event()
    with closing(linked(server)) as link:
        link.subscribe("chatter", STRING, lambda _: goes_on.wait(60))
        for _ in range(30):
            server.publish("/chatter", STRING, {"data": "a" * 100_000})
        with pytest.raises(LinkError, match=r"callbacks are too slow: .* messages of"):
            link.wait_for("odom", "nav_msgs/Odometry", timeout=60.0)
        goes_on.set()


def test_a_callback_during_which_the_link_is_closed_is_no_fault(server):
    begun, session = threading.Event(), rosbridge_session.Session(RosbridgeAddress.parse(server.url))

    def send_late():
        begun.set()
        until(lambda: not session.is_usable)
        session.send({"op": "publish", "topic": "/chatter", "msg": {"data": "a"}})

    session.later(send_late)
    assert begun.wait(60)
    session.close()  # an exception in its thread would be raised here


@pytest.mark.parametrize("host", ["192.168.1.20", "robot.lab", "[2001:db8::1]"])
def test_an_address_in_a_network_is_warned_of(host):
    (finding,) = ROSBRIDGE.findings(RobotName.parse(f"rosbridge://{host}:9090"))
    assert not finding.is_error
    assert "neither encrypted" in finding.problem
    assert "ssh -L 9090:localhost:9090" in finding.fix


@pytest.mark.parametrize("host", ["localhost", "127.0.0.2", "[::1]"])
def test_an_address_of_this_machine_is_not(host):
    assert ROSBRIDGE.findings(RobotName.parse(f"rosbridge://{host}:9090")) == []
