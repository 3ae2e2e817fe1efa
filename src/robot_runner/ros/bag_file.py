"""Bags of both generations of ROS, and a recorder that writes them from a robot link where ROS' own cannot be used."""

from __future__ import annotations

import json
import queue
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.links.robot import Encoding, Qos, RawMessage, RobotLink
from robot_runner.core.storage.guarded_files import open_to_fill
from robot_runner.ros.opened_bag import INSTALL, types_in
from robot_runner.ros.qos_policies import offered_by
from robot_runner.ros.recorded_bag import RecordedBag
from robot_runner.ros.type_store import stored_name

if TYPE_CHECKING:
    from robot_runner.ros.topic_statistics import TypedTopic

#: How many messages of a bag are read for when it began, and for the period of each topic.
_FIRST = 2000


def new_bag(folder: Path, encoding: Encoding) -> McapBag | Ros1Bag:
    """Return a new bag in a folder, in the format of the generation of ROS whose messages it takes.

    A `PluginError` says that the library that writes it is not installed.
    """
    try:
        return Ros1Bag(folder / "bag.bag") if encoding is Encoding.ROS1 else McapBag(folder / "bag.mcap")
    except ModuleNotFoundError as error:
        problem = f"bags cannot be written: {error.name} cannot be imported"
        raise PluginError(problem, where="RosBag", fix=INSTALL) from error


class McapBag:
    """A bag of ROS 2, as one MCAP file (mcap.dev, profile `ros2`), at `path`.

    Beside it, `metadata.yaml` makes its folder a bag that `ros2 bag play` and `ros2 bag info` take.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     bag = McapBag(Path(folder, "bag.mcap"))
        ...     chatter = bag.add_topic("/chatter", "std_msgs/String", "string data")
        ...     bag.write(chatter, 1, bytes([0, 1, 0, 0, 3, 0, 0, 0]) + b"hi" + bytes(1))
        ...     bag.close()
        ...     bag.path.read_bytes()[1:5]
        b'MCAP'
    """

    def __init__(self, path: Path) -> None:
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415  # an extra

        self.path = path
        self._file = path.open("wb")
        self._writer = Writer(self._file, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library="robot-runner")
        self._contents = _Contents(path.name)

    def add_topic(self, topic: str, message_type: str, definition: str, offers: Iterable[Qos] = ()) -> int:
        """Tell of a topic, by its full name, and return the number by which its messages are written.

        The definition of its type has those that it is made of; of the profiles of its publishers, a player offers the
        same.
        """
        described = self._contents.add(topic, stored_name(message_type), _offered_profiles(offers))
        schema = self._writer.register_schema(described.message_type, "ros2msg", definition.encode())
        return self._writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": described.offered})

    def write(self, topic: int, received_ns: int, data: bytes) -> None:
        """Write one message; `received_ns` is in ns since the epoch."""
        number = self._contents.count(topic, received_ns)
        self._writer.add_message(topic, received_ns, data, received_ns, number)

    def close(self) -> None:
        """Finish the file, and describe it; closing twice does nothing."""
        if not self._file.closed:
            with self._file:  # which a full disk does not leave open
                self._writer.finish()  # type: ignore[no-untyped-call]  # mcap's own
            self._contents.write(self.path.parent)


# What rosbag2 wants to know of a bag: `metadata.yaml` beside its file, and the QoS that its publishers offered.

#: Of rosbag2's metadata: that of Humble, which all later ones read (rosbag2_storage/metadata_io).
_VERSION = 5

# rmw/types.h: RMW_QOS_POLICY_HISTORY_KEEP_LAST and _KEEP_ALL, _RELIABILITY_RELIABLE and _BEST_EFFORT,
# _DURABILITY_TRANSIENT_LOCAL and _VOLATILE, _LIVELINESS_AUTOMATIC. The names in their place came with Jazzy; it takes
# the numbers as well (rosbag2_storage/qos.cpp).
_KEEP_LAST, _KEEP_ALL = 1, 2
_RELIABLE, _BEST_EFFORT = 1, 2
_KEPT, _VOLATILE = 1, 2
_AUTOMATIC = 1
#: RMW_DURATION_INFINITE.
_FOREVER = "\n    sec: 9223372036\n    nsec: 854775807\n"


def _offered_profiles(offers: Iterable[Qos]) -> str:
    """Return what a bag holds of the QoS of a topic's publishers: YAML as rosbag2 writes it; empty for none.

    Example:
        >>> print(_offered_profiles([Qos.SENSOR_DATA]).splitlines()[2])
          reliability: 2
    """
    return "".join(map(_profile, sorted(set(offers))))


