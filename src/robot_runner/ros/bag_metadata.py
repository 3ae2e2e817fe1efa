"""What rosbag2 wants to know of a bag: `metadata.yaml` beside its file, and the QoS that its publishers offered."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robot_runner.core.links.robot import Qos
from robot_runner.core.storage.guarded_files import open_to_fill
from robot_runner.ros.qos_policies import offered_by

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
_FOREVER: Mapping[str, int] = MappingProxyType({"sec": 9223372036, "nsec": 854775807})


def offered_profiles(offers: Iterable[Qos]) -> str:
    """Return what a bag holds of the QoS of a topic's publishers: YAML as rosbag2 writes it; empty for none.

    Example:
        >>> from robot_runner.core.links.robot import Qos
        >>> print(offered_profiles([Qos.SENSOR_DATA]).splitlines()[2])
          reliability: 2
    """
    return "".join(map(_profile, sorted(set(offers))))


def _profile(offer: Qos) -> str:
    policies = offered_by(offer)
    history = _KEEP_LAST if policies.depth else _KEEP_ALL
    reliability = _RELIABLE if policies.is_reliable else _BEST_EFFORT
    durability = _KEPT if policies.is_kept else _VOLATILE
    forever = f"\n    sec: {_FOREVER['sec']}\n    nsec: {_FOREVER['nsec']}\n"
    return (
        f"- history: {history}\n  depth: {policies.depth}\n  reliability: {reliability}\n  durability: {durability}\n"
        f"  deadline:{forever}  lifespan:{forever}  liveliness: {_AUTOMATIC}\n  liveliness_lease_duration:{forever}"
        "  avoid_ros_namespace_conventions: false\n"
    )


@dataclass(slots=True)
class DescribedTopic:
    """A topic of a bag that is written.

    Attributes:
        name: its full name.
        message_type: as ROS 2 spells it, such as `nav_msgs/msg/Odometry`.
        offered: the QoS profiles of its publishers, in YAML.
        count: how many messages there are.
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


class Contents:
    """What is in a bag of one MCAP file, counted while it is written."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._topics: list[DescribedTopic] = []
        self._begin_ns: int | None = None
        self._end_ns = 0

    def add(self, name: str, message_type: str, offered: str) -> DescribedTopic:
        """Note a topic; they are numbered from 1."""
        self._topics.append(DescribedTopic(name, message_type, offered))
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
