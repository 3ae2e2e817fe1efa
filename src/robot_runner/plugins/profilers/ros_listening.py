"""What the profilers of a ROS graph share: finding topics and their types, and reading the header of raw messages."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.errors import Finding, PluginError
from robot_runner.links.graph_names import full_name
from robot_runner.links.robot import Encoding

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["HeaderReader", "Stamp", "TypedTopic", "found_topics", "robot_findings", "topic_label"]

_HEADERS = frozenset({"Header", "std_msgs/Header", "std_msgs/msg/Header"})
_LOOK = 0.1

#: ROS 1: seq, secs, nsecs. ROS 2, after the four bytes of CDR's header: sec, nanosec.
_ROS1 = struct.Struct("<III")
_CDR = {1: struct.Struct("<iI"), 0: struct.Struct(">iI")}
_CDR_HEADER = 4


@dataclass(frozen=True, slots=True)
class TypedTopic:
    """A topic that is on the graph.

    Attributes:
        name: as the user gave it.
        full_name: on the graph.
        message_type: ROS name.
    """

    name: str
    full_name: str
    message_type: str


class Stamp(NamedTuple):
    """What the header of a message says.

    Attributes:
        time_ns: the moment of what the message is about, ns since the epoch; None where it was left at 0.
        sequence: the number that ROS 1 gives to each message of a publisher; None in ROS 2.
    """

    time_ns: int | None
    sequence: int | None


def robot_findings(name: str, circumstances: Circumstances) -> list[Finding]:
    """Return the finding that the experiment names no robot to be heard, if so."""
    if circumstances.robot is not None:
        return []
    fix = "Name one in the config: robot = 'simulated'. Or: --set robot=simulated."
    return [Finding.error(f"plugin {name}", "it hears the robot, and the experiment names none", fix)]


def found_topics(
    link: RobotLink, names: Iterable[str], namespace: str, clock: Clock, *, patience: float
) -> Mapping[str, TypedTopic | None]:
    """Return each topic with its type; None for one that is not on the graph within `patience` seconds of the clock."""
    wanted = {name: full_name(namespace, name) for name in names}
    deadline = clock.now() + patience
    types = link.topics()
    while not all(full in types for full in wanted.values()) and clock.now() < deadline:
        clock.sleep(_LOOK)
        types = link.topics()
    return {name: TypedTopic(name, full, types[full]) if full in types else None for name, full in wanted.items()}


def topic_label(topic: str, *, where: str) -> str:
    """Return a topic's name as part of a measure's.

    Raises:
        PluginError: it is not the name of a topic.

    Example:
        >>> topic_label("/alice/battery_state", where="RosTopics")
        'AliceBatteryState'
    """
    words = [word for part in topic.strip("/").split("/") for word in part.split("_")]
    label = "".join(word[:1].upper() + word[1:] for word in words)
    if not (label.isascii() and label.isalnum() and label[0].isalpha()):
        fix = "Name it as on the graph, such as 'odom' or '/alice/odom'."
        raise PluginError(f"{topic!r} cannot be the name of a topic", where=where, fix=fix)
    return label


class HeaderReader:
    """Reads the header of raw messages of one type, without decoding the rest.

    Args:
        definition: the text of the type's definition.
        encoding: of the messages.

    Example:
        >>> reader = HeaderReader("std_msgs/Header header", Encoding.CDR)
        >>> reader.read(bytes([0, 1, 0, 0]) + _CDR[1].pack(2, 5) + b"...")
        Stamp(time_ns=2000000005, sequence=None)
    """

    def __init__(self, definition: str, encoding: Encoding) -> None:
        self.has_header = _first_field_type(definition) in _HEADERS
        self._is_ros1 = encoding is Encoding.ROS1

    def read(self, data: bytes) -> Stamp:
        """Return what the header of a message says."""
        if not self.has_header or len(data) < _ROS1.size:
            return Stamp(None, None)
        if self._is_ros1:
            sequence, seconds, nanoseconds = _ROS1.unpack_from(data)
        else:
            sequence = None
            seconds, nanoseconds = _CDR[data[1] & 1].unpack_from(data, _CDR_HEADER)
        return Stamp(seconds * 1_000_000_000 + nanoseconds or None, sequence)


def _first_field_type(definition: str) -> str:
    for line in definition.splitlines():
        words = line.partition("#")[0].split()
        if words and "=" not in line.partition("#")[0]:
            return words[0]
    return ""