def _profile(offer: Qos) -> str:
    policies = offered_by(offer)
    history = _KEEP_LAST if policies.depth else _KEEP_ALL
    reliability = _RELIABLE if policies.is_reliable else _BEST_EFFORT
    durability = _KEPT if policies.is_kept else _VOLATILE
    return (
        f"- history: {history}\n  depth: {policies.depth}\n  reliability: {reliability}\n  durability: {durability}\n"
        f"  deadline:{_FOREVER}  lifespan:{_FOREVER}  liveliness: {_AUTOMATIC}\n  liveliness_lease_duration:{_FOREVER}"
        "  avoid_ros_namespace_conventions: false\n"
    )


@dataclass(slots=True)
class _DescribedTopic:
    """A topic of a bag that is written: its full name, and its type as ROS 2 spells it (`nav_msgs/msg/Odometry`).

    `offered` has the QoS profiles of its publishers, in YAML; `count` is how many messages there are.
    """

    name: str
    message_type: str
    offered: str
    count: int = 0

    def facts(self) -> dict[str, Any]:
        """Return what the metadata say of it."""
        described = {
            "name": self.name,
            "type": self.message_type,
            "serialization_format": "cdr",
            "offered_qos_profiles": self.offered,
        }
        return {"topic_metadata": described, "message_count": self.count}


