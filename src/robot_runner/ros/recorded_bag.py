"""A recorded bag of either generation of ROS: what is in it, and its messages in their order."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

from robot_runner.core.errors import Finding, PluginError, did_you_mean, nearest
from robot_runner.core.links.robot import Encoding, Message, Qos
from robot_runner.core.storage.input_files import input_file
from robot_runner.core.words import counted
from robot_runner.ros.message_codec import MessageCodec
from robot_runner.ros.opened_bag import OpenedBag
from robot_runner.ros.qos_policies import Policies
from robot_runner.ros.shapes import plain_type

_SUFFIXES = (".bag", ".mcap", ".db3")
_METADATA = "metadata.yaml"
#: How what stands for a file of Git LFS begins (github.com/git-lfs/git-lfs, docs/spec.md).
_POINTER = b"version https://git-lfs"
#: So many topics are written out in a fix at most.
_FEW = 8
#: How files that were cut off are repaired, by their kinds.
_REPAIRS: Mapping[str, str] = MappingProxyType(
    {
        ".bag": "Record it again, or repair a copy: rosbag reindex COPY.bag.",
        ".mcap": "Record it again, or repair it: mcap recover IN.mcap -o OUT.mcap.",
        ".db3": "Record it again, or repair it: sqlite3 IN.db3 .recover | sqlite3 OUT.db3.",
    }
)
#: What rosbags leaves as it is in the address by which SQLite opens a file.
_OF_URIS = frozenset("#?%")
#: How what zstd compressed begins (RFC 8878, 3.1.1); no message of ROS 2 does.
_ZSTD = bytes.fromhex("28b52ffd")
#: Schema encodings in MCAP files that are not those of ROS 2 (mcap.dev, Well-known schema encodings).
_FOREIGN = frozenset({"flatbuffer", "jsonschema", "protobuf", "ros1msg"})
_WITHOUT = "Make a bag without these topics: mcap filter IN.mcap -o OUT.mcap --exclude-topic-regex '/of|/these'."
#: The fields of a header in ROS 1; ROS 2 has no `seq`.
_ROS1_HEADER = frozenset({"seq", "stamp", "frame_id"})


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a bag.

    Attributes:
        name: its full name, as it was recorded.
        message_type: ROS name without a generation.
        count: how many messages of it there are.
        qos: the profile that comes nearest to what its publishers offered.
        problem: why its messages cannot be read; empty where they can.
        remedy: what helps then.
    """

    name: str
    message_type: str
    count: int
    qos: Qos
    problem: str = ""
    remedy: str = "record a bag that holds the definition"


class RecordedMessage(NamedTuple):
    """A message of a bag: when it was recorded, ns since the epoch, its topic by full name, and its fields."""

    stamp_ns: int
    topic: str
    message: Message


