"""Bags as missions: over links that are faked, over DDS, over a real ROS 1, and by the players of ROS."""

from __future__ import annotations

import csv
import importlib.util
import io
import os
import shlex
import shutil
import sys
import time
from contextlib import closing
from itertools import pairwise

import pytest
import yaml
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.recordings import BEGIN_NS, PERIOD_NS, scans_of_ros1, scans_of_ros2
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.connect import is_simulation
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Qos
from robot_runner.core.plugin import Circumstances
from robot_runner.plugins import treatment
from robot_runner.ros.bag_file import new_bag
from robot_runner.ros.bag_player import ProgramPlayer
from robot_runner.ros.link_opening import open_dds_link, open_ros1_link
from robot_runner.ros.play_bag import PlayBag
from robot_runner.ros.recorded_bag import RecordedBag
from robot_runner.ros.shapes import completed, stamp_of
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, SystemContract, make_context, rehearse

SCAN = "sensor_msgs/LaserScan"

over_dds = pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="there is no DDS")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """One bag of 20 scans of each kind, by name."""
    folder = tmp_path_factory.mktemp("bags")
    return {
        "bag": scans_of_ros1(folder / "hall.bag", others=("/note",)),
        "mcap": scans_of_ros2(folder / "hall", others=("/note",)),
        "sqlite": scans_of_ros2(folder / "hall_sqlite", sqlite=True, best_effort=True),
        "empty": scans_of_ros2(folder / "nothing", count=0),
    }


@pytest.fixture
def play(tmp_path):
    """Play a bag on a graph that is faked; return the link and the context."""

    def execute(*positional, prepare=lambda _: None, **options):
        clock = FakeClock(10.0)
        link, plugin = FakeRobotLink(clock), PlayBag(*positional, **options)
        prepare(link)
        context = make_context(tmp_path, plugin, links=FakeLinks(robot=link), clock=clock)
        rehearse(context, plugin)
        return link, context

    return execute


def problems(*positional, robot="dds", **options):
    plugin = PlayBag(*positional, **options)
    return [(each.problem, each.fix) for each in plugin.check(Circumstances(robot=robot, plugins=[plugin]))]


def driving(folder, *names, seconds=(2.0, 2.0)):
    """Return a bag in which velocities were recorded."""
    types = TypeCatalogue.of(2)
    bag = new_bag(folder, Encoding.CDR)
    message = completed(types.shape("geometry_msgs/Twist"), {"linear": {"x": 0.1}}, where="")
    data = types.serialise("geometry_msgs/Twist", message, Encoding.CDR)
    for name, lasting in zip(names, seconds, strict=False):
        topic = bag.add_topic(name, "geometry_msgs/Twist", types.definition("geometry_msgs/Twist"))
        for number in range(round(lasting * 10) + 1):
            bag.write(topic, BEGIN_NS + number * 100_000_000, data)
    bag.close()
    return bag.path


class TestABagThatDrivesARobot(SystemContract):
    """A velocity that was recorded is commanded: the robot stands still whatever happens."""

    @pytest.fixture(autouse=True)
    def driven(self, tmp_path_factory):
        self.path = driving(tmp_path_factory.mktemp("driven"), "/cmd_vel")

    def make_plugin(self):
        return PlayBag(self.path)


def test_of_two_robots_that_a_bag_drives_one_is_stopped_also_where_the_other_cannot_be_reached(tmp_path, monkeypatch):
    clock = FakeClock(10.0)
    link = FakeRobotLink(clock)
    plugin = PlayBag(driving(tmp_path, "/alice/cmd_vel", "/bob/cmd_vel"))
    publish = link.publish

    def publish_to_bob(topic, *arguments, **options):
        if topic.startswith("/alice") and clock.now() > 11.0:
            raise LinkError("alice is gone", where=topic)
        publish(topic, *arguments, **options)

    monkeypatch.setattr(link, "publish", publish_to_bob)
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(LinkError, match="alice is gone"):
        rehearse(context, plugin)
    assert [each.message["linear"]["x"] for each in link.publications if each.topic == "/bob/cmd_vel"][-1] == 0.0
    assert (context.raw_data_folder / "played.csv").read_text().count("\n") > 10


