"""Topics recorded into bags, which rosbags reads."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import tracemalloc
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tests.core.links.ssh_server import SshServer
from tests.waiting import wait_until

from robot_runner.core.errors import PluginError
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.events.measure import Origin
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Qos
from robot_runner.core.links.ssh_command import for_any_shell
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.meter_process import MeterProcess
from robot_runner.ros import bag_recorder
from robot_runner.ros.bag_file import began_late, messages_in, new_bag
from robot_runner.ros.bag_recorder import BagProgram
from robot_runner.ros.recorded_bag import RecordedBag
from robot_runner.ros.ros_bag import RosBag
from robot_runner.ros.shapes import completed
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.ros.undelivered import drop_undelivered
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, ProfilerContract, make_context, rehearse

#: No message is shorter: its encoding, and no field.
EMPTY_CDR = b"\0\1\0\0"
STAND_IN = Path(__file__).with_name("bag_program.py")


class TestRosBagOfTheSimulatedRobot(ProfilerContract):
    def make_plugin(self):
        return RosBag(["odom", "battery_state"])


class HeardRobotLink(FakeRobotLink):
    """A link to a robot whose topics have one more subscriber each time that somebody asks, as a recorder begins."""

    def subscribers(self, topic):
        earlier = self.known_subscribers.setdefault(topic, [])
        earlier.append(GraphEndpoint("/recorder", "nav_msgs/Odometry"))
        return list(earlier)


def _robot(clock, *, is_simulated=False, link=HeardRobotLink):
    robot = link(clock, is_simulated=is_simulated)
    robot.known_topics |= {"odom": "nav_msgs/Odometry", "voice": "std_msgs/String"}
    clock.every(0.1, lambda: robot.deliver("odom", {"child_frame_id": "base"}))
    clock.every(0.5, lambda: robot.deliver("voice", {"data": f"it is {clock.now():.1f}"}))
    return robot


@pytest.fixture
def record(tmp_path):
    def execute(plugin, make=_robot, robot="ros2", **how):
        clock = FakeClock(50.0)
        links = FakeLinks(robot=make(clock, **how))
        context = make_context(tmp_path, plugin, robot=robot, links=links, clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(2.0))
        return context

    return execute


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """Put stand-ins for ROS' own recorders before everything else on the path, and return their folder."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("ros2", "rosbag"):
        script = folder / name
        words = [sys.executable, str(STAND_IN), name]
        script.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
        script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder


def _read(path):
    """Return topic, stamp and message of everything in a bag, with the definitions that it brings along."""
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        return [
            (connection.topic, stamp, reader.deserialize(data, connection.msgtype))
            for connection, stamp, data in reader.messages()
        ]


def test_what_is_heard_in_the_measured_window_is_in_the_bag(record):
    context = record(RosBag(["odom", "voice"], by="link"))
    messages = _read(context.raw_data_folder / "bag.mcap")
    assert {topic for topic, _, _ in messages} == {"/odom", "/voice"}
    assert context.measures["BagMessages"] == len(messages) == 24
    assert context.measures["BagSize"] == (context.raw_data_folder / "bag.mcap").stat().st_size
    assert [message.child_frame_id for topic, _, message in messages if topic == "/odom"] == ["base"] * 20
    stamps = [stamp for _, stamp, _ in messages]
    assert 50_000_000_000 <= min(stamps) <= max(stamps) <= 52_000_000_000


def test_a_topic_with_two_names_is_recorded_once(record):
    context = record(RosBag(["odom", "/odom"], by="link"))
    assert context.measures["BagMessages"] == len(_read(context.raw_data_folder / "bag.mcap")) == 20


