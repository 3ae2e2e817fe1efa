"""A topic that a rosbridge sends here, with its receivers and its messages."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Message, RawMessage
from robot_runner.ros.graph_transport import Reception
from robot_runner.ros.rosbridge_frames import from_protocol

if TYPE_CHECKING:
    from collections import deque

    from robot_runner.ros.rosbridge_types import RobotTypes
    from robot_runner.ros.shapes import Shape

#: Bytes as the robot has them; a server that does not know this compression sends JSON.
RAW = "cbor-raw"
_RAW_FIELDS = frozenset({"bytes", "secs", "nsecs"})


@dataclass(slots=True)
class Topic:
    """A topic that the server sends here, and its receivers, each with whether it is prompt: it waits for no other."""

    name: str
    message_type: str
    shape: Shape | None
    compression: str
    request_id: str
    kept: Mapping[bool, deque[Reception]]
    receivers: list[tuple[Callable[[Reception], None], bool]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def join(self, receive: Callable[[Reception], None], *, is_prompt: bool) -> list[Reception]:
        """Add a receiver of later messages, and return the messages that are kept, which it does not get."""
        with self._lock:
            self.receivers.append((receive, is_prompt))
            return list(self.kept[is_prompt])

    def leave(self, receive: Callable[[Reception], None]) -> None:
        """Remove a receiver."""
        with self._lock:
            self.receivers = [each for each in self.receivers if each[0] is not receive]

    def hand_on(self, reception: Reception, *, is_prompt: bool) -> None:
        """Keep a message for later receivers of this kind, and pass it to the present ones."""
        with self._lock:
            self.kept[is_prompt].append(reception)
            receivers = [receive for receive, is_its_kind in self.receivers if is_its_kind is is_prompt]
        for receive in receivers:
            receive(reception)


class RosbridgeReception:
    """A received message, decoded or encoded once, and only if that form is requested."""

    def __init__(self, types: RobotTypes, topic: Topic, message: Any, received_ns: int) -> None:
        self._types = types
        self._topic = topic
        self._message = message
        self._received_ns = received_ns
        is_raw = isinstance(message, dict) and message.keys() == _RAW_FIELDS and isinstance(message["bytes"], bytes)
        self._data: bytes | None = message["bytes"] if is_raw else None

    def message(self) -> Message:
        """Return the message as a mapping."""
        topic = self._topic
        if self._data is not None:
            return self._types.deserialise(topic.message_type, self._data)
        if topic.shape is None:
            raise one_form(topic.name, topic.message_type)
        return from_protocol(topic.shape, self._message, where=topic.name)

    def raw(self) -> RawMessage:
        """Return the message as bytes."""
        if self._data is None:
            self._data = self._types.serialise(self._topic.message_type, self.message())
        return RawMessage(self._data, self._received_ns)


def one_form(topic: str, message_type: str) -> LinkError:
    """Return the error that messages of a type unknown here cannot be received in both forms."""
    return LinkError(
        f"messages of {message_type} can be received here as bytes or as messages, not as both",
        where=topic,
        fix="Give its definition: robot = 'rosbridge://robot:9090?types=path/to/its/package'.",
    )