class UnreachedLink(FakeRobotLink):
    """A link on which the only subscriber of one topic has another version of its type, so that it never connects."""

    def advertise(self, topic, message_type, *, qos=Qos.DEFAULT):
        return topic != "/bob/cmd_vel"


def test_a_mission_is_doubted_whose_messages_did_not_reach_a_subscriber(tmp_path, monkeypatch):
    """It counted as done: what was measured of that node was its idling."""
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.0)
    clock = FakeClock(10.0)
    plugin = PlayBag(driving(tmp_path, "/alice/cmd_vel", "/bob/cmd_vel"))
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=UnreachedLink(clock)), clock=clock)
    rehearse(context, plugin)
    (doubt,) = context.broker.findings
    assert "'/bob/cmd_vel' may have missed messages of the mission" in doubt.problem


def test_the_last_message_that_is_chosen_ends_the_mission_whether_the_time_is_told_or_not(play, tmp_path):
    long = driving(tmp_path, "/short", "/long", seconds=(0.3, 2.0))
    for clock in (False, True):
        link, context = play(long, topics=["/short"], clock=clock, settle_s=0.0)
        assert context.window.duration == pytest.approx(0.3)
        told = [each.message["clock"]["nanosec"] for each in link.publications if each.topic == "/clock"]
        assert len(told) == (31 if clock else 0)


def test_one_file_of_a_bag_that_was_split_and_a_time_in_it_are_told(tmp_path):
    one = driving(tmp_path, "/clock")
    shutil.copy(one, one.with_name("bag_1.mcap"))
    ((split, fix), (clocks, _)) = problems(one, robot="dds:clock=graph")
    assert "is one of 2 files of a bag" in split
    assert str(tmp_path) in fix
    assert "which this plugin tells" in clocks