class _Contents:
    """What is in a bag of one MCAP file, counted while it is written."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._topics: list[_DescribedTopic] = []
        self._begin_ns: int | None = None
        self._end_ns = 0

    def add(self, name: str, message_type: str, offered: str) -> _DescribedTopic:
        """Note a topic; they are numbered from 1."""
        self._topics.append(_DescribedTopic(name, message_type, offered))
        return self._topics[-1]

    def count(self, topic: int, received_ns: int) -> int:
        """Note a message of a topic, and return its number there, from 1."""
        self._begin_ns = received_ns if self._begin_ns is None else min(self._begin_ns, received_ns)
        self._end_ns = max(self._end_ns, received_ns)
        described = self._topics[topic - 1]
        described.count += 1
        return described.count

    def write(self, folder: Path) -> None:
        """Write `metadata.yaml` into a folder; what it says is JSON, which is YAML."""
        count = sum(topic.count for topic in self._topics)
        begin = self._begin_ns or 0
        span = {"nanoseconds": max(0, self._end_ns - begin)}
        start = {"nanoseconds_since_epoch": begin}
        facts = {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "duration": span,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [topic.facts() for topic in self._topics],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file],
            "files": [{"path": self._file, "starting_time": start, "duration": span, "message_count": count}],
        }
        with open_to_fill(folder / "metadata.yaml") as file:
            file.write(f"{json.dumps({'rosbag2_bagfile_information': facts}, indent=2)}\n".encode())


class Ros1Bag:
    """A bag of ROS 1, in version 2.0 of its format, at `path`."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag1 import Writer  # noqa: PLC0415  # an extra

        self.path = path
        self._writer = Writer(path)
        self._writer.open()
        self._topics: list[Any] = []
        self._is_closed = False

    def add_topic(self, topic: str, message_type: str, definition: str, offers: Iterable[Qos] = ()) -> int:
        """Tell of a topic, by its full name, and return the number by which its messages are written."""
        latched = int(Qos.TRANSIENT_LOCAL in offers)
        package, _, name = message_type.partition("/")
        full = f"{package}/msg/{name}"
        connection = self._writer.add_connection(
            topic, full, msgdef=definition, md5sum=_md5(full, definition), latching=latched
        )
        self._topics.append(connection)
        return len(self._topics) - 1

    def write(self, topic: int, received_ns: int, data: bytes) -> None:
        """Write one message; `received_ns` is in ns since the epoch."""
        self._writer.write(self._topics[topic], received_ns, data)

    def close(self) -> None:
        """Finish the file; closing twice does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._writer.close()


def messages_in(folder: Path) -> int | None:
    """Return how many messages the bag in a folder holds; None where that is not known."""
    with suppress(PluginError), RecordedBag(folder) as bag:
        return bag.count
    return None


def began_late(folder: Path, begin_ns: int) -> float:
    """Return how long after `begin_ns`, in ns since the epoch, a bag began, s; 0 if in time, or not known.

    Each topic's first message is due one of its own periods after that moment. A topic may be silent at first, so that
    the earliest of them counts.
    """
    with suppress(PluginError), RecordedBag(folder) as bag:
        return min(_delays(bag, begin_ns), default=0.0)
    return 0.0


def _delays(bag: RecordedBag, begin_ns: int) -> Iterator[float]:
    stamps: dict[str, list[int]] = defaultdict(list)
    for topic, stamp in islice(bag.stamps(), _FIRST):
        stamps[topic].append(stamp)
    for found in stamps.values():
        if periods := [later - earlier for earlier, later in pairwise(found)]:
            yield max(0.0, (found[0] - begin_ns - median(periods)) * 1e-9)


def _offers(link: RobotLink, topic: str) -> set[Qos]:
    """Return the profiles that the publishers of a topic offer; none where they are not known."""
    try:
        return {each.qos for each in link.publishers(topic) if each.qos is not None}
    except LinkError:  # a rosbridge without rosapi
        return set()


def _md5(name: str, definition: str) -> str:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415  # an extra

    # The definition says all that it is made of but times, which are built in; an empty store knows those.
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("int32 sec\nuint32 nanosec\n", "builtin_interfaces/msg/Time"))
    store.register(get_types_from_msg("int32 sec\nuint32 nanosec\n", "builtin_interfaces/msg/Duration"))
    store.register(types_in(definition, name))
    return store.generate_msgdef(name, ros_version=1)[1]


#: How long the disk may take for what is still to be written when recording ends, s.
_PATIENCE = 60.0


class LinkRecorder:
    """Writes what is received into a bag (`path`), in a thread of its own: the disk holds up no callback.

    `messages` is how many were written.

    Raises:
        PluginError: the library that writes bags is not installed.
        LinkError: a topic cannot be subscribed.
    """

    def __init__(self, link: RobotLink, topics: Sequence[TypedTopic], folder: Path) -> None:
        self._bag = new_bag(folder, link.encoding)
        self.path = self._bag.path
        self._received: queue.SimpleQueue[tuple[int, RawMessage] | None] = queue.SimpleQueue()
        self._is_recording = False
        self._kept: list[tuple[int, RawMessage]] = []  # came before, and is to be at the beginning of the bag
        self._order = threading.Lock()
        self._fault: Exception | None = None
        self.messages = 0
        self._subscriptions = ExitStack()
        self._writer = threading.Thread(target=self._write, name="bag writer", daemon=True)
        with ExitStack() as undoing:
            undoing.callback(self._bag.close)
            undoing.callback(self._subscriptions.close)
            for topic in topics:
                self._subscribe(link, topic)
            undoing.pop_all()
        self._writer.start()

    def begin(self) -> None:
        """Record from now on; what publishers keep for late comers, such as a map, is there from the beginning."""
        self._is_recording = True

    def end(self) -> None:
        """Record no more."""
        with self._order:
            if self._is_recording:
                self._put_kept(None)
            self._is_recording = False

    def close(self) -> str | None:
        """Finish the bag, and say what went wrong, if anything did."""
        self.end()
        self._subscriptions.close()
        self._received.put(None)
        self._writer.join(_PATIENCE)
        if self._writer.is_alive():
            return f"the disk did not take all messages within {_PATIENCE:g} s"
        try:
            self._bag.close()  # much is written at the end
        except (OSError, ValueError) as error:
            self._fault = self._fault or error
        return None if self._fault is None else f"the bag could not be written to its end: {self._fault}"

    def _subscribe(self, link: RobotLink, topic: TypedTopic) -> None:
        earlier: list[RawMessage] = []
        number: int | None = None
        is_kept = False

        def receive(message: RawMessage) -> None:
            with self._order:
                if number is None:
                    earlier.append(message)
                elif self._is_recording:
                    self._put_kept(message.received_ns)
                    self._received.put((number, message))
                elif is_kept:
                    self._kept.append((number, message))

        subscription = link.subscribe_raw(topic.name, topic.message_type, receive)
        self._subscriptions.callback(subscription.close)
        # In ROS 1, only a connected subscriber knows what a publisher offers.
        definition, offers = link.definition(topic.message_type), _offers(link, topic.full_name)
        with self._order:
            number = self._bag.add_topic(topic.full_name, topic.message_type, definition, offers)
            is_kept = Qos.TRANSIENT_LOCAL in offers
            if is_kept:
                self._kept += [(number, message) for message in earlier]
            earlier.clear()

    def _put_kept(self, received_ns: int | None) -> None:
        """Write what came before, as if it had come with the first message of the bag."""
        for number, message in self._kept:
            stamp = message.received_ns if received_ns is None else received_ns
            self._received.put((number, RawMessage(message.data, stamp)))
        self._kept.clear()

    def _write(self) -> None:
        while (item := self._received.get()) is not None:
            number, message = item
            if self._fault is not None:
                continue
            try:
                self._bag.write(number, message.received_ns, message.data)
            except (OSError, ValueError) as error:  # a full disk
                self._fault = error
            else:
                self.messages += 1