@pytest.mark.parametrize("others", [["odom"], []])
def test_what_publishers_keep_for_late_comers_is_at_the_beginning_of_the_bag(tmp_path, others):
    clock = FakeClock(50.0)
    link = _robot(clock, link=FakeRobotLink)
    link.known_topics |= {"/map_name": "std_msgs/String"}
    link.known_publishers["/map_name"] = [GraphEndpoint("/map", "std_msgs/String", qos=Qos.TRANSIENT_LOCAL)]
    plugin = RosBag([*others, "/map_name"], by="link")
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=link), clock=clock)
    started = plugin.start_run

    def start_run(context):
        started(context)
        link.deliver("/map_name", {"data": "hall"})  # as it comes with the subscription
        clock.sleep(3.0)

    plugin.start_run = start_run
    rehearse(context, plugin, mission=lambda: clock.sleep(2.0))
    messages = _read(context.raw_data_folder / "bag.mcap")
    assert len(messages) == context.measures["BagMessages"] == 1 + 20 * len(others)
    ((stamp, kept),) = [(stamp, message) for topic, stamp, message in messages if topic == "/map_name"]
    assert kept.data == "hall"
    assert stamp == min(each for _, each, _ in messages) >= (53e9 if others else 50e9)


def test_the_simulated_robot_is_recorded_and_says_so(record, programs):
    context = record(RosBag(["odom"]), is_simulated=True)
    assert {each.origin for each in context.broker.measures.values()} == {Origin.SIMULATED}
    assert messages_in(context.raw_data_folder) == context.measures["BagMessages"]
    with pytest.raises(PluginError, match="cannot record a simulated robot"):
        record(RosBag(["odom"], by="program"), is_simulated=True)


@pytest.mark.parametrize(
    ("robot", "is_its_graph"),
    [
        ("dds:domain=7", False),
        ("rosbridge://robot:9090", False),
        ("ros2:domain=3,namespace=/alice", True),
        ("ros2://alice", True),
    ],
)
def test_the_recorder_of_ros_is_used_on_no_other_graph_than_the_robot_s(
    record, programs, monkeypatch, robot, is_its_graph
):
    monkeypatch.setenv("ROS_DOMAIN_ID", "3")
    messages = record(RosBag(["/odom"]), robot=robot).measures["BagMessages"]
    assert (messages == 1) is is_its_graph, "the stand-in for the program records one message"


def test_the_recorder_of_ros_is_used_where_it_is_there(record, programs):
    context = record(RosBag(["odom", "voice"]))
    assert context.measures["BagMessages"] == 2
    assert not context.broker.findings


def test_a_recorder_that_does_not_subscribe_makes_its_bag_doubtful(record, programs):
    context = record(RosBag(["odom"], patience=0.1), link=FakeRobotLink)
    assert [each.problem for each in context.broker.findings] == ["the recorder did not subscribe /odom within 0.1 s"]


def test_of_a_recorder_that_begins_before_the_mission_it_is_said_how_to_record_the_mission_alone(tmp_path, programs):
    clock, bag = FakeClock(50.0), RosBag(["odom"])
    context = make_context(tmp_path, bag, robot="ros2", links=FakeLinks(robot=_robot(clock)), clock=clock)

    def mission():
        clock.sleep(1.0)
        context.begin_window()
        clock.sleep(2.0)

    rehearse(context, bag, mission=mission)
    (finding,) = context.broker.findings
    assert "the mission took 2.000 s of that" in finding.problem
    assert "by='link'" in finding.fix


def test_a_bag_that_begins_after_the_mission_says_by_how_much(tmp_path):
    begin = 1_700_000_000 * 10**9
    bag = new_bag(tmp_path, Encoding.CDR)
    definition = TypeCatalogue.of(2).definition("std_msgs/String")
    late, later = (bag.add_topic(name, "std_msgs/String", definition) for name in ("/late", "/at_the_end"))
    for number in range(20):
        bag.write(late, begin + 350_000_000 + number * 100_000_000, EMPTY_CDR)
    bag.write(later, begin + 3_000_000_000, EMPTY_CDR)
    bag.close()
    assert began_late(tmp_path, begin) == pytest.approx(0.25)
    assert began_late(tmp_path, begin + 300_000_000) == 0.0
    assert began_late(tmp_path / "nothing", begin) == 0.0


def _qos_by_topic(path):
    with AnyReader([path]) as reader:
        return {connection.topic: connection.ext.offered_qos_profiles for connection in reader.connections}