@pytest.mark.parametrize(("ahead_s", "topics"), [(0, None), (-BEGIN_NS // 10**9, None), (-1000, ["/scan"])])
def test_a_bag_of_a_simulation_is_told_whose_own_time_is_another_than_that_of_its_recording(tmp_path, ahead_s, topics):
    """Nodes lived at the time of day, and had data of the simulation's first seconds: they dropped all of it."""
    types, bag = TypeCatalogue.of(2), new_bag(tmp_path, Encoding.CDR)
    for name, kind in {"/clock": "rosgraph_msgs/Clock", "/scan": SCAN}.items():
        told = {"clock": stamp_of(BEGIN_NS + ahead_s * 10**9)} if name == "/clock" else {}
        data = types.serialise(kind, completed(types.shape(kind), told, where=""), Encoding.CDR)
        bag.write(bag.add_topic(name, kind, types.definition(kind)), BEGIN_NS, data)
    bag.close()
    assert problems(bag.path, topics=topics) == []
    found = problems(bag.path, topics=topics, clock=True)
    assert len(found) == bool(ahead_s)
    for problem, fix in found:
        assert f"/clock told a time {-ahead_s:,} s from that at which it was recorded" in problem
        assert ("topics" in fix) == (topics is not None)


@pytest.mark.parametrize("kind", ["bag", "mcap", "sqlite"])
def test_messages_are_as_far_apart_as_they_were_recorded_whatever_recorded_them(play, scans, kind):
    link, context = play(scans[kind], topics=["/scan"], rate=2.0)
    sent = [each for each in link.publications if each.topic == "/scan"]
    assert [each.time - sent[0].time for each in sent] == pytest.approx([number * 0.025 for number in range(20)])
    stamps = [each.message["header"]["stamp"] for each in sent]
    assert [each["sec"] * 10**9 + each["nanosec"] for each in stamps] == [
        BEGIN_NS + number * PERIOD_NS for number in range(20)
    ]
    assert "seq" not in sent[0].message["header"]  # the link is one of ROS 2
    assert sent[3].message["ranges"][0] == 3.5
    assert {each.qos for each in sent} == {Qos.SENSOR_DATA if kind == "sqlite" else Qos.DEFAULT}
    assert context.measures["PlayedMessages"] == 20
    assert context.measures["PlayTime"] == pytest.approx(19 * 0.025)
    assert context.window.duration == pytest.approx(19 * 0.025 + 0.1)
    assert context.measures["MaxPlayLateness"] == pytest.approx(0.0, abs=1e-9)
    with (context.raw_data_folder / "played.csv").open() as file:
        assert [float(row["moment_s"]) for row in csv.DictReader(file)][-1] == pytest.approx(19 * 0.05)


def test_the_time_of_the_bag_makes_no_simulation_of_what_is_measured_beside_it(play, scans):
    link, _ = play(scans["mcap"], clock=True)
    assert "/clock" in link.topics()
    assert not is_simulation(link)
    link.known_topics["/clock"] = "rosgraph_msgs/Clock"
    link.known_publishers["/clock"] = [GraphEndpoint("/gazebo", "rosgraph_msgs/Clock")]
    assert is_simulation(link)


def test_the_time_of_the_bag_is_told_on_clock_before_what_was_recorded_then(play, scans):
    link, _ = play(scans["mcap"], rate=0.5, clock=True)
    told = [each for each in link.publications if each.topic == "/clock"]
    assert (link.publications[0].topic, told[0].message_type) == ("/clock", "rosgraph_msgs/Clock")
    times = [each.message["clock"]["sec"] * 10**9 + each.message["clock"]["nanosec"] for each in told]
    assert times[0] == BEGIN_NS
    assert {later - sooner for sooner, later in pairwise(times)} == {5_000_000}  # 100 Hz at half speed
    assert told[-1].time - told[0].time == pytest.approx(1.9, abs=0.011)
    assert "/clock" not in {each.topic for each in play(scans["mcap"])[0].publications}


@pytest.mark.parametrize("clock", [False, True])
def test_a_bag_that_holds_fewer_messages_than_it_counts_makes_the_run_doubtful(play, tmp_path, clock):
    """One of 8,886 messages with a damaged byte gave 564 without a word."""
    bag = scans_of_ros2(tmp_path / "hall")
    assert not play(bag, clock=clock)[1].broker.findings
    metadata = bag / "metadata.yaml"
    told = yaml.safe_load(metadata.read_text())
    (scans,) = told["rosbag2_bagfile_information"]["topics_with_message_count"]
    scans["message_count"] = 25
    metadata.write_text(yaml.safe_dump(told))
    (doubt,) = play(bag, clock=clock)[1].broker.findings
    assert doubt.problem.startswith("20 messages were played, and the bag counts 25 on these topics: it is damaged")


def test_no_more_than_a_second_is_read_ahead(tmp_path, monkeypatch):
    """200 images were, which is more than a gigabyte of a camera's."""
    read, ahead = [], []

    class Link(FakeRobotLink):
        def publish(self, *arguments, **options):
            super().publish(*arguments, **options)
            ahead.append(len(read) - len(self.publications))

    messages = RecordedBag.messages
    monkeypatch.setattr(RecordedBag, "messages", lambda *of: (read.append(each) or each for each in messages(*of)))
    clock, plugin = FakeClock(10.0), PlayBag(driving(tmp_path, "/a", seconds=(10.0,)), rate=2.0)
    rehearse(make_context(tmp_path, plugin, links=FakeLinks(robot=Link(clock)), clock=clock), plugin)
    assert (len(read), max(ahead)) == (101, 20)


def test_who_subscribes_fixed_frames_late_gets_those_of_all_publishers_of_the_bag(play, tmp_path):
    """It gets the last message: of two publishers, the frames of one were missing."""
    types, bag, kind = TypeCatalogue.of(2), new_bag(tmp_path, Encoding.CDR), "tf2_msgs/TFMessage"
    fixed = bag.add_topic("/tf_static", kind, types.definition(kind), [Qos.TRANSIENT_LOCAL])
    moving = bag.add_topic("/tf", kind, types.definition(kind))
    sent = [(fixed, "eye", 1.0), (fixed, "ear", 2.0), (fixed, "eye", 3.0), (moving, "leg", 0.0), (moving, "arm", 0.0)]
    for number, (topic, frame, x) in enumerate(sent):
        frames = {"transforms": [{"child_frame_id": frame, "transform": {"translation": {"x": x}}}]}
        data = types.serialise(kind, completed(types.shape(kind), frames, where=""), Encoding.CDR)
        bag.write(topic, BEGIN_NS + number, data)
    bag.close()
    link, context = play(bag.path)
    told = [
        {each["child_frame_id"]: each["transform"]["translation"]["x"] for each in published.message["transforms"]}
        for published in link.publications
    ]
    assert told == [{"eye": 1.0}, {"eye": 1.0, "ear": 2.0}, {"eye": 3.0, "ear": 2.0}, {"leg": 0.0}, {"arm": 0.0}]
    assert context.measures["PlayedMessages"] == 5


def test_messages_that_come_late_make_the_run_doubtful_by_the_figure(tmp_path, scans):
    class Slow(FakeRobotLink):
        def publish(self, *arguments, **options):
            super().publish(*arguments, **options)
            clock.sleep(0.08)  # longer than the time between two messages

    clock = FakeClock(0.0)
    plugin = PlayBag(scans["mcap"], topics=["/scan"])
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=Slow(clock)), clock=clock)
    measures = rehearse(context, plugin)
    assert measures["PlayLateness"] == measures["MaxPlayLateness"] == pytest.approx(19 * 0.03)
    (finding,) = context.broker.findings
    assert finding.problem.endswith("99 % of the messages were published up to 570.0 ms late, and one 570.0 ms")


def test_what_stands_in_the_way_is_found_before_anything_moves(tmp_path, scans):
    ((missing, fix),) = problems(scans["bag"].with_name("hal.bag"))
    assert missing.startswith("there is no bag")
    assert "hall.bag" in fix
    assert problems(scans["mcap"], topics=["/scann", "/gps/xyz"]) == [
        ("the bag has no messages on '/scann'", "Did you mean '/scan'?"),
        ("the bag has no messages on '/gps/xyz'", "Choose one of: '/scan', '/note'."),
    ]
    assert problems(scans["empty"])[0][0] == "the bag has no messages"
    assert problems(scans["mcap"], robot=None)[0][0].endswith("and the experiment names none")
    ((clocks, _),) = problems(scans["mcap"], clock=True, robot="ros2:clock=graph")
    assert "which this plugin tells" in clocks
    assert problems(scans["mcap"], robot="ros2:clock=graph") == []
    (tmp_path / "note.txt").write_text("no bag")
    assert problems(tmp_path / "note.txt")[0][0] == "'note.txt' is not a bag"
    assert problems(tmp_path)[0][0].startswith("there are no bags in")
    assert problems(scans["bag"].parent)[0][1].startswith("Name one of them: ")


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.98])
def test_a_bag_that_was_cut_off_is_an_error_and_no_traceback(tmp_path, scans, kind, share):
    whole = scans[kind] if kind == "bag" else next(scans[kind].glob("*.mcap"))
    cut = tmp_path / f"cut{whole.suffix}"
    data = whole.read_bytes()
    cut.write_bytes(data[: round(share * len(data))])
    ((problem, fix),) = problems(cut)
    assert problem.startswith("the bag cannot be read: ")
    assert "Record it again" in fix


