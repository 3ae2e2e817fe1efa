"""What can be read of a bag: what others wrote beside it, or into it, keeps no more of it away than it must."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sqlite3
from contextlib import closing

import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from tests.ros.recordings import BEGIN_NS, scans_of_ros2

from robot_runner.core.errors import PluginError
from robot_runner.core.links.robot import Encoding, Qos
from robot_runner.ros.bag_file import new_bag
from robot_runner.ros.opened_bag import OpenedBag
from robot_runner.ros.recorded_bag import RecordedBag
from robot_runner.ros.shapes import completed
from robot_runner.ros.type_catalogue import TypeCatalogue

TEXT = bytes([0, 1, 0, 0, 3, 0, 0, 0]) + b"hi\0"


def found(path):
    """Return how many messages of each topic that can be read are found in a bag, and what it says of the others."""
    with RecordedBag(path) as bag:
        readable = [topic for topic in bag.topics.values() if topic.count and not topic.problem]
        names = [each.topic for each in bag.messages(readable, bag.encoding)]
        assert [topic for topic, _ in bag.stamps() if topic in names] == names
        problems = {topic.name: topic.problem for topic in bag.topics.values() if topic.problem}
        return {name: names.count(name) for name in sorted(set(names))}, problems


def test_the_feedback_of_an_action_is_recorded_by_the_name_that_its_type_has_in_ros_2(tmp_path):
    catalogue, kind = TypeCatalogue.of(2), "nav2_msgs/NavigateToPose_FeedbackMessage"
    bag = new_bag(tmp_path, Encoding.CDR)
    topic = bag.add_topic("/navigate_to_pose/_action/feedback", kind, catalogue.definition(kind))
    bag.write(topic, BEGIN_NS, catalogue.serialise(kind, completed(catalogue.shape(kind), {}, where="a"), Encoding.CDR))
    bag.close()
    for path in (tmp_path, bag.path):  # by its metadata.yaml, and by the file alone
        assert found(path) == ({"/navigate_to_pose/_action/feedback": 1}, {})
        with RecordedBag(path) as opened:
            assert [each.msgtype for each in opened.connections] == ["nav2_msgs/action/NavigateToPose_FeedbackMessage"]


@pytest.mark.parametrize("sqlite", [False, True])
def test_messages_are_found_whatever_quality_of_service_is_written_beside_them(tmp_path, sqlite):
    # As of bags that were converted, or whose metadata.yaml was edited so that `ros2 bag play` offers something else.
    path = scans_of_ros2(tmp_path / "hall", others=("/note",), sqlite=sqlite)
    metadata = path / "metadata.yaml"
    told = _loaded(metadata)
    topics = told["rosbag2_bagfile_information"]["topics_with_message_count"]
    of_scans = next(each["topic_metadata"] for each in topics if each["topic_metadata"]["name"] == "/scan")
    of_scans["offered_qos_profiles"] = ""
    metadata.write_text(json.dumps(told))
    assert found(path) == ({"/note": 1, "/scan": 20}, {})


@pytest.mark.parametrize(
    ("digest", "is_read"),
    [
        ("RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9", True),  # in rosidl's JSON files
        (None, True),  # that of rosbags, which has written the bag
        ("RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18", False),  # of std_msgs/String
    ],
)
def test_a_type_with_a_char_is_known_by_the_digest_of_its_version(tmp_path, digest, is_read):
    store, path, name = get_typestore(Stores.ROS2_JAZZY), tmp_path / "hall", "std_msgs/msg/Char"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        keys = writer.add_connection("/keys", name, typestore=store)
        writer.write(keys, BEGIN_NS, bytes(store.serialize_cdr(store.types[name](65), name)))
    metadata = path / "metadata.yaml"
    told = _loaded(metadata)
    (topic,) = told["rosbag2_bagfile_information"]["topics_with_message_count"]
    topic["topic_metadata"]["type_description_hash"] = digest or topic["topic_metadata"]["type_description_hash"]
    metadata.write_text(json.dumps(told))
    messages, problems = found(path)
    assert messages == ({"/keys": 1} if is_read else {})
    assert bool(problems) is not is_read


#: As genmsg, which hashes constants as they are written, has it for the definition below.
WRITTEN = "21dd847b175979fe5870d67b70aac10c"


def test_a_type_of_ros_1_is_known_by_its_digest_however_its_constants_are_written(tmp_path):
    """rosbags writes the numbers of constants anew, and hashes that: topics were refused, and bags had wrong sums."""
    constants = 'float32 LIMIT=1e-3\nuint8 MODE = 007 # of agents\nstring NAME="a" # b\n'
    part = f"{'=' * 80}\nMSG: my_msgs/Part\n{constants}int32 x\n"
    definition = f"float64 PI=3.14159265358979323846\nmy_msgs/Part[] parts\n{part}"
    bag = new_bag(tmp_path, Encoding.ROS1)
    bag.write(bag.add_topic("/gear", "my_msgs/Gear", definition), BEGIN_NS, bytes(4))
    bag.close()
    assert WRITTEN.encode() in bag.path.read_bytes()
    assert found(bag.path) == ({"/gear": 1}, {})


def test_messages_that_are_only_counted_are_told(tmp_path):
    path = scans_of_ros2(tmp_path / "hall")
    metadata = path / "metadata.yaml"
    told = _loaded(metadata)
    topics = told["rosbag2_bagfile_information"]["topics_with_message_count"]
    topics[0]["topic_metadata"]["name"] = "/renamed"
    metadata.write_text(json.dumps(told))
    problems = {
        "/renamed": "no message on /renamed is in the files of the bag, though metadata.yaml counts 20",
        "/scan": "the files of the bag have messages on /scan, and metadata.yaml counts none",
    }
    assert found(path) == ({}, problems)


@pytest.mark.parametrize("is_listed", [False, True])
@pytest.mark.parametrize("sqlite", [False, True])
def test_a_topic_of_which_the_metadata_tell_nothing_is_not_left_out_without_a_word(tmp_path, sqlite, is_listed):
    path = scans_of_ros2(tmp_path / "hall", others=("/note",), sqlite=sqlite)
    metadata = path / "metadata.yaml"
    told = _loaded(metadata)
    topics = told["rosbag2_bagfile_information"]["topics_with_message_count"]
    note = next(each for each in topics if each["topic_metadata"]["name"] == "/note")
    if is_listed:
        note["message_count"] = 0
    else:
        topics.remove(note)
    metadata.write_text(json.dumps(told))
    with RecordedBag(path) as bag:
        assert [each.name for each in bag.chosen(["/scan"])] == ["/scan"]
        for names in (None, ["/note"]):
            with pytest.raises(PluginError, match=r"the files of the bag have messages on /note, and .* counts none"):
                bag.chosen(names)
        with pytest.raises(PluginError) as refused:
            bag.chosen(None)
    (finding,) = refused.value.findings
    assert finding.fix == "Leave /note out: topics=['/scan'], or have metadata.yaml written anew: ros2 bag reindex."


def test_a_count_in_the_metadata_that_is_a_text_is_a_fault_of_the_bag(tmp_path):
    path = scans_of_ros2(tmp_path / "hall")
    metadata = path / "metadata.yaml"
    told = _loaded(metadata)
    told["rosbag2_bagfile_information"]["topics_with_message_count"][0]["message_count"] = "twenty"
    metadata.write_text(json.dumps(told))
    with pytest.raises(PluginError, match="the bag cannot be read") as refused:
        RecordedBag(path)
    assert refused.value.where == str(path)


def test_a_named_pipe_in_the_place_of_a_file_is_refused(tmp_path):
    path = scans_of_ros2(tmp_path / "hall")
    (file,) = path.glob("*.mcap")
    file.unlink()
    for pipe, named in ((file, path), (tmp_path / "hall.bag", tmp_path / "hall.bag")):
        os.mkfifo(pipe)
        with pytest.raises(PluginError, match=f"'{pipe.name}' is neither a file nor a folder"):
            RecordedBag(named)


@pytest.mark.parametrize("name", ["metadata.yaml", "hall.mcap"])
def test_a_named_pipe_in_the_only_bag_of_a_folder_is_refused(tmp_path, name):
    """It was awaited for ever."""
    path = scans_of_ros2(tmp_path / "all" / "hall")
    (path / name).unlink()
    os.mkfifo(path / name)
    with pytest.raises(PluginError, match=f"'{name}' is neither a file nor a folder") as refused:
        RecordedBag(tmp_path / "all")
    assert refused.value.where == str(path)


def test_a_pointer_of_git_lfs_in_the_only_bag_of_a_folder_is_told(tmp_path):
    path = scans_of_ros2(tmp_path / "all" / "hall")
    (path / "hall.mcap").write_text("version https://git-lfs.github.com/spec/v1")
    with pytest.raises(PluginError, match=r"'hall\.mcap' only points to a file of Git LFS"):
        RecordedBag(tmp_path / "all")


def test_a_definition_that_cannot_be_read_keeps_only_its_topic_away(tmp_path):
    # As rosbag2 writes services: the definition of both halves stands where that of the event is to be.
    bag = new_bag(tmp_path, Encoding.CDR)
    event = bag.add_topic("/add/_service_event", "my_interfaces/Add_Event", "int64 a\n---\nint64 sum\n", [Qos.DEFAULT])
    chatter = bag.add_topic("/chatter", "std_msgs/String", "string data")
    for topic in (event, chatter):
        bag.write(topic, BEGIN_NS, TEXT)
    bag.close()
    counts, problems = found(bag.path)
    assert counts == {"/chatter": 1}
    assert problems == {
        "/add/_service_event": "the bag's definition of my_interfaces/Add_Event, the type of /add/_service_event, "
        "cannot be read"
    }
    with RecordedBag(bag.path) as opened:
        with pytest.raises(PluginError) as refused:
            opened.chosen(None)
        assert refused.value.fix == (
            "Leave /add/_service_event out: topics=['/chatter'], or record a bag that holds the definition."
        )
        assert [topic.name for topic in opened.chosen(["/chatter"])] == ["/chatter"]


#: As rosbag2 writes a type that is described in IDL, with those that it is made of.
PAIR = """\
{rule}
IDL: my_interfaces/msg/Pair
// written by hand
#include "my_interfaces/msg/Half.idl"

