"""What is heard over a rosbridge: one subscription a topic, whoever listens here."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Qos, RawMessage
from robot_runner.ros.listening import guarded
from robot_runner.ros.rosbridge.frames import from_protocol, to_protocol
from robot_runner.ros.shapes import completed, plain_type
from robot_runner.ros.watchdog import VELOCITY_COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.links.robot import Message
    from robot_runner.ros.rosbridge.rosapi import RobotTypes, Rosapi
    from robot_runner.ros.rosbridge.session import Session
    from robot_runner.ros.shapes import Shape

__all__ = ["Listener", "Publishers", "Subscriptions", "check_type"]


_logger = logging.getLogger(__name__)

#: Bytes as the robot has them; a server that does not know them sends JSON.
_RAW = "cbor-raw"
_RAW_FIELDS = frozenset({"bytes", "secs", "nsecs"})


class Listener:
    """One who hears a topic, until closed."""

    def __init__(self, topic: _Topic, callback: Callable[[Any], None], close: Callable[[Listener], None]) -> None:
        self.topic = topic
        self.is_open = True
        self._callback = guarded(callback, topic.name)
        self._close = close

    def hear(self, message: object) -> None:
        """Take what the topic brings, unless closed."""
        if self.is_open:
            self._callback(message)

    def close(self) -> None:
        """Hear no more; closing twice does nothing."""
        if self.is_open:
            self.is_open = False
            self._close(self)


@dataclass(slots=True)
class _Topic:
    name: str
    message_type: str
    shape: Shape | None
    compression: str
    request_id: str
    listeners: list[tuple[Listener, bool]] = field(default_factory=list)
    last: tuple[Any, int] | None = None
    is_reported: bool = False


class Subscriptions:
    """All that is heard over one session.

    Args:
        session: over which messages come.
        types: of the robot.
        rosapi: of the robot.
        now_ns: the time that raw messages are stamped with.
    """

    def __init__(self, session: Session, types: RobotTypes, rosapi: Rosapi, now_ns: Callable[[], int]) -> None:
        self._session = session
        self._types = types
        self._rosapi = rosapi
        self._now_ns = now_ns
        self._lock = threading.RLock()
        self._topics: dict[str, _Topic] = {}
        session.on_message = self._take

    def listen(
        self, name: str, message_type: str, callback: Callable[[Any], None], *, qos: Qos | None, is_raw: bool
    ) -> Listener:
        """Have `callback` called with each message of a topic, or with its bytes.

        Raises:
            LinkError: it carries another type, or there is no such type.
        """
        with self._lock:
            topic = self._topics.get(name) or self._subscribed(name, message_type, is_raw=is_raw)
            check_type(name, message_type, topic.message_type)
            if topic.shape is None and not is_raw:
                raise _only_bytes(name, message_type)
            if is_raw and topic.compression != _RAW:
                raise _only_bytes(name, message_type)
            listener = Listener(topic, callback, self._forget)
            topic.listeners.append((listener, is_raw))
            if topic.last is not None and qos is Qos.TRANSIENT_LOCAL:
                self._deliver(topic, *topic.last, [(listener, is_raw)])
        return listener

    def types(self) -> dict[str, str]:
        """Return the type of each topic that is heard."""
        with self._lock:
            return {topic.name: topic.message_type for topic in self._topics.values()}

    def _subscribed(self, name: str, message_type: str, *, is_raw: bool) -> _Topic:
        is_known = self._types.is_known_here(message_type)
        shape = None if is_raw and not is_known else self._types.shape(message_type)
        # A ROS 2 server's own CBOR fails at arrays of a fixed length, and its JSON has no numbers that are none.
        plain = "cbor" if self._types.generation == 1 else "none"
        check_type(name, message_type, self._rosapi.topic_type(name))
        request_id = self._session.fresh_id("subscribe")
        topic = _Topic(name, plain_type(message_type), shape, _RAW if is_known or is_raw else plain, request_id)
        self._topics[name] = topic
        try:
            self._session.request(
                {
                    "op": "subscribe",
                    "id": request_id,
                    "topic": name,
                    "type": self._types.wire_name(message_type),
                    "compression": topic.compression,
                },
                where=name,
            )
            self._rosapi.confirm_subscription(name, message_type)
        except LinkError:
            del self._topics[name]
            raise
        return topic

    def _forget(self, listener: Listener) -> None:
        with self._lock:
            topic = listener.topic
            topic.listeners = [each for each in topic.listeners if each[0] is not listener]
            if not topic.listeners and self._topics.pop(topic.name, None) is not None and self._session.is_usable:
                self._session.send({"op": "unsubscribe", "id": topic.request_id, "topic": topic.name})

    def _take(self, name: str, message: Any) -> None:
        received_ns = self._now_ns()
        topic = self._topics.get(name)
        if topic is not None:
            self._session.later(lambda: self._hear(topic, message, received_ns))

    def _hear(self, topic: _Topic, message: Any, received_ns: int) -> None:
        topic.last = (message, received_ns)
        self._deliver(topic, message, received_ns, list(topic.listeners))

    def _deliver(self, topic: _Topic, message: Any, received_ns: int, listeners: list[tuple[Listener, bool]]) -> None:
        reception = _Reception(self._types, topic, message)
        for listener, is_raw in listeners:
            try:
                heard = RawMessage(reception.data(), received_ns) if is_raw else reception.message()
            except LinkError as error:
                if not topic.is_reported:  # once, not a hundred times a second
                    topic.is_reported = True
                    _logger.error("%s", error)  # noqa: TRY400 - the user's matter, not a fault of ours
                continue
            listener.hear(heard)


class _Reception:
    """One message as it came, turned into what somebody wants of it when somebody does."""

    def __init__(self, types: RobotTypes, topic: _Topic, message: Any) -> None:
        self._types = types
        self._topic = topic
        self._message = message
        is_raw = isinstance(message, dict) and message.keys() == _RAW_FIELDS and isinstance(message["bytes"], bytes)
        self._data: bytes | None = message["bytes"] if is_raw else None

    def message(self) -> dict[str, Any]:
        topic = self._topic
        if self._data is not None:
            return self._types.deserialise(topic.message_type, self._data)
        if topic.shape is None:
            raise _only_bytes(topic.name, topic.message_type)
        return from_protocol(topic.shape, self._message, where=topic.name)

    def data(self) -> bytes:
        if self._data is None:
            self._data = self._types.serialise(self._topic.message_type, self.message())
        return self._data


def check_type(name: str, given: str, true: str | None) -> None:
    """Refuse if a topic is known to be of another type.

    Raises:
        LinkError: it is.
    """
    if true is not None and plain_type(given) != true:
        raise LinkError(f"it is of type {true}, not {given!r}", where=name, fix=f"Name the type {true!r}.")


def _only_bytes(name: str, message_type: str) -> LinkError:
    return LinkError(
        f"messages of {message_type} can be heard here as bytes or as messages, not as both",
        where=name,
        fix="Give its definition: robot = 'rosbridge://robot:9090?types=path/to/its/package'.",
    )


# What is published over a rosbridge.


@dataclass(frozen=True, slots=True)
class _Publisher:
    message_type: str
    shape: Shape
    is_latched: bool
    request_id: str


class Publishers:
    """All that is published over one session.

    Args:
        session: over which messages go.
        types: of the robot.
        rosapi: of the robot.
    """

    def __init__(self, session: Session, types: RobotTypes, rosapi: Rosapi) -> None:
        self._session = session
        self._types = types
        self._rosapi = rosapi
        self._lock = threading.Lock()
        self._publishers: dict[str, _Publisher] = {}
        self._driven: dict[str, str] = {}

    def publish(self, name: str, message_type: str, message: Message, qos: Qos) -> None:
        """Publish a message on a topic, by its full name.

        Raises:
            LinkError: the topic carries another type, or the message does not follow its definition.
        """
        self._session.check_open(name)
        with self._lock:
            publisher = self._publisher(name, message_type, message, is_latched=qos is Qos.TRANSIENT_LOCAL)
            if publisher.message_type in VELOCITY_COMMANDS:
                self._driven[name] = message_type
        complete = completed(publisher.shape, message, where=name)
        self._session.send({"op": "publish", "topic": name, "msg": to_protocol(publisher.shape, complete)})

    def stop_what_was_driven(self) -> None:
        """Command zero on each topic on which a velocity was, and see that the server has taken it.

        Raises:
            LinkError: the connection is lost.
        """
        for name, message_type in self._driven.items():
            self.publish(name, message_type, {}, Qos.DEFAULT)
        for name in self._driven:
            publisher = self._publishers[name]
            self._session.request({"op": "unadvertise", "id": publisher.request_id, "topic": name}, where=name)

    def _publisher(self, name: str, message_type: str, message: Message, *, is_latched: bool) -> _Publisher:
        known = self._publishers.get(name)
        if known is not None:
            check_type(name, message_type, known.message_type)
            if known.is_latched or not is_latched:
                return known
        shape = self._types.shape(message_type)
        completed(shape, message, where=name)  # refused before the graph hears of it
        check_type(name, message_type, self._rosapi.topic_type(name))
        if known is not None:
            self._session.send({"op": "unadvertise", "id": known.request_id, "topic": name})
        fresh = _Publisher(plain_type(message_type), shape, is_latched, self._session.fresh_id("advertise"))
        self._session.request(
            {
                "op": "advertise",
                "id": fresh.request_id,
                "topic": name,
                "type": self._types.wire_name(message_type),
                "latch": is_latched,
            },
            where=name,
        )
        self._rosapi.confirm_publisher(name, message_type)
        self._publishers[name] = fresh
        return fresh