def test_messages_out_of_order_in_a_file_without_an_index_are_found_before_anything_moves(tmp_path):
    bag, text = tmp_path / "hall.mcap", b"\0\1\0\0\2\0\0\0a\0"
    with bag.open("wb") as file:
        writer = McapWriter(file, use_chunking=False)  # as rosbag2 writes with the preset "fastwrite"
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        topics = [writer.register_channel(topic, "cdr", schema) for topic in ("/early", "/note")]
        for topic, stamp in [(1, 20), (0, 10), (1, 30)]:
            writer.add_message(topics[topic], log_time=stamp, publish_time=stamp, data=text)
        writer.finish()
    ((problem, fix),) = problems(bag)
    assert "not in timestamp order" in problem
    assert "mcap recover" in fix
    assert problems(bag, topics=["/note"]) == []


@pytest.mark.parametrize("compression", list(Writer.CompressionFormat))
def test_a_bag_whose_compressed_bytes_are_damaged_is_an_error_and_no_traceback(tmp_path, compression):
    bag = scans_of_ros1(tmp_path / "hall.bag", compression=compression)
    data, magic = bag.read_bytes(), {"bz2": b"BZh9", "lz4": b'\x04"M\x18'}[compression.name.lower()]
    begin = data.index(magic) + len(magic)
    bag.write_bytes(data[:begin] + bytes(100) + data[begin + 100 :])
    ((problem, _),) = problems(bag)
    assert problem.startswith("the first message on /scan is not of type sensor_msgs/LaserScan: ")
    with RecordedBag(bag) as opened, pytest.raises(PluginError, match="the bag cannot be read"):
        list(opened.messages(list(opened.topics.values()), Encoding.ROS1))


