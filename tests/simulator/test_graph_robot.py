"""The embedded robot on a graph is told what to do, says what it senses, and stops when its run falls silent."""

from __future__ import annotations

import threading
import time

import pytest
from tests.simulator.test_modelled_robot import ROVER

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Qos
from robot_runner.ros.graph_links import GraphLinkKind
from robot_runner.simulator import graph_robot, graph_simulation
from robot_runner.simulator.graph_robot import SimulatedPlace
from robot_runner.simulator.graph_simulation import GraphSimulation, check_pace, on_graph
from robot_runner.simulator.rooms import Pose, Room
from robot_runner.simulator.simulated_turtlebot3 import Simulation


class _End:
    def __init__(self, ends, key):
        self.ends, self.key = ends, key

    def close(self):
        self.ends.pop(self.key, None)


class GraphOfOne:
    """A link to a graph on which there is only the robot; the test hears and says what others would."""

    def __init__(self, taken=()):
        self.said, self.heard_by, self.offers, self.taken = [], {}, {}, taken

    def publish(self, topic, message_type, message, *, qos=Qos.DEFAULT):
        self.said.append((topic, message_type, message, qos))

    def subscribe(self, topic, message_type, callback, *, qos=None):
        self.heard_by[topic] = callback
        return _End(self.heard_by, topic)

    def offer(self, service, service_type, answer):
        if service in self.taken:
            raise LinkError("somebody offers it already", where=service, fix="Choose another namespace.")
        self.offers[service] = answer
        return _End(self.offers, service)

    def definition(self, message_type):
        return f"# {message_type}"

    def messages(self, topic):
        return [message for name, _, message, _ in self.said if name == topic]

    @property
    def speed(self):
        return self.messages("odom")[-1]["twist"]["twist"]["linear"]["x"]


class TimeByHand:
    """The time of this machine, as its robot has it, which passes only where somebody waits."""

    def __init__(self):
        self.now = 50.0

    def monotonic(self):
        return self.now

    def time_ns(self):
        return int(self.now * 1e9)

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def by_hand(monkeypatch):
    made = TimeByHand()
    monkeypatch.setattr(graph_simulation, "time", made)
    monkeypatch.setattr(graph_robot, "time", made)
    return made


@pytest.fixture
def simulation():
    made = Simulation(seed=1)
    yield made
    made.close()


@pytest.fixture
def link():
    return GraphOfOne()


@pytest.fixture
def make(link, simulation):
    made = []

    def make_robot(*, has_meter=False, **options):
        place = SimulatedPlace(link="dds", **{"real_time_factor": 100.0, **options})
        made.append(GraphSimulation({"": link}, lambda seed: simulation, place, has_meter=has_meter))
        return made[-1]

    yield make_robot
    for each in made:
        each.close()


def seconds(stamp):
    return stamp["sec"] + stamp["nanosec"] / 1e9


def test_it_says_what_a_turtlebot3_says_at_its_rates(link, make):
    make().live(seconds=1.0)
    counts = {
        topic: len(link.messages(topic)) for topic in ("odom", "imu", "scan", "battery_state", "joint_states", "tf")
    }
    assert counts == {"odom": 30, "imu": 200, "scan": 5, "battery_state": 30, "joint_states": 30, "tf": 30}
    kinds = {topic: (kind, qos) for topic, kind, _, qos in link.said}
    assert kinds["scan"] == ("sensor_msgs/LaserScan", Qos.SENSOR_DATA)
    assert kinds["odom"] == ("nav_msgs/Odometry", Qos.DEFAULT)
    assert kinds["robot_runner/simulation"] == ("std_msgs/String", Qos.TRANSIENT_LOCAL)


def test_it_drives_as_it_is_told_and_its_transform_follows(link, make):
    robot = make()
    link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    robot.live(seconds=2.0)
    assert link.speed == pytest.approx(0.2, abs=0.01)
    transform, odometry = link.messages("tf")[-1]["transforms"][0], link.messages("odom")[-1]
    assert transform["transform"]["translation"] == odometry["pose"]["pose"]["position"]
    assert transform["transform"]["translation"]["x"] > 0.3
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("odom", "base_footprint")


def test_its_tasks_are_services(link, make, simulation):
    make()
    assert link.offers["task/video/start"]({}) == {"success": True, "message": "video started"}
    assert link.offers["task/network/start"]({}) == {"success": False, "message": "video is running already"}
    assert link.offers["task/stop"]({})["success"]
    assert simulation.turtlebot3().running_task is None


@pytest.mark.usefixtures("by_hand")
def test_it_stands_still_when_its_run_falls_silent_and_moves_on_when_it_is_heard_again(link, make):
    robot = make(real_time_factor=1.0)
    link.heard_by["robot_runner/heartbeat"]({"data": 1})
    link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    robot.live(seconds=0.35)
    assert link.speed > 0.15
    robot.live(seconds=0.6)
    assert link.speed < 0.01
    link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    robot.live(seconds=0.2)
    assert link.speed < 0.01  # a command that was under way does not move it
    link.heard_by["robot_runner/heartbeat"]({"data": 2})
    link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    robot.live(seconds=0.3)
    assert link.speed > 0.1


