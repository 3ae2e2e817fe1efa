"""Records topics through a robot link, where the robot's own recorders are not to be had."""

from __future__ import annotations

import queue
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.plugins.profilers.ros_bag.bag_file import new_bag

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.links.robot import RawMessage, RobotLink
    from robot_runner.plugins.profilers.ros_listening import TypedTopic

__all__ = ["LinkRecorder"]

#: How long the disk may take for what is still to be written when recording ends, s.
_PATIENCE = 60.0


class LinkRecorder:
    """Writes the bytes of what is heard into a bag, in a thread of its own: the disk holds up no callback.

    Args:
        link: to the robot.
        topics: what to record.
        folder: takes the bag.

    Raises:
        PluginError: the library that writes bags is not installed.
        LinkError: a topic cannot be heard.
    """

    def __init__(self, link: RobotLink, topics: Sequence[TypedTopic], folder: Path) -> None:
        self._bag = new_bag(folder, link.encoding)
        self._heard: queue.SimpleQueue[tuple[int, RawMessage] | None] = queue.SimpleQueue()
        self._is_recording = False
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

    @property
    def path(self) -> Path:
        """Where the bag is."""
        return self._bag.path

    def begin(self) -> None:
        """Record from now on."""
        self._is_recording = True

    def end(self) -> None:
        """Record no more."""
        self._is_recording = False

    def close(self) -> str | None:
        """Finish the bag, and say what went wrong, if anything did."""
        self.end()
        self._subscriptions.close()
        self._heard.put(None)
        self._writer.join(_PATIENCE)
        if self._writer.is_alive():
            return f"the disk did not take all messages within {_PATIENCE:g} s"
        self._bag.close()
        return None if self._fault is None else f"the bag could not be written to its end: {self._fault}"

    def _subscribe(self, link: RobotLink, topic: TypedTopic) -> None:
        number = self._bag.add_topic(topic.full_name, topic.message_type, link.definition(topic.message_type))

        def hear(message: RawMessage) -> None:
            if self._is_recording:
                self._heard.put((number, message))

        subscription = link.subscribe_raw(topic.name, topic.message_type, hear)
        self._subscriptions.callback(subscription.close)

    def _write(self) -> None:
        while (item := self._heard.get()) is not None:
            number, message = item
            if self._fault is not None:
                continue
            try:
                self._bag.write(number, message.received_ns, message.data)
            except (OSError, ValueError) as error:  # a full disk
                self._fault = error
            else:
                self.messages += 1