def test_others_can_play_what_was_recorded_with_the_qos_of_its_publishers(record, tmp_path):
    def robot(clock, **how):
        link = _robot(clock, **how)
        link.known_publishers["/odom"] = [GraphEndpoint("/base", "nav_msgs/Odometry", qos=Qos.SENSOR_DATA)]
        link.known_publishers["/voice"] = [GraphEndpoint("/a", "std_msgs/String", qos=Qos.TRANSIENT_LOCAL)]
        return link

    context = record(RosBag(["odom", "voice"], by="link"), make=robot)
    folder = context.raw_data_folder
    for path in (folder, folder / "bag.mcap"):  # by its metadata.yaml, and by the file alone
        offered = _qos_by_topic(path)
        ((odom,), (voice,)) = offered["/odom"], offered["/voice"]
        assert (odom.reliability.name, odom.durability.name, odom.depth) == ("BEST_EFFORT", "VOLATILE", 5)
        assert (voice.reliability.name, voice.durability.name, voice.depth) == ("RELIABLE", "TRANSIENT_LOCAL", 1)
        assert odom.deadline == (9223372036, 854775807)
    told = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (told["version"], told["storage_identifier"], told["relative_file_paths"]) == (5, "mcap", ["bag.mcap"])
    assert (
        told["message_count"]
        == context.measures["BagMessages"]
        == sum(each["message_count"] for each in told["topics_with_message_count"])
    )
    assert [*map(str, _read(folder))] == [*map(str, _read(folder / "bag.mcap"))]
    with RecordedBag(folder) as bag:  # and so does our own player
        assert {topic.name: topic.qos for topic in bag.chosen(None)} == {
            "/odom": Qos.SENSOR_DATA, "/voice": Qos.TRANSIENT_LOCAL
        }  # fmt: skip
        assert bag.begin_ns == told["starting_time"]["nanoseconds_since_epoch"]
        assert bag.end_ns - bag.begin_ns == told["duration"]["nanoseconds"]


def test_a_bag_of_nothing_can_still_be_opened(tmp_path):
    bag = new_bag(tmp_path, Encoding.CDR)
    bag.add_topic('/odd " name: [', "std_msgs/String", "string data\n")
    bag.close()
    with AnyReader([tmp_path]) as reader:
        assert (reader.message_count, [each.topic for each in reader.connections]) == (0, ['/odd " name: ['])


def test_it_is_not_used_where_the_link_is_asked_for(record, programs):
    assert record(RosBag(["odom"], by="link")).measures["BagMessages"] > 2


@pytest.mark.parametrize("encoding", list(Encoding))
def test_both_recorders_finish_their_bags(tmp_path, programs, encoding):
    folder = tmp_path / "raw"
    folder.mkdir()
    recorder = BagProgram(encoding, ["/odom", "/voice"], folder)
    assert recorder.close() is None
    assert messages_in(folder) == 2


def test_a_recorder_is_ended_where_the_run_is_interrupted_while_it_starts(tmp_path, programs, monkeypatch):
    begun = []

    def interrupt(process, *_, **__):
        begun.append(process)
        raise RunInterrupted

    monkeypatch.setattr(MeterProcess, "wait", interrupt)
    with pytest.raises(RunInterrupted):
        BagProgram(Encoding.CDR, ["/odom"], tmp_path)
    assert not begun[0].is_running


def test_a_recorder_that_cannot_start_fails_the_run_with_what_it_said(tmp_path, programs):
    (programs / "ros2").write_text("#!/bin/sh\necho 'no such topic' >&2\nexit 3\n")
    with pytest.raises(PluginError, match="no such topic"):
        BagProgram(Encoding.CDR, ["/odom"], tmp_path)


@pytest.fixture
def server(tmp_path):
    """Start a real SSH server, which ssh knows as `robot`, with a login that writes something."""
    (tmp_path / "sshd").mkdir()
    login = """ForceCommand printf 'Welcome\\nrobot'; exec sh -c "$SSH_ORIGINAL_COMMAND\""""
    server = SshServer(tmp_path / "sshd", line=login)
    yield server
    server.stop()


@pytest.fixture
def record_there(tmp_path, programs, server):
    """Return what begins to record on the robot; it returns the recorder, and its folder over there."""
    setup, folder = tmp_path / "setup.bash", tmp_path / "raw"
    setup.write_text(f"export PATH={programs}:$PATH\n")
    folder.mkdir()

    def begin(encoding=Encoding.CDR, config=server.config):
        recorder = BagProgram(encoding, ["/odom"], folder, host="robot", setup=str(setup), ssh_config=config)
        return recorder, Path(recorder._there)

    return begin


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_bag_that_was_recorded_on_the_robot_is_fetched_and_removed_there(tmp_path, record_there, encoding):
    recorder, there = record_there(encoding)
    assert recorder.close() is None
    assert messages_in(tmp_path / "raw") == 1
    assert not there.exists()


