"""The worker of the task "video" that records the ROS topic of a camera; a node of its own."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import TYPE_CHECKING

import rclpy
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.topic_video import TopicVideo, record_topic, serve_recorder
from sensor_msgs.msg import CompressedImage, Image

if TYPE_CHECKING:
    from rclpy.node import Node
    from robot_runner_onboard.channel import Channel

__all__ = ["record"]

#: How long to wait for the topic to be on the graph, in seconds.
_PATIENCE = 2.0
_COMPRESSED, _RAW = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"


def record(channel: Channel, topic: str, rate: float, file: str) -> str:
    """Record a topic until told to end.

    Raises:
        TaskError: it is not there, carries no pictures, or falls silent.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f"robot_runner_video_{os.getpid()}")
    video = TopicVideo(file, rate)

    def take_jpeg(message: CompressedImage) -> None:
        video.take_jpeg(message.format, bytes(message.data))

    def take_image(message: Image) -> None:
        video.take_image(message.encoding, (message.width, message.height), message.step, bytes(message.data))

    kinds = {_COMPRESSED: (CompressedImage, take_jpeg), _RAW: (Image, take_image)}
    kind, take = kinds[_checked_type(node, topic)]
    node.create_subscription(kind, topic, take, qos_profile_sensor_data)
    spinning = threading.Thread(target=rclpy.spin, args=(node,), daemon=True)
    spinning.start()
    try:
        return record_topic(channel, video, topic)
    finally:
        rclpy.shutdown()
        spinning.join(1.0)


def _checked_type(node: Node, topic: str) -> str:
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        found = dict(node.get_topic_names_and_types()).get(topic, [])
        known = [kind for kind in found if kind in (_COMPRESSED, _RAW)]
        if known:
            return known[0]
        if found:
            raise TaskError(f"{topic} carries {found[0]}, not pictures: set video.topic")
        time.sleep(0.1)
    raise TaskError(f"no node publishes {topic}: start the camera's node, or set video.topic")


if __name__ == "__main__":
    sys.exit(serve_recorder(record))