@pytest.mark.long
def test_a_type_that_nobody_knows_is_named_and_the_rest_can_be_played(tmp_path, play):
    import sqlite3

    path = scans_of_ros2(tmp_path / "custom", others=("/note",), sqlite=True)
    for line in (
        "std_msgs/msg/String",
    ):  # as a bag of Humble, whose sqlite3 holds no definition, names a type of yours
        metadata = path / "metadata.yaml"
        metadata.write_text(metadata.read_text().replace(line, "my_msgs/msg/Note"))
        (file,) = path.glob("*.db3")
        with closing(sqlite3.connect(file)) as database, database:
            database.execute("UPDATE topics SET type = 'my_msgs/msg/Note' WHERE type = ?", (line,))
            database.execute("DELETE FROM message_definitions")
    ((problem, fix),) = problems(path)
    assert problem == "the type my_msgs/Note of /note is not known: the bag holds no definition"
    assert fix.startswith("Leave /note out: topics=['/scan']")
    assert problems(path, topics=["/scan"]) == []
    assert play(path, topics=["/scan"])[1].measures["PlayedMessages"] == 20


def test_who_else_publishes_a_topic_of_the_bag_stops_the_run_before_it_is_played(play, scans):
    def sensor(link):
        link.known_topics["/scan"] = SCAN
        link.known_publishers["/scan"] = [GraphEndpoint("/laser_driver", SCAN)]

    with pytest.raises(PluginError, match="/laser_driver publishes /scan, too"):
        play(scans["mcap"], prepare=sensor)
    assert play(scans["mcap"], topics=["/note"], prepare=sensor)[1].measures["PlayedMessages"] == 1


def test_topics_that_are_meant_for_many_publishers_are_played_beside_those_of_the_software_under_test(tmp_path, play):
    shared = ("/tf", "/alice/tf_static", "/diagnostics", "/rosout", "/rosout_agg", "/parameter_events")

    def slam(link):
        for topic in shared:  # a SLAM node tells where the map is; each node publishes its logs and parameters
            link.known_publishers[topic] = [GraphEndpoint("/slam", "std_msgs/String")]

    _, context = play(scans_of_ros2(tmp_path / "all", others=shared), prepare=slam)
    assert context.measures["PlayedMessages"] == 20 + len(shared)
    assert not context.broker.findings


def test_who_publishes_the_time_or_begins_while_the_bag_is_played_is_told(play, scans):
    def clock(link):
        link.known_topics["/clock"] = "rosgraph_msgs/Clock"
        link.known_publishers["/clock"] = [GraphEndpoint("/gazebo", "rosgraph_msgs/Clock")]

    with pytest.raises(PluginError, match="/gazebo publishes /clock, too"):
        play(scans["mcap"], clock=True, prepare=clock)

    def later(link):
        rival = [GraphEndpoint("/laser_driver", SCAN)]
        link._clock.at(link._clock.now() + 0.5, lambda: link.known_publishers.update({"/scan": rival}))

    _, context = play(scans["mcap"], topics=["/scan"], prepare=later)
    assert [each.problem for each in context.broker.findings] == [
        "while the bag was played, /laser_driver publishes /scan, too"
    ]


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate": 0},
        {"rate": -1.0},
        {"rate": True},
        {"topics": []},
        {"topics": "/scan"},
        {"by": "lnik"},
        {"settle_s": -1},
    ],
)
def test_parameters_that_cannot_be_are_refused(wrong):
    with pytest.raises(PluginError, match=f"{next(iter(wrong))} is"):
        PlayBag("hall.mcap", **wrong)