def test_a_bag_that_does_not_arrive_stays_on_the_robot_and_is_told_of(tmp_path, record_there, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    (here / "tar").write_text("#!/bin/sh\necho 'No space left on device' >&2\nexit 2\n")
    (here / "tar").chmod(0o755)
    monkeypatch.setenv("PATH", f"{here}:{os.environ['PATH']}")
    recorder, there = record_there()
    assert recorder.close() == f"the bag could not be fetched: No space left on device; it is in {there} on robot"
    assert messages_in(there) == 1
    shutil.rmtree(there)


@pytest.mark.long
def test_a_bag_is_fetched_without_being_held_in_memory(tmp_path):
    there, here = tmp_path / "there", tmp_path / "here"
    for each in (there, here):
        each.mkdir()
    with (there / "bag.mcap").open("wb") as bag:
        bag.truncate(100_000_000)
    tracemalloc.start()
    try:
        assert bag_recorder._unpacked(["sh", "-c", for_any_shell(f"tar -C {there} -cf - .")], here) is None
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()
    assert (here / "bag.mcap").stat().st_size == 100_000_000


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files to others")
def test_a_bag_that_is_fetched_belongs_to_who_fetches_it(tmp_path):
    """For root, tar gave it to whoever has the number here that the robot's user has there, setuid included."""
    there, here = tmp_path / "there", tmp_path / "here"
    for folder in (there, here):
        folder.mkdir()
    (there / "bag.mcap").touch()
    os.chown(there / "bag.mcap", 12345, 12345)
    (there / "bag.mcap").chmod(0o4755)
    assert bag_recorder._unpacked(["sh", "-c", for_any_shell(f"tar -C {there} -cf - .")], here) is None
    found = (here / "bag.mcap").stat()
    assert (found.st_uid, found.st_mode & 0o7000) == (0, 0)


@pytest.mark.parametrize(
    ("sending", "unpacking", "told"),
    [
        ("echo 'connection lost' >&2; exit 255", 'exec {tar} "$@"', "could not be fetched: connection lost"),
        # As much as a pipe does not take, so that the command does not end by itself.
        ("exec cat /dev/zero", "echo 'disk full' >&2; exit 2", "could not be fetched: disk full"),
        ("exec sleep 60", 'exec {tar} "$@"', "could not be fetched: nothing came for 1 s"),
    ],
)
def test_why_a_bag_does_not_arrive_is_told(tmp_path, monkeypatch, sending, unpacking, told):
    (tmp_path / "tar").write_text(f"#!/bin/sh\n{unpacking.format(tar=shutil.which('tar'))}\n")
    (tmp_path / "tar").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(bag_recorder, "_SILENCE", 1.0)
    monkeypatch.setattr(bag_recorder, "_ENDING", 1.0)
    assert told in bag_recorder._unpacked(["sh", "-c", for_any_shell(sending)], tmp_path)


def test_a_bag_may_take_as_long_to_fetch_as_it_needs_while_some_of_it_arrives(tmp_path):
    """One of hours, over Wi-Fi: it was given up after ten minutes, whatever arrived."""

    class SlowTar:
        def __init__(self, arriving):
            self.arriving = arriving

        def communicate(self, timeout):
            if not self.arriving:
                return None, b"done"
            self.arriving -= 1
            with (tmp_path / "bag.mcap").open("ab") as bag:
                bag.write(b".")
            raise subprocess.TimeoutExpired("tar", timeout)

    assert bag_recorder._last_words(SlowTar(arriving=1000), tmp_path) == b"done"
    assert (tmp_path / "bag.mcap").stat().st_size == 1000


def test_a_bag_of_which_nothing_arrives_is_given_up_after_one_silence(tmp_path):
    class HangingTar:
        tries = 0

        def communicate(self, timeout):
            self.tries += 1
            raise subprocess.TimeoutExpired("tar", timeout)

    (tmp_path / "bag.mcap").write_bytes(b"what came before")
    tar = HangingTar()
    with pytest.raises(subprocess.TimeoutExpired):
        bag_recorder._last_words(tar, tmp_path)
    assert tar.tries == 1


def test_a_bag_that_its_recorder_has_not_finished_stays_on_the_robot_and_is_told_of(
    programs, record_there, monkeypatch
):
    (programs / "ros2").write_text("#!/bin/sh\ntrap '' INT\ntouch bag.mcap.active\nexec sleep 5\n")
    recorder, there = record_there()
    monkeypatch.setattr(bag_recorder, "_GRACE", 0.2)
    assert recorder.close() == f"the recorder has not finished the bag within 0.2 s; it is in {there} on robot"
    assert (there / "bag.mcap.active").exists()
    shutil.rmtree(there)


@contextmanager
def network_that_is_cut(server):
    """Yield a config for ssh that leads through a proxy, and what cuts the network and ends ssh's side of it.

    As of a machine that is gone, nobody tells the server so, until it sends something: that is answered by a reset.
    """
    is_cut = threading.Event()

    def forward(source, target):
        with suppress(OSError):
            while (data := source.recv(1 << 16)) and not is_cut.is_set():
                target.sendall(data)

    with ExitStack() as opened, socket.create_server(("127.0.0.1", 0)) as listening:
        config = server.folder / "cut_config"
        port, there = f"Port {listening.getsockname()[1]}", f"HostKeyAlias [127.0.0.1]:{server.port}"
        config.write_text(server.config.read_text().replace(f"Port {server.port}", f"{port}\n    {there}"))

        def take():
            near = opened.enter_context(listening.accept()[0])
            far = opened.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            threading.Thread(target=forward, args=(near, far), daemon=True).start()
            forward(far, near)
            drop_undelivered(far)
            far.close()

        threading.Thread(target=take, daemon=True).start()
        yield config, is_cut.set


def test_a_recorder_on_the_robot_ends_some_seconds_after_the_network_was_cut(server, record_there, monkeypatch):
    """It would go on for hours, fill the robot's disk, and disturb later runs."""
    monkeypatch.setattr(bag_recorder, "_BEAT", 0.2)
    with network_that_is_cut(server) as (config, cut):
        recorder, there = record_there(config=config)
        cut()
        recorder._process.stop(signal.SIGKILL, grace=60.0)
        wait_until((there / "done").exists)
    assert messages_in(there) == 1
    shutil.rmtree(there)


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_bag_has_the_format_of_its_generation(tmp_path, encoding):
    number = 1 if encoding is Encoding.ROS1 else 2
    types = TypeCatalogue.of(number)
    bag = new_bag(tmp_path, encoding)
    sent = {}
    for topic, name in (("/odom", "nav_msgs/Odometry"), ("/scan", "sensor_msgs/LaserScan"), ("/go", "std_msgs/Empty")):
        message = completed(types.shape(name), {}, where=topic)
        channel = bag.add_topic(topic, name, types.definition(name))
        bag.write(channel, 10**18 + len(sent), types.serialise(name, message, encoding))
        sent[topic] = 10**18 + len(sent)
    bag.close()
    bag.close()
    assert bag.path.suffix == {1: ".bag", 2: ".mcap"}[number]
    assert {topic: stamp for topic, stamp, _ in _read(bag.path)} == sent


def test_a_bag_of_ros_1_has_the_sums_of_ros_1(tmp_path):
    types = TypeCatalogue.of(1)
    bag = new_bag(tmp_path, Encoding.ROS1)
    bag.add_topic("/odom", "nav_msgs/Odometry", types.definition("nav_msgs/Odometry"))
    bag.close()
    with AnyReader([bag.path]) as reader:
        assert reader.connections[0].digest == "cd5e73d190d741a2f92e81eda573aca7"


@pytest.mark.parametrize("full", ["robot_runner.ros.bag_file.McapBag.write", "mcap.writer.Writer.finish"])
def test_a_disk_that_is_full_is_told_of(record, monkeypatch, full):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(full, fail)
    context = record(RosBag(["odom"], by="link"))
    assert any("No space left" in each.problem for each in context.broker.findings)


def test_a_topic_that_is_not_there_is_warned_of_and_none_at_all_fails_the_run(record):
    context = record(RosBag(["odom", "scan"], by="link", patience=0.5))
    assert any("scan is not published" in each.problem for each in context.broker.findings)
    with pytest.raises(PluginError, match="none of the topics scan is there") as caught:
        record(RosBag(["scan"], patience=0.5))
    assert "/odom" in caught.value.fix


def test_no_thread_outlives_the_run(record):
    before = set(threading.enumerate())
    record(RosBag(["odom"], by="link"))
    deadline = time.monotonic() + 60.0
    while set(threading.enumerate()) - before:
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [({"topics": []}, "topics is"), ({"topics": "odom"}, "topics is 'odom'"), ({"by": "robot"}, "by is 'robot'")],
)
def test_arguments_that_cannot_be_are_refused(arguments, problem):
    with pytest.raises(PluginError, match=problem):
        RosBag(**arguments)


