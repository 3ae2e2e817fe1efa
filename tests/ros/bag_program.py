"""Stands in for `ros2 bag record -o FOLDER TOPIC...` and `rosbag record --quiet -O FILE TOPIC...`.

It writes a bag of one message for each topic once it gets the signal that the real one takes, as those do, and nothing
if it ends otherwise. As `rosbag` does, it ends before the recorder behind it has finished its bag. Called as:
bag_program.py ros2|rosbag arguments...
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

from robot_runner.ros.bag_file import McapBag, Ros1Bag

DEFINITION = "string data\n"


def main(program: str, arguments: list[str]) -> None:
    is_ros2 = program == "ros2"
    # Both have two words before the option's value: `bag record -o`, and `record --quiet -O`.
    path, names = Path(arguments[3]), arguments[4:]
    is_over: list[int] = []
    signal.signal(signal.SIGINT if is_ros2 else signal.SIGTERM, lambda *_: is_over.append(1))
    active, written = path.with_suffix(".bag.active"), path.with_suffix(".written")
    if is_ros2:
        path.mkdir()
        (path / "bag_0.mcap.active").touch()
    else:
        active.touch()
    deadline = time.monotonic() + 30.0
    while not is_over and time.monotonic() < deadline:
        time.sleep(0.02)
    if not is_ros2:
        if os.fork():
            return
        time.sleep(0.3)
    bag = McapBag(path.with_suffix(".mcap")) if is_ros2 else Ros1Bag(written)
    data = b"\0\1\0\0\3\0\0\0hi\0" if is_ros2 else b"\2\0\0\0hi"
    for name in names:
        bag.write(bag.add_topic(name, "std_msgs/String", DEFINITION), 1, data)
    bag.close()
    if not is_ros2:
        written.rename(path)
        active.unlink()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