def test_a_velocity_that_is_no_number_moves_nothing(link, make, caplog):
    robot = make()
    link.heard_by["cmd_vel"]({"linear": {"x": float("nan")}, "angular": {"z": 0.0}})
    robot.live(seconds=0.2)
    assert link.speed == pytest.approx(0.0, abs=0.001)
    assert "nan m/s" in caplog.text


@pytest.mark.usefixtures("by_hand")
def test_a_person_may_drive_a_robot_that_was_released(link, make):
    robot = make(real_time_factor=1.0)
    link.heard_by["robot_runner/heartbeat"]({"data": 1})
    robot.live(seconds=0.5)
    assert link.offers["robot_runner/watchdog/release"]({})["success"]
    link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    robot.live(seconds=0.5)
    assert link.speed > 0.15


def test_stamps_are_of_this_machine_where_no_clock_is_published(link, make):
    make().live(seconds=0.5)
    stamp = seconds(link.messages("imu")[-1]["header"]["stamp"])
    assert abs(stamp - time.time()) < 5.0
    assert link.messages("/clock") == []


def test_where_a_clock_is_published_all_stamps_are_of_it(link, make):
    make(is_clock=True).live(seconds=0.5)
    times = [seconds(message["clock"]) for message in link.messages("/clock")]
    assert times == pytest.approx([0.01 * (tick + 1) for tick in range(50)])
    assert seconds(link.messages("odom")[-1]["header"]["stamp"]) == pytest.approx(0.5, abs=0.04)


def test_it_keeps_the_pace_that_was_asked_for(make, by_hand):
    robot = make(real_time_factor=4.0)
    robot.live(seconds=2.0)
    assert by_hand.now == pytest.approx(50.5)
    assert robot.lags == 0


def test_a_pace_that_cannot_be_kept_is_counted_and_not_made_up_for(link, make, monkeypatch, by_hand):
    robot = make(real_time_factor=1.0)
    publish = link.publish

    def slowly(topic, *rest, **options):
        if topic == "scan":
            by_hand.sleep(0.4)
        publish(topic, *rest, **options)

    monkeypatch.setattr(link, "publish", slowly)
    robot.live(seconds=0.45)
    assert robot.lags == 2
    assert by_hand.now > 50.0 + 2 * 0.4


def test_it_ends_when_it_is_told_so(make):
    is_over = threading.Event()
    threading.Timer(0.1, is_over.set).start()
    make(real_time_factor=1.0).live(is_over=is_over.is_set)


def test_a_robot_that_is_closed_hears_and_offers_nothing(link, make):
    robot = make()
    robot.close()
    robot.close()
    assert link.heard_by == link.offers == {}


def test_two_robots_of_one_name_are_refused_and_nothing_is_left_behind(simulation):
    link = GraphOfOne(taken=("robot_runner/watchdog/release",))
    with pytest.raises(LinkError, match="somebody offers it already"):
        GraphSimulation({"": link}, lambda seed: simulation, SimulatedPlace(link="dds"))
    assert link.heard_by == link.offers == {}


@pytest.mark.parametrize("factor", [0.0, -1.0, float("inf"), float("nan")])
def test_a_pace_that_no_clock_can_keep_is_refused(factor):
    with pytest.raises(LinkError, match="which no clock can keep"):
        check_pace(SimulatedPlace(link="dds", real_time_factor=factor, is_clock=True))


def test_another_pace_than_that_of_the_graph_must_be_told_to_the_graph():
    with pytest.raises(LinkError, match="--use-sim-time"):
        check_pace(SimulatedPlace(link="dds", real_time_factor=2.0))
    check_pace(SimulatedPlace(link="dds", real_time_factor=2.0, is_clock=True))


@pytest.mark.parametrize("link", ["simulated", "gazebo"])
def test_a_link_that_is_no_graph_is_refused(link):
    with pytest.raises(LinkError, match=f"no robot can be put on '{link}'"), on_graph(SimulatedPlace(link=link)):
        pass


def test_it_lives_without_its_transform_where_tf2_is_not_installed(link, make, monkeypatch, caplog):
    def unknown(message_type):
        raise LinkError(f"there is no type {message_type!r}", where="the graph", fix="Install it.")

    monkeypatch.setattr(link, "definition", unknown)
    make().live(seconds=0.2)
    assert link.messages("odom")
    assert not link.messages("tf")
    assert "tf2_msgs/TFMessage" in caplog.text