@pytest.mark.parametrize("damaged", ["metadata.yaml", "bag.mcap"])
def test_a_bag_that_its_recorder_left_broken_has_no_number_of_messages_and_fails_no_run(tmp_path, damaged):
    bag = new_bag(tmp_path, Encoding.CDR)
    topic = bag.add_topic("/chatter", "std_msgs/String", "string data")
    for number in range(1, 4):
        bag.write(topic, number * 10**9, EMPTY_CDR)
    bag.close()
    assert messages_in(tmp_path) == 3
    data = (tmp_path / damaged).read_bytes()
    (tmp_path / damaged).write_bytes(b"\xff" * 40 + data[40:])
    assert messages_in(tmp_path) is None
    assert began_late(tmp_path, 0) == 0.0


#: Recorders that end as they should, and leave no bag.
BROKEN, UNFINISHED = "mkdir bag && echo garbage >bag/bag_0.mcap", "touch bag.bag.active"


@pytest.mark.parametrize(
    ("leaves", "problem"),
    [
        (BROKEN, "the bag that its recorder left cannot be read"),
        (UNFINISHED, "the recorder has not finished the bag within 0.1 s"),
    ],
)
def test_why_a_bag_has_no_number_of_messages_is_told(record, programs, monkeypatch, leaves, problem):
    monkeypatch.setattr(bag_recorder, "_GRACE", 0.1)
    (programs / "ros2").write_text(f"#!/bin/sh\n{leaves}\nexec sleep 60\n")
    context = record(RosBag(["odom"]))
    assert context.measures["BagMessages"] is None
    assert [each.problem for each in context.broker.findings] == [problem]