def test_a_bag_for_each_treatment_takes_as_long_as_it_is(scans):
    plugin = PlayBag(treatment("Bag"), rate=2.0)
    from robot_runner.core.treatments import built_with

    assert built_with(plugin, {"Bag": scans["mcap"]}).duration_s({}) == pytest.approx(0.575)
    assert built_with(plugin, {"Bag": "nowhere.bag"}).duration_s({}) is None


def _heard(link, robot, plugin, folder):
    """Play for real; return what another participant of the graph heard: arrival (s) and message."""
    heard = []
    link.subscribe("/scan", SCAN, lambda message: heard.append((time.monotonic(), message)))
    time.sleep(0.5)
    context = make_context(folder, plugin, robot=robot, clock=SystemClock())
    try:
        measures = rehearse(context, plugin)
        deadline = time.monotonic() + 20.0
        while len(heard) < 20 and time.monotonic() < deadline:
            time.sleep(0.02)
    finally:
        context.resources.close()
        link.close()
    return heard, measures, context


def _check_heard(play):
    """Check what others hear of a bag; its times more than once, since a busy machine may delay any message."""
    for attempt in range(5):
        heard, measures = play(attempt)
        assert [message["header"]["stamp"]["nanosec"] for _, message in heard] == [
            number * PERIOD_NS % 10**9 for number in range(20)
        ]
        assert heard[7][1]["ranges"][0] == 7.5
        assert measures["PlayedMessages"] == 20
        assert measures["PlayTime"] >= 0.475
        took = heard[-1][0] - heard[0][0]
        if took == pytest.approx(0.475, abs=0.1) and measures["PlayTime"] < 0.7:
            return
    pytest.fail(f"the bag was heard for {took:g} s, and its PlayTime is {measures['PlayTime']:g} s")


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_another_participant_hears_the_bag_over_dds(tmp_path, monkeypatch, scans, kind):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)

    def play(attempt):
        domain = claim_domain()
        listener = open_dds_link({"domain": str(domain), "distro": "jazzy"}, SystemClock())
        plugin = PlayBag(scans[kind], topics=["/scan"], rate=2.0)
        return _heard(listener, f"dds:domain={domain},distro=jazzy", plugin, tmp_path / str(attempt))[:2]

    _check_heard(play)


@quiet_about_rospy
@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_node_hears_the_bag_over_ros_1(tmp_path, master_uri, scans, kind):
    def play(attempt):
        listener = open_ros1_link({"master": master_uri}, SystemClock(), "")
        plugin = PlayBag(scans[kind], topics=["/scan"], rate=2.0)
        return _heard(listener, f"ros1:master={master_uri}", plugin, tmp_path / str(attempt))[:2]

    _check_heard(play)


@pytest.mark.long
@quiet_about_rospy
@pytest.mark.skipif(shutil.which("rosbag") is None, reason="rosbag is not installed")
def test_rosbag_play_plays_it_and_its_end_ends_the_mission(tmp_path, master_uri, scans):
    plugin = PlayBag(scans["bag"], topics=["/scan"], rate=2.0, by="program")
    listener = open_ros1_link({"master": master_uri}, SystemClock(), "")
    heard, measures, context = _heard(listener, f"ros1:master={master_uri}", plugin, tmp_path)
    assert len(heard) == 20
    assert list(measures) == ["PlayTime"]
    (measure,) = plugin.measures
    assert measure.description == "From the bag's first message until the program that played it had ended."
    assert 0.3 < measures["PlayTime"] == pytest.approx(context.window.duration - 0.1, abs=0.1)
    assert not context.broker.findings


def test_the_window_begins_before_the_first_message_that_a_program_plays(tmp_path, scans):
    class Graph:
        def subscribe_raw(self, topic, message_type, callback):
            self.callback = callback
            return io.BytesIO()  # to be closed

    graph, begun = Graph(), []

    def begin_window():
        begun.append(time.monotonic())
        if len(begun) == 3:
            graph.callback(b"")

    with RecordedBag(scans["bag"]) as bag:
        topics = bag.chosen(["/scan"])
    player = ProgramPlayer(["sleep", "60"], Encoding.ROS1, tmp_path, SystemClock())
    with closing(player):
        player.await_first(graph, topics, begin_window)
    assert len(begun) == 3  # never once it has come: it and those until the next look would be missing from the window


