"""The worker of the task "video" that records the ROS topic of a camera; a node of its own."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import rospy
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.topic_video import TopicVideo, record_topic, serve_recorder
from sensor_msgs.msg import CompressedImage, Image

if TYPE_CHECKING:
    from robot_runner_onboard.channel import Channel

__all__ = ["record"]

#: How long to wait for the topic to be on the graph, in seconds.
_PATIENCE = 2.0
#: The largest picture of five megapixels, in bytes: rospy reads a message at once if its buffer takes it.
_BUFFER = 2**24
_COMPRESSED, _RAW = "sensor_msgs/CompressedImage", "sensor_msgs/Image"


def record(channel: Channel, topic: str, rate: float, file: str) -> str:
    """Record a topic until told to end.

    Raises:
        TaskError: it is not there, carries no pictures, or falls silent.
    """
    rospy.init_node("robot_runner_video", anonymous=True, disable_signals=True)
    video = TopicVideo(file, rate)

    def take_jpeg(message: CompressedImage) -> None:
        video.take_jpeg(message.format, message.data)

    def take_image(message: Image) -> None:
        video.take_image(message.encoding, (message.width, message.height), message.step, message.data)

    kinds = {_COMPRESSED: (CompressedImage, take_jpeg), _RAW: (Image, take_image)}
    kind, take = kinds[_checked_type(topic)]
    subscriber = rospy.Subscriber(topic, kind, take, queue_size=10, buff_size=_BUFFER)
    try:
        return record_topic(channel, video, topic)
    finally:
        subscriber.unregister()


def _checked_type(topic: str) -> str:
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        found = dict(rospy.get_published_topics()).get(topic)
        if found in (_COMPRESSED, _RAW):
            return found
        if found is not None:
            raise TaskError(f"{topic} carries {found}, not pictures: set video/topic")
        time.sleep(0.1)
    raise TaskError(f"no node publishes {topic}: start the camera's node, or set video/topic")


if __name__ == "__main__":
    sys.exit(serve_recorder(record))