@pytest.mark.parametrize(
    ("robot", "by", "missing", "problems"),
    [
        ("simulated", "auto", (), []),
        ("simulated", "auto", ("mcap",), ["mcap, which writes the bag, cannot be imported"]),
        ("simulated", "program", (), ["ros2 cannot record a simulated robot"]),
        ("dds", "link", ("mcap",), ["mcap, which writes the bag, cannot be imported"]),
        ("dds:domain=7", "auto", ("mcap", "ros2"), ["mcap, which writes the bag, cannot be imported"]),
        ("ros2", "auto", ("mcap",), []),
        ("ros1", "link", ("rosbags",), ["rosbags, which writes the bag, cannot be imported"]),
        ("ros1", "link", ("mcap",), []),
        ("ros1", "program", ("rosbag",), ["the program 'rosbag', which records the bag, is not there"]),
        ("ros1", "program", ("rosbags",), []),
        ("rosbridge://robot:9090", "link", ("mcap",), []),
    ],
)
def test_the_check_tells_what_is_missing_to_write_the_bag(monkeypatch, robot, by, missing, problems):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in missing else name)
    monkeypatch.setattr("shutil.which", lambda name: None if name in missing else name)
    findings = list(RosBag(["odom"], by=by).check(Circumstances(robot=robot)))
    assert [each.problem for each in findings] == problems
    assert all(each.is_error and each.fix for each in findings)


def test_the_host_or_the_setup_file_has_the_program_that_records(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert list(RosBag(["odom"], by="program", setup="/opt/ros/noetic/setup.bash").check(Circumstances("ros1"))) == []