def test_a_reset_is_another_run_of_the_same_robot_from_the_beginning(link):
    place = SimulatedPlace(link="dds", seed=4, is_clock=True, real_time_factor=100.0)
    graph = GraphSimulation({"": link}, Simulation, place, has_meter=True)
    try:
        link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
        graph.live(seconds=2.0)
        before, noise = link.messages("odom")[-1], link.messages("imu")[0]["linear_acceleration"]
        assert before["pose"]["pose"]["position"]["x"] > 0.3
        link.said.clear()
        assert link.offers["reset_simulation"]({}) == {}
        assert graph.now == 0.0
        graph.live(seconds=0.5)
        after = link.messages("odom")[-1]
        assert after["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=1e-3)
        assert seconds(link.messages("/clock")[0]["clock"]) == pytest.approx(0.01)
        assert link.messages("battery_state")[-1]["percentage"] > 0.999
        assert link.messages("imu")[0]["linear_acceleration"] != noise, "each run after a reset would have one noise"
        link.heard_by["cmd_vel"]({"linear": {"x": 0.1}, "angular": {"z": 0.0}})
        graph.live(seconds=1.0)
        assert link.speed == pytest.approx(0.1, abs=0.01)
    finally:
        graph.close()


def test_a_robot_that_is_put_back_stands_where_it_began_and_time_goes_on(link, make):
    graph = make(is_clock=True)
    link.heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 1.0}})
    graph.live(seconds=2.0)
    true = graph.robots[""]._robot
    assert abs(true.pose.yaw) > 1.0
    link.offers["reset_world"]({})
    graph.live(seconds=0.5)
    pose = link.messages("odom")[-1]["pose"]["pose"]
    assert pose["position"]["x"] == pytest.approx(0.0, abs=2e-3)
    assert true.pose.x == pytest.approx(0.0, abs=2e-3)
    assert true.pose.yaw == pytest.approx(0.0, abs=0.01)
    assert link.speed == pytest.approx(0.0, abs=1e-3)
    assert graph.now == pytest.approx(2.5)


def test_while_it_is_paused_its_time_stands_still_and_nothing_is_said(link, make, by_hand):
    graph = make(is_clock=True, real_time_factor=1.0)
    graph.live(seconds=0.1)
    link.offers["pause_physics"]({})
    link.said.clear()
    begun = by_hand.now
    graph.live(is_over=lambda: by_hand.now > begun + 1.0)
    assert link.said == []
    assert graph.now == pytest.approx(0.1)
    link.offers["unpause_physics"]({})
    graph.live(seconds=0.2)
    assert graph.now == pytest.approx(0.3, abs=0.011)
    assert graph.lags == 0
    assert by_hand.now - begun == pytest.approx(1.2, abs=0.05), "time that was paused is not made up for"


def test_robots_of_one_room_live_on_one_graph_in_one_world():
    links = {"/alice": GraphOfOne(), "/bob": GraphOfOne()}
    room = Room((), {"/alice": Pose(0, 0, 0), "/bob": Pose(0.4, 0, 0)})
    place = SimulatedPlace(link="dds", real_time_factor=100.0)
    graph = GraphSimulation(links, lambda seed: Simulation(seed, room=room), place)
    links["/alice"].heard_by["cmd_vel"]({"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    graph.live(seconds=4.0)
    assert min(links["/bob"].messages("scan")[0]["ranges"]) < 0.5
    assert graph.robots["/bob"]._robot.pose.x > 0.45, "bob was not pushed"
    graph.close()


def closable(link):
    link.close = lambda: None
    return link


def test_a_robot_is_put_into_the_namespace_that_its_graph_is_named_with(monkeypatch):
    monkeypatch.setattr(GraphLinkKind, "open", lambda *told: opened.append(told[-1]) or closable(GraphOfOne()))
    for link, namespace, expected in (
        ("dds://alice", "", "/alice"),
        ("dds:domain=7,namespace=lab", "alice/", "/lab/alice"),
        ("dds", "/bob", "/bob"),
    ):
        opened = []
        with on_graph(SimulatedPlace(link=link, namespace=namespace)) as graph:
            assert opened == [expected]
            assert list(graph.robots) == [expected]


def test_robots_of_a_room_start_where_it_says_in_the_namespace_of_their_graph(monkeypatch, tmp_path):
    monkeypatch.setattr(GraphLinkKind, "open", lambda *_: closable(GraphOfOne()))
    path, model = tmp_path / "room.toml", tmp_path / "rover.xml"
    path.write_text("[[robot]]\nat = [1, 2]\nnamespace = 'alice'", "utf-8")
    model.write_text(ROVER, "utf-8")
    with on_graph(SimulatedPlace(link="dds:namespace=lab", room=path)) as graph:
        assert list(graph.robots) == ["/lab/alice"]
        pose = graph.robots["/lab/alice"]._robot.pose
        assert (pose.x, pose.y) == pytest.approx((1.0, 2.0), abs=1e-3)
    place = SimulatedPlace(link="dds:namespace=lab", namespace="alice", room=path, model=model)
    with on_graph(place) as graph:
        truth = graph.robots["/lab/alice"]._robot.topics["ground_truth"].latest()
        assert truth["pose"]["pose"]["position"]["x"] == pytest.approx(1.0, abs=1e-3)


def test_a_room_that_names_its_robots_takes_no_namespace(tmp_path):
    path = tmp_path / "room.toml"
    path.write_text("[[robot]]\nat = [0, 0]\nnamespace = 'alice'", "utf-8")
    place = SimulatedPlace(link="dds", namespace="/bob", room=path)
    with pytest.raises(LinkError, match="the room names its robots: /alice"), on_graph(place):
        pass