class RecordedBag(OpenedBag):
    """A bag at a path that is open for reading, and its topics by full names; it is closed as a context manager.

    Raises:
        PluginError: there is no bag, it cannot be read, or the library that reads it is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = bag_at(path)
        _check_merged(self.path)
        with _told_as_broken(self.path), ExitStack() as undoing:
            super().__init__(self.path)
            undoing.callback(self.close)
            self._codec = MessageCodec(self.store, signed_bytes=self.encoding is Encoding.ROS1)
            self.topics: Mapping[str, RecordedTopic] = {each.name: each for each in self._described()}
            undoing.pop_all()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    @property
    def seconds(self) -> float:
        """From its first to its last message, s."""
        return (self.end_ns - self.begin_ns) * 1e-9

    @property
    def files_beside(self) -> int:
        """How many files the bag has of which this is one; 0 if it is not part of a folder's bag, or is all of it."""
        folder = self.path.parent
        if not (self.path.is_file() and (folder / _METADATA).is_file()):
            return 0
        return sum(each.suffix == self.path.suffix for each in folder.iterdir())

    def chosen(self, names: Sequence[str] | None) -> list[RecordedTopic]:
        """Return the topics of these names, all that have messages where none are named.

        Raises:
            PluginError: it has no such topic, or none that can be read; all that are wrong are its findings.
        """
        there = {name: topic for name, topic in self.topics.items() if topic.count}
        if not there and self.count:
            problem = f"the bag has {counted(self.count, 'message')}, but its index names no topic"
            raise PluginError(problem, where=str(self.path), fix=_repair(self.path))
        if not there:
            raise PluginError("the bag has no messages", where=str(self.path), fix="Record it again.")
        faults = []
        for name in names or ():
            if name not in there:
                problem = f"the bag has no messages on {name!r}"
                faults.append(Finding.error(str(self.path), problem, did_you_mean(name, there)))
        topics = [there[name] for name in (names or there) if name in there]
        left = [topic.name for topic in topics if not topic.problem]
        for topic in topics:
            if topic.problem:
                others = f": topics={left}" if 0 < len(left) <= _FEW else " (topics=...)"
                fix = f"Leave {topic.name} out{others}, or {topic.remedy}."
                faults.append(Finding.error(str(self.path), topic.problem, fix))
        PluginError.refuse(faults)
        return topics

    def messages(self, topics: Sequence[RecordedTopic], encoding: Encoding) -> Iterator[RecordedMessage]:
        """Yield the messages of topics of this bag, in the order in which they were recorded.

        For a link whose encoding is that of the other generation, headers come without numbers.

        Raises:
            PluginError: the bag breaks off, or a message does not follow its definition.
        """
        names = {topic.name for topic in topics}
        connections = [each for each in self.connections if each.topic in names]
        is_other = encoding is not self.encoding
        with _told_as_broken(self.path):
            for connection, stamp, data in self.raw_messages(connections):
                message = self._decoded(connection.msgtype, data)
                yield RecordedMessage(stamp, connection.topic, _without_numbers(message) if is_other else message)

    def stamps(self, topics: Sequence[RecordedTopic] | None = None) -> Iterator[tuple[str, int]]:
        """Yield topic and time, ns since the epoch, of each message, of all topics if none are given.

        Raises as `messages`, whose order it has.
        """
        names = None if topics is None else {topic.name for topic in topics}
        with _told_as_broken(self.path):
            chosen = [each for each in self.connections if names is None or each.topic in names]
            for connection, stamp, _ in self.raw_messages(chosen):
                yield connection.topic, stamp

    def _decoded(self, message_type: str, data: bytes) -> dict[str, Any]:
        return self._codec.as_mapping(message_type, self.deserialised(message_type, data))

    def _described(self) -> Iterator[RecordedTopic]:
        found: dict[str, list[Any]] = {}
        for connection in self.connections:
            found.setdefault(connection.topic, []).append(connection)
        for name, connections in found.items():
            types = sorted({plain_type(each.msgtype) for each in connections})
            count = sum(each.msgcount for each in connections)
            problem = self._unreadable(connections) if count else ""
            if len(types) > 1:
                problem = f"{name} has messages of {' and '.join(types)}"
            yield RecordedTopic(name, types[0], count, _offered(connections[0].ext), problem)
        told = {each.topic for each in self.connections if each.msgcount}
        for name, each in self.filed.items():
            if name not in told:
                problem = f"the files of the bag have messages on {name}, and {_METADATA} counts none"
                remedy = f"have {_METADATA} written anew: ros2 bag reindex"
                yield RecordedTopic(name, plain_type(each.msgtype), each.msgcount, Qos.DEFAULT, problem, remedy)

    def _unreadable(self, connections: Sequence[Any]) -> str:
        """Say why the first message of a topic cannot be read; nothing where it can."""
        first = connections[0]
        message_type = plain_type(first.msgtype)
        if fault := self.faults.get(first.msgtype):
            return f"the bag's definition of {message_type}, the type of {first.topic}, {fault}"
        if first.msgtype not in self.store.fielddefs:
            return f"the type {message_type} of {first.topic} is not known: the bag holds no definition"
        try:
            for connection, _, data in self.raw_messages(connections):
                self._check_unpacked(data)
                self._decoded(connection.msgtype, data)
                return ""
        except PluginError:
            raise
        except Exception as error:  # noqa: BLE001  # as in `_told_as_broken`
            return f"the first message on {first.topic} is not of type {message_type}: {_reason(error)}"
        count = sum(each.msgcount for each in connections)
        return f"no message on {first.topic} is in the files of the bag, though {_METADATA} counts {count}"

    def _check_unpacked(self, data: bytes) -> None:
        if data[:4] == _ZSTD and self.path.suffix == ".db3":
            problem = f"its messages are compressed one by one, as {_METADATA} beside {self.path.name!r} tells"
            raise PluginError(problem, where=str(self.path), fix=f"Name the folder: {str(self.path.parent)!r}.")