@pytest.mark.parametrize(
    ("kind", "robot", "fix"),
    [
        ("mcap", "ros2:domain=7", "Say by='link', or set ROS_DOMAIN_ID to that of the robot."),
        ("bag", "ros1:master=http://robot:11311", "Say by='link', or set ROS_MASTER_URI to that of the robot."),
        ("bag", "ros2", "Say by='link'."),  # the program plays it on a graph of ROS 1
        ("mcap", "rosbridge://robot", "Say by='link'."),  # nothing tells which graph is behind it
    ],
)
def test_who_would_play_on_another_graph_is_told_what_helps(monkeypatch, scans, kind, robot, fix):
    monkeypatch.setattr(shutil, "which", lambda _: "/opt/ros/bin/program")
    for variable in ("ROS_DOMAIN_ID", "ROS_MASTER_URI"):
        monkeypatch.delenv(variable, raising=False)
    plugin = PlayBag(scans[kind], topics=["/scan"], by="program")
    (elsewhere,) = plugin.check(Circumstances(robot=robot))
    assert elsewhere.is_error
    assert elsewhere.fix == fix


@over_dds
@pytest.mark.long
def test_the_player_of_ros_2_gets_its_words_and_its_failure_is_told(tmp_path, monkeypatch, scans):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = claim_domain()
    program, said = tmp_path / "ros2", tmp_path / "words.txt"
    script = f"""
import sys, time
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.core.events.context import SystemClock
open({str(said)!r}, "w").write(" ".join(sys.argv[1:]))
link = open_dds_link({{"domain": "{domain}", "distro": "jazzy"}}, SystemClock())
for number in range(20):
    link.publish("/scan", "{SCAN}", {{"header": {{"stamp": {{"sec": 1, "nanosec": number}}}}}})
    time.sleep(0.02)
link.close()
sys.exit("no storage plugin" if "--clock" in sys.argv else 0)
"""
    (tmp_path / "player.py").write_text(script)
    program.write_text(f'#!/bin/sh\nexec {shlex.join([sys.executable, str(tmp_path / "player.py")])} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    robot = f"dds:domain={domain},distro=jazzy"
    plugin = PlayBag(scans["mcap"], topics=["/scan"], rate=0.5, by="program")
    monkeypatch.setenv("ROS_DOMAIN_ID", "101")
    (elsewhere,) = plugin.check(Circumstances(robot=robot))
    assert "ros2 would play on the graph that this machine's environment names" in elsewhere.problem
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    assert list(plugin.check(Circumstances(robot=robot))) == []
    context = make_context(tmp_path / "one", plugin, robot=robot, clock=SystemClock())
    measures = rehearse(context, plugin)
    context.resources.close()
    assert said.read_text() == f"bag play {scans['mcap']} --rate 0.5 --topics /scan"
    assert 0.2 < measures["PlayTime"] < 5.0
    failing = PlayBag(scans["mcap"], topics=["/scan"], by="program", clock=True)
    context = make_context(tmp_path / "two", failing, robot=robot, clock=SystemClock())
    with pytest.raises(PluginError, match="ros2 ended with exit code 1: no storage plugin"):
        rehearse(context, failing)
    context.resources.close()


@over_dds
def test_a_type_that_the_graph_does_not_know_fails_the_attempt_before_the_mission(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    bag = new_bag(tmp_path, Encoding.CDR)
    topic = bag.add_topic("/note", "my_msgs/Note", "string text\n")
    bag.write(topic, BEGIN_NS, b"\0\1\0\0\3\0\0\0hi\0")
    bag.close()
    plugin = PlayBag(bag.path)
    robot = f"dds:domain={claim_domain()},distro=jazzy"
    assert list(plugin.check(Circumstances(robot=robot))) == []
    context = make_context(tmp_path, plugin, robot=robot, clock=SystemClock())
    with pytest.raises(LinkError, match="my_msgs/Note"):
        rehearse(context, plugin)
    context.resources.close()