module my_interfaces {{ module msg {{
  struct Pair {{ my_interfaces::msg::Half left; my_interfaces::msg::Half right; }};
}}; }};

{rule}
IDL: my_interfaces/msg/Half
#ifndef HALF
#define HALF
module my_interfaces {{ module msg {{ struct Half {{ long number; }}; }}; }};
#endif
"""


def test_a_type_that_is_described_in_several_files_of_idl_is_read(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "pairs.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("my_interfaces/msg/Pair", "ros2idl", PAIR.format(rule="=" * 80).encode())
        channel = writer.register_channel("/pair", "cdr", schema)
        writer.add_message(channel, 1, bytes([0, 1, 0, 0, 3, 0, 0, 0, 4, 0, 0, 0]), 1)
        writer.finish()
    assert found(path) == ({"/pair": 1}, {})
    bag = OpenedBag(path)
    with closing(bag):
        ((connection, _, data),) = bag.raw_messages(bag.connections)
        pair = bag.deserialised(connection.msgtype, data)
    assert (pair.left.number, pair.right.number) == (3, 4)


@pytest.mark.parametrize("encoding", ["jsonschema", "protobuf"])
def test_messages_that_are_none_of_ros_are_named(tmp_path, encoding):
    from mcap.writer import Writer

    path = tmp_path / "web.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("Pose", encoding, b"{}")
        channel = writer.register_channel("/pose", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(PluginError, match=f"the bag has topics with {encoding} definitions, ") as refused:
        RecordedBag(path)
    assert "mcap filter" in refused.value.fix


def test_an_index_without_topics_is_not_taken_for_an_empty_bag(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "bare.mcap"
    with path.open("wb") as file:
        writer = Writer(file, repeat_channels=False, repeat_schemas=False, use_statistics=False)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        writer.add_message(writer.register_channel("/chatter", "cdr", schema), 1, TEXT, 1)
        writer.finish()
    with RecordedBag(path) as bag, pytest.raises(PluginError, match="has 1 message, but its index names no topic"):
        bag.chosen(None)


def refusal(path):
    """Return the fix of the error with which a bag is refused."""
    with pytest.raises(PluginError) as refused:
        RecordedBag(path)
    return refused.value.fix


def test_a_folder_of_a_bag_that_is_called_as_a_file_is_found_beside_nothing_else(tmp_path):
    """`ros2 bag record -o hall.mcap` makes it; it was taken for two bags."""
    scans_of_ros2(tmp_path / "hall.mcap")
    assert found(tmp_path) == ({"/scan": 20}, {})


def test_a_bag_that_git_has_yet_to_bring_says_so_also_in_its_folder(tmp_path):
    folder = scans_of_ros2(tmp_path / "hall")
    pointer = folder / "hall.mcap"
    pointer.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 5\n")
    for path in (folder, pointer):
        with pytest.raises(PluginError, match=r"'hall\.mcap' only points to a file of Git LFS") as refused:
            RecordedBag(path)
        assert refused.value.fix == "Bring the file itself: git lfs pull."


def test_the_fix_of_a_bag_that_cannot_be_read_helps_with_its_kind(tmp_path):
    """`rosbag reindex` was named for all of them: it repairs those of ROS 1 alone."""
    renamed = scans_of_ros2(tmp_path / "hall")
    file = (renamed / "hall.mcap").rename(renamed / "tuesday.mcap")
    assert refusal(renamed) == f"Name its file, {str(file)!r}, or have metadata.yaml written anew: ros2 bag reindex."
    assert found(file) == ({"/scan": 20}, {})
    for name, program in {"cut.mcap": "mcap recover", "cut.bag": "rosbag reindex", "cut.db3": ".recover"}.items():
        (tmp_path / name).write_bytes(file.read_bytes()[:100])
        assert program in refusal(tmp_path / name)
    (tmp_path / "hall.bag.active").write_bytes(b"#ROSBAG V2.0")
    assert "rosbag reindex" in refusal(tmp_path / "hall.bag.active")


@pytest.mark.parametrize("name", ["hall #2", "hall?", "50%25"])
def test_a_sqlite_bag_with_a_name_that_rosbags_cannot_open_is_to_be_renamed(tmp_path, name):
    folder = scans_of_ros2(tmp_path / "hall", sqlite=True).rename(tmp_path / name)
    for path in (folder, folder / "hall.db3"):
        assert refusal(path) == "Rename it: rosbags opens no .db3 file with any of #?% in its path."


@pytest.mark.parametrize("kinds", [("mcap", "mcap"), ("bag", "mcap")])
def test_the_parts_of_a_recording_that_was_killed_are_not_taken_for_several(tmp_path, kinds):
    for number, kind in enumerate(kinds):
        (tmp_path / f"hall_{number}.{kind}").write_bytes(b"")
    are_parts = "Of the parts of one recording, make a bag: ros2 bag reindex" in refusal(tmp_path)
    assert are_parts == (kinds[0] == kinds[1])


def test_a_file_whose_messages_are_compressed_one_by_one_names_the_folder_that_tells_so(tmp_path):
    store, path, name = get_typestore(Stores.ROS2_HUMBLE), tmp_path / "hall", "std_msgs/msg/String"
    writer = Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        chatter = writer.add_connection("/chatter", name, typestore=store)
        writer.write(chatter, BEGIN_NS, TEXT)
    assert found(path) == ({"/chatter": 1}, {})
    assert refusal(path / "hall.db3") == f"Name the folder: {str(path)!r}."


def test_a_bag_for_which_there_is_no_room_to_unpack_it_tells_where_room_is_needed(tmp_path, monkeypatch):
    """It was taken for damaged: the fix was to record it again."""
    store, path, name = get_typestore(Stores.ROS2_HUMBLE), tmp_path / "hall", "std_msgs/msg/String"
    writer = Writer(path, version=8, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        writer.write(writer.add_connection("/chatter", name, typestore=store), BEGIN_NS, TEXT)
    assert found(path) == ({"/chatter": 1}, {})

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(shutil, "copyfileobj", full)
    assert "set TMPDIR to a folder that has room" in refusal(path)


def _loaded(metadata):
    return yaml.safe_load(metadata.read_text())


def test_a_bag_whose_last_messages_are_still_in_sqlite_s_log_is_refused_until_they_are_in_it(tmp_path):
    folder = scans_of_ros2(tmp_path / "hall", sqlite=True)
    (file,) = folder.glob("*.db3")
    recorder = tmp_path / "recorder.db3"
    shutil.copy(file, recorder)
    with closing(sqlite3.connect(recorder)) as written:  # as rosbag2 writes with the preset "resilient"
        assert written.execute("PRAGMA journal_mode=WAL").fetchone() == ("wal",)
        written.execute("INSERT INTO messages SELECT id + 100, topic_id, timestamp, data FROM messages")
        written.commit()
        for end in ("", "-wal"):  # what is there once the recorder is killed
            shutil.copy(f"{recorder}{end}", f"{file}{end}")
    for path in (folder, file):
        with pytest.raises(PluginError, match=r"messages of the bag are still in 'hall\.db3-wal'") as refused:
            RecordedBag(path)
        assert f"sqlite3 '{file}' 'PRAGMA wal_checkpoint(TRUNCATE)'" in refused.value.fix
    with closing(sqlite3.connect(file)) as mended:
        mended.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with RecordedBag(file) as bag:
        assert bag.count == 40
