"""Writes a bag of laser scans to be played: ten seconds of a lidar in a hall, with noise and with single wild beams.

    python examples/bag_replay/make_bag.py

Take a bag of your own robot instead as soon as you have one: `ros2 bag record /scan`, or `rosbag record /scan`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

BEAMS, RATE = 1080, 20
WILD = 0.02  # share of the beams that measure anything but the hall
SCAN = "sensor_msgs/msg/LaserScan"
BEGIN_NS = 1_700_000_000 * 10**9


def ranges_of(number: int, chance: np.random.Generator) -> np.ndarray:
    """Return the ranges of one scan, m: a round hall that the robot crosses, 1 cm of noise, and wild beams."""
    angles = np.linspace(-np.pi, np.pi, BEAMS)
    hall = 4.0 + 0.02 * number * np.cos(angles) + chance.normal(0.0, 0.01, BEAMS)
    wild = chance.random(BEAMS) < WILD
    return np.where(wild, chance.uniform(0.1, 12.0, BEAMS), hall).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", nargs="?", type=Path, default=Path(__file__).parent / "hall")
    parser.add_argument("--seconds", type=float, default=10.0)
    words = parser.parse_args()
    store, chance = get_typestore(Stores.ROS2_HUMBLE), np.random.default_rng(1)
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    scan, step, none = store.types[SCAN], 2 * np.pi / BEAMS, np.zeros(0, dtype=np.float32)
    with Writer(words.path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/scan", SCAN, typestore=store)
        for number in range(round(words.seconds * RATE)):
            stamp = BEGIN_NS + number * 10**9 // RATE
            head = header(time(stamp // 10**9, stamp % 10**9), "laser")
            ranges = ranges_of(number, chance)
            message = scan(head, -np.pi, np.pi, step, 0.0, 1 / RATE, 0.1, 12.0, ranges, none)
            writer.write(connection, stamp, bytes(store.serialize_cdr(message, SCAN)))
    print(f"{words.path}: {words.seconds:g} s of scans")


if __name__ == "__main__":
    main()
