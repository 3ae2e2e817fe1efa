"""A node that takes single wild beams out of laser scans, by the median of each beam's neighbours; it exists twice.

Where ROS is sourced you would write it with rclpy or rospy. Here it uses a link of Robot Runner's, so that the example
needs no ROS at all and is the same node over DDS and over ROS 1. It answers with the stamp of the scan that it answers:
by that, the latency is known.
"""

from __future__ import annotations

import argparse
import signal
import threading

import numpy as np

from robot_runner.plugins import open_robot

SCAN = "sensor_msgs/LaserScan"
HALF = 15  # neighbours on each side


def plain(ranges: list[float]) -> list[float]:
    """Return the median of each beam and its neighbours, in plain Python."""
    padded = ranges[:1] * HALF + ranges + ranges[-1:] * HALF
    return [sorted(padded[place : place + 2 * HALF + 1])[HALF] for place in range(len(ranges))]


def vectorised(ranges: list[float]) -> list[float]:
    """Return the same, with numpy."""
    padded = np.pad(np.asarray(ranges, dtype=np.float32), HALF, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * HALF + 1)
    return np.partition(windows, HALF, axis=1)[:, HALF].tolist()


FILTERS = {"plain": plain, "numpy": vectorised}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="dds")
    parser.add_argument("--filter", choices=FILTERS, default="numpy")
    words = parser.parse_args()
    smooth, is_over = FILTERS[words.filter], threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: is_over.set())
    with open_robot(words.robot) as (link, _):

        def answer(scan: dict) -> None:
            link.publish("/scan_filtered", SCAN, {**scan, "ranges": smooth(scan["ranges"])})

        link.advertise("/scan_filtered", SCAN)
        link.subscribe("/scan", SCAN, answer)
        print("ready", flush=True)
        is_over.wait()


if __name__ == "__main__":
    main()
