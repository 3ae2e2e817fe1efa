"""The task "video" from a camera's ROS topic, but for the ROS: pictures come in, a file comes out."""

from __future__ import annotations

import argparse
import queue
import time
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from robot_runner_onboard.channel import serve
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.opencv import opencv
from robot_runner_onboard.video_files import FrameFile, JpegFile

if TYPE_CHECKING:
    from typing import Any, Callable

    from robot_runner_onboard.channel import Channel

__all__ = ["TopicVideo", "record_topic", "serve_recorder"]

#: Encodings of sensor_msgs/Image that are understood: channels, and OpenCV's name of the conversion, if one is needed.
_ENCODINGS = {"bgr8": (3, None), "rgb8": (3, "COLOR_RGB2BGR"), "mono8": (1, "COLOR_GRAY2BGR")}
#: What a slow disk may be behind, in frames; more are refused, so that the memory does not fill up.
_BACKLOG = 100
#: How long the topic may be silent, in seconds, before and while it is recorded.
_PATIENCE = 3.0
_POLL = 0.05
#: How long what a slow disk is behind may take at the end, in seconds: less than the node waits for its worker.
_REST = 1.0


class TopicVideo:
    """Takes pictures from the callbacks of ROS and writes them where nobody waits for it.

    Args:
        path: of the file; JPEG pictures go to one that ends in .mjpeg instead.
        rate: frames a second that a player is to show.
    """

    def __init__(self, path: str, rate: float) -> None:
        self._path = path
        self._rate = rate
        self._pictures: queue.Queue[Callable[[], None]] = queue.Queue(_BACKLOG)
        self._file: FrameFile | JpegFile | None = None
        self.lost = 0

    def take_jpeg(self, layout: str, data: bytes) -> None:
        """Take the data of a sensor_msgs/CompressedImage and its format."""
        self._put(lambda: self._add_jpeg(layout, data))

    def take_image(self, encoding: str, size: tuple[int, int], step: int, data: bytes) -> None:
        """Take a sensor_msgs/Image: its encoding, (width, height), bytes a row, and data."""
        self._put(lambda: self._add_image(encoding, size, step, data))

    def write_next(self, wait: float) -> bool:
        """Write one picture; return whether one came within so many seconds.

        Raises:
            TaskError: it is of a kind that cannot be written, or the file cannot.
        """
        try:
            self._pictures.get(timeout=wait)()
        except queue.Empty:
            return False
        return True

    def write_rest(self, seconds: float) -> None:
        """Write what a slow disk is behind, for so many seconds at most; the others are lost.

        Raises:
            TaskError: as `write_next`.
        """
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and self.write_next(0.0):
            pass
        self.lost += self._pictures.qsize()

    def close(self) -> None:
        """Finish the file, if there is one."""
        if self._file is not None:
            self._file.close()

    def summary(self) -> str:
        """Return what is in the closed file, and what is not."""
        lost = f", {self.lost} more were lost: this computer is too slow" if self.lost else ""
        return "nothing was recorded" if self._file is None else self._file.summary() + lost

    def _put(self, write: Callable[[], None]) -> None:
        try:
            self._pictures.put_nowait(write)
        except queue.Full:
            self.lost += 1

    def _add_jpeg(self, layout: str, data: bytes) -> None:
        if "jp" not in layout.lower():
            raise TaskError(f"the topic's pictures are {layout!r}, not JPEG: name another topic")
        if self._file is None:
            self._file = JpegFile(self._path)
        self._file.add(data)

    def _add_image(self, encoding: str, size: tuple[int, int], step: int, data: bytes) -> None:
        frame = _frame(encoding, size, step, data)
        if self._file is None:
            self._file = FrameFile(self._path, size[0], size[1], self._rate)
        self._file.add(frame)


def record_topic(channel: Channel, video: TopicVideo, topic: str) -> str:
    """Write what the callbacks take until told to end.

    Raises:
        TaskError: no picture comes, or one that cannot be written.
    """
    with closing(video):
        if not video.write_next(_PATIENCE):
            raise TaskError(f"no picture came on {topic} within {_PATIENCE:g} s: start the camera's node")
        channel.ready()
        silence = 0.0
        while not channel.is_over():
            silence = 0.0 if video.write_next(_POLL) else silence + _POLL
            if silence > _PATIENCE:
                raise TaskError(f"no picture came on {topic} for {_PATIENCE:g} s")
        video.write_rest(_REST)
    return video.summary()


def serve_recorder(record: Callable[..., str]) -> int:
    """Be the worker that records the topic on the command line; return the exit code.

    Args:
        record: takes the channel, and `topic`, `rate` and `file`; records until told to end.
    """
    parser = argparse.ArgumentParser(prog="topic_recorder")
    parser.add_argument("--topic", required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--file", required=True)
    given = parser.parse_args()
    return serve(partial(record, topic=given.topic, rate=given.rate, file=given.file))


def _frame(encoding: str, size: tuple[int, int], step: int, data: bytes) -> Any:
    """Return a picture as OpenCV has it."""
    if encoding not in _ENCODINGS:
        known = ", ".join(sorted(_ENCODINGS))
        raise TaskError(f"the topic's pictures are encoded as {encoding!r}, not as one of {known}")
    cv2 = opencv()
    import numpy as np  # noqa: PLC0415 - comes with OpenCV

    (width, height), (channels, conversion) = size, _ENCODINGS[encoding]
    rows = np.frombuffer(data, dtype=np.uint8).reshape(height, step)[:, : width * channels]
    frame = np.ascontiguousarray(rows).reshape(height, width, channels)
    return frame if conversion is None else cv2.cvtColor(frame, getattr(cv2, conversion))
