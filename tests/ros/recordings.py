"""Bags of laser scans, written by rosbags: nothing of what is to be tested has a part in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["BEGIN_NS", "PERIOD_NS", "scans_of_ros1", "scans_of_ros2"]

#: Long ago: stamps of a bag are no times of today.
BEGIN_NS = 1_500_000_000 * 10**9
PERIOD_NS = 50_000_000
_SCAN = "sensor_msgs/msg/LaserScan"
_FOREVER = QosTime(2147483647, 4294967295)


def scans_of_ros1(
    path: Path,
    count: int = 20,
    *,
    others: tuple[str, ...] = (),
    compression: Writer1.CompressionFormat | None = None,
) -> Path:
    """Write a bag of ROS 1 with `count` scans at 20 Hz on /scan, and one text on each of the other topics."""
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        scans = writer.add_connection("/scan", _SCAN, typestore=store)
        for number in range(count):
            stamp = BEGIN_NS + number * PERIOD_NS
            writer.write(scans, stamp, bytes(store.serialize_ros1(_scan(store, stamp, number, seq=number), _SCAN)))
        for topic in others:
            text = writer.add_connection(topic, "std_msgs/msg/String", typestore=store)
            data = store.serialize_ros1(store.types["std_msgs/msg/String"](topic), "std_msgs/msg/String")
            writer.write(text, BEGIN_NS, bytes(data))
    return path


def scans_of_ros2(
    folder: Path, count: int = 20, *, others: tuple[str, ...] = (), sqlite: bool = False, best_effort: bool = False
) -> Path:
    """Write a bag of ROS 2 like `scans_of_ros1`, as MCAP or, without definitions of types, as sqlite3."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    reliability = QosReliability.BEST_EFFORT if best_effort else QosReliability.RELIABLE
    offered = Qos(
        QosHistory.KEEP_LAST, 5, reliability, QosDurability.VOLATILE, _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC,
        _FOREVER, avoid_ros_namespace_conventions=False,
    )  # fmt: skip
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer2(folder, version=8 if sqlite else 9, storage_plugin=plugin) as writer:
        scans = writer.add_connection("/scan", _SCAN, typestore=store, offered_qos_profiles=[offered])
        for number in range(count):
            stamp = BEGIN_NS + number * PERIOD_NS
            writer.write(scans, stamp, bytes(store.serialize_cdr(_scan(store, stamp, number), _SCAN)))
        for topic in others:
            text = writer.add_connection(topic, "std_msgs/msg/String", typestore=store)
            data = store.serialize_cdr(store.types["std_msgs/msg/String"](topic), "std_msgs/msg/String")
            writer.write(text, BEGIN_NS, bytes(data))
    return folder


def _scan(store, stamp_ns, number, *, seq=None):
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](*(() if seq is None else (seq,)), stamp, "laser")
    ranges = np.linspace(0.5, 3.5, 180, dtype=np.float32) + np.float32(number)
    return types[_SCAN](header, -1.5, 1.5, 0.0167, 0.0, 0.05, 0.1, 100.0, ranges, np.zeros(0, dtype=np.float32))