def bag_at(path: Path) -> Path:
    """Return the file or folder that a reader of bags opens: a folder of ROS 2, or the one bag in any other folder.

    Raises:
        PluginError: there is none, or more than one.
    """
    path = input_file(path)
    if not path.exists():
        beside = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
        near = nearest(path.name, beside)
        meant = near and f"Did you mean {str(path.with_name(near))!r}?"
        fix = meant or "Name a .bag, .mcap or .db3 file, or a folder."
        raise PluginError(f"there is no bag {str(path)!r}", where=str(path), fix=fix)
    for each in path.iterdir() if path.is_dir() else [path]:
        if each.exists() and not (each.is_file() or each.is_dir()):  # a named pipe would be awaited for ever
            fix = "Take it away, and bring the file of the bag."
            raise PluginError(f"{each.name!r} is neither a file nor a folder", where=str(path), fix=fix)
    if path.is_file() and path.suffix not in _SUFFIXES:
        fix = "Name a .bag, .mcap or .db3 file, or the folder of a bag."
        if path.suffix == ".active":
            fix = f"Wait for its recorder. If that was killed: rosbag reindex {path.name}, and name it {path.stem}."
        raise PluginError(f"{path.name!r} is not a bag", where=str(path), fix=fix)
    if pointer := next(filter(_points, _files(path)), None):
        problem = f"{pointer.name!r} only points to a file of Git LFS"
        raise PluginError(problem, where=str(path), fix="Bring the file itself: git lfs pull.")
    if path.is_file() or (path / _METADATA).is_file():
        return path
    found = _files(path)
    parts = {each.suffix for each in found} in ({".mcap"}, {".db3"})
    found += sorted(each.parent for each in path.glob(f"*/{_METADATA}"))
    if len(found) == 1:
        return bag_at(found[0])
    fix = f"Name one of them: {', '.join(each.name for each in found)}." if found else "Name the folder of a bag."
    if parts:
        fix += " Of the parts of one recording, make a bag: ros2 bag reindex."
    raise PluginError(f"there are {len(found) or 'no'} bags in {str(path)!r}", where=str(path), fix=fix)


def _check_merged(path: Path) -> None:
    """Refuse a bag of which a part is in SQLite's log beside it, which rosbags passes over."""
    for file in _files(path):
        log = file.with_name(f"{file.name}-wal")
        if log.is_file() and log.stat().st_size:
            problem = f"messages of the bag are still in {log.name!r}: its recorder is at work, or was killed"
            fix = f"Have SQLite move them into the bag: sqlite3 {str(file)!r} 'PRAGMA wal_checkpoint(TRUNCATE)'."
            raise PluginError(problem, where=str(path), fix=fix)


def _files(path: Path) -> list[Path]:
    """Return a file, or those in a folder that are bags or parts of one."""
    if path.is_file():
        return [path]
    return sorted(each for each in path.iterdir() if each.suffix in _SUFFIXES and each.is_file())


def _repair(path: Path) -> str:
    files = _files(path)
    if not files:
        return f"Bring the files that {_METADATA} names, or record it again."
    if files[0].suffix == ".db3" and _OF_URIS & {*str(files[0])}:
        return "Rename it: rosbags opens no .db3 file with any of #?% in its path."
    if path.is_dir() and len(files) == 1:
        return f"Name its file, {str(files[0])!r}, or have {_METADATA} written anew: ros2 bag reindex."
    return _REPAIRS[files[0].suffix]


def _points(path: Path) -> bool:
    """Return whether a file stands for one that Git keeps elsewhere, as in a clone without Git LFS."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(len(_POINTER)) == _POINTER
    return False


@contextmanager
def _told_as_broken(path: Path) -> Iterator[None]:
    try:
        yield
    except PluginError:  # nothing that could read it
        raise
    except Exception as error:  # of rosbags, and of what it has decompress, unpack or query the bytes
        if isinstance(error, KeyError) and {*error.args} & _FOREIGN:
            problem = f"the bag has topics with {error.args[0]} definitions, and rosbags reads no bag that has any"
            raise PluginError(problem, where=str(path), fix=_WITHOUT) from error
        is_full = isinstance(error, OSError) and error.errno == errno.ENOSPC  # where it is unpacked to
        room = f"Make room in {tempfile.gettempdir()}, or set TMPDIR to a folder that has room for the unpacked bag."
        fix = room if is_full else _repair(path)
        raise PluginError(f"the bag cannot be read: {_reason(error)}", where=str(path), fix=fix) from error


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):  # the key alone would not be a reason
        return f"{error} is neither defined in it nor a part of ROS"
    return (str(error) or type(error).__name__).splitlines()[0][:200]


def _offered(ext: Any) -> Qos:
    """Return the profile to publish with: of ROS 2 what was offered, of ROS 1 whether it was latched."""
    if hasattr(ext, "latching"):
        return Qos.TRANSIENT_LOCAL if ext.latching else Qos.DEFAULT
    offers = ext.offered_qos_profiles
    return Policies(
        is_reliable=all(offer.reliability.name != "BEST_EFFORT" for offer in offers),
        is_kept=bool(offers) and all(offer.durability.name == "TRANSIENT_LOCAL" for offer in offers),
    ).profile


def _without_numbers(value: Any) -> Any:
    """Return a message without the numbers that headers have in ROS 1 alone: a link of ROS 1 gives its own."""
    if isinstance(value, dict):
        is_header = value.keys() == _ROS1_HEADER
        return {name: _without_numbers(each) for name, each in value.items() if not (is_header and name == "seq")}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [_without_numbers(each) for each in value]
    return value
