"""A topic that a link hears over rospy."""

from __future__ import annotations

import logging
import re
import threading
import time
from functools import lru_cache, partial
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Qos, RawMessage
from robot_runner.ros.message_codec import TypeKind, generated_class
from robot_runner.ros.ros1.node import REGISTERING_SECONDS, within
from robot_runner.ros.shapes import BYTE_KINDS, UNBOUNDED, Field, Shape, completed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from robot_runner.core.links.robot import Message

__all__ = ["Publisher", "Subscriber", "as_mapping", "as_message", "message_class", "service_class", "shape_of"]


# Messages of ROS 1 to and from plain mappings; their types are the Python classes that ROS generates.

_FIELD = re.compile(r"([\w/]+)(\[(\d*)\])?")
#: What these mean in ROS 1.
_KINDS = {"byte": "int8", "char": "uint8"}
_STAMPS = {"time": "Time", "duration": "Duration"}


def message_class(message_type: str) -> Any:
    """Return the class of a message type, such as `geometry_msgs/Twist`.

    Raises:
        LinkError: there is none, or its package is not on Python's path.
    """
    return generated_class(message_type, TypeKind.MESSAGE, _is_type)


def service_class(service_type: str) -> Any:
    """Return the class of a service type, such as `std_srvs/Trigger`.

    Raises:
        LinkError: as `message_class`.
    """
    return generated_class(service_type, TypeKind.SERVICE, _is_type)


def _is_type(found: Any, name: str) -> bool:
    return getattr(found, "_type", None) == name


@lru_cache
def shape_of(cls: Any) -> Shape:
    """Return what a message class, or the class of a request or response, is made of."""
    return Shape(cls._type, tuple(_field(*each) for each in zip(cls.__slots__, cls._slot_types, strict=True)))


def _field(name: str, written: str) -> Field:
    parts = _FIELD.fullmatch(written)
    kind, array, number = parts.groups() if parts else (written, None, None)
    count = None if not array else int(number) if number else UNBOUNDED
    return Field(name, shape_of(message_class(kind)) if "/" in kind else _KINDS.get(kind, kind), count)


def as_mapping(message: Any) -> dict[str, Any]:
    """Return a message of ROS as a plain mapping."""
    return {field.name: _plain(field, getattr(message, field.name)) for field in shape_of(message.__class__).fields}


def _plain(field: Field, value: Any) -> Any:
    kind = field.kind
    if field.count is None:
        if isinstance(kind, Shape):
            return as_mapping(value)
        return {"sec": value.secs, "nanosec": value.nsecs} if kind in _STAMPS else value
    if isinstance(kind, Shape):
        return [as_mapping(each) for each in value]
    if kind in BYTE_KINDS:
        return bytes(value)
    return [{"sec": each.secs, "nanosec": each.nsecs} for each in value] if kind in _STAMPS else list(value)


def as_message(cls: Any, complete: Mapping[str, Any]) -> Any:
    """Return the message of ROS that a mapping with every field is; `robot_runner.ros.shapes.completed` makes one."""
    message = cls.__new__(cls)  # its own initialisation fills every field with a default first
    for name, convert in _conversions(cls):
        setattr(message, name, complete[name] if convert is None else convert(complete[name]))
    return message


@lru_cache
def _conversions(cls: Any) -> tuple[tuple[str, Callable[[Any], Any] | None], ...]:
    """Return what makes each field's value of ROS; None where it is the same."""
    return tuple((field.name, _conversion(field)) for field in shape_of(cls).fields)


def _conversion(field: Field) -> Callable[[Any], Any] | None:
    kind = field.kind
    if isinstance(kind, Shape):
        convert: Callable[[Any], Any] = partial(as_message, message_class(kind.type_name))
    elif kind in _STAMPS:
        convert = partial(_stamp, getattr(import_module("genpy"), _STAMPS[kind]))
    else:
        return None
    return convert if field.count is None else partial(_each, convert)


def _each(convert: Callable[[Any], Any], values: Iterable[Any]) -> list[Any]:
    return [convert(value) for value in values]


def _stamp(cls: Any, value: Mapping[str, int]) -> Any:
    return cls(value["sec"], value["nanosec"])


# A topic that a link publishes over rospy.

_logger = logging.getLogger(__name__)

#: How many messages wait for a slow listener, each; 0 is any number.
_QUEUE_SIZES: Mapping[Qos, int] = MappingProxyType(
    {Qos.DEFAULT: 10, Qos.SENSOR_DATA: 5, Qos.RELIABLE: 0, Qos.TRANSIENT_LOCAL: 1}
)
#: How long those who hear the topic already may take to connect, s.
_CONNECTING_SECONDS = 2.0
_POLL = 0.002


class Publisher:
    """Publishes one topic; who hears it already hears the first message.

    Args:
        rospy: the client library.
        name: the topic's full name.
        cls: the class of its messages.
        qos: how they are delivered.
        listeners: how many nodes hear the topic already.

    Raises:
        LinkError: the master does not answer.
    """

    def __init__(self, rospy: Any, name: str, cls: Any, qos: Qos, listeners: int) -> None:
        self.name = name
        self.message_type: str = cls._type
        self._cls = cls
        self._shape = shape_of(cls)
        arrivals = _Arrivals()
        self._publisher = within(
            REGISTERING_SECONDS,
            lambda: rospy.Publisher(
                name,
                cls,
                subscriber_listener=arrivals,
                tcp_nodelay=True,  # a command is small, and should not wait for the next
                latch=qos is Qos.TRANSIENT_LOCAL,
                queue_size=_QUEUE_SIZES[qos],
            ),
            where=name,
            doing="registering the publisher",
        )
        self._await(arrivals, listeners)

    def publish(self, message: Message) -> None:
        """Publish a message.

        Raises:
            LinkError: it does not follow its definition.
        """
        self._publisher.publish(as_message(self._cls, completed(self._shape, message, where=self.name)))

    def flush(self, timeout: float) -> None:
        """Return once all that was published is on its way.

        Raises:
            LinkError: a listener does not take it in time.
        """
        deadline = time.monotonic() + timeout
        for connection in list(self._publisher.impl.connections):
            while not _is_idle(connection):
                if time.monotonic() > deadline:
                    problem = f"a message is not taken within {timeout:g} s by {connection.endpoint_id}"
                    raise LinkError(problem, where=self.name, fix="Look whether the robot is on and in this network.")
                time.sleep(_POLL)

    def close(self) -> None:
        """Publish no more.

        Raises:
            LinkError: the master does not answer.
        """
        within(REGISTERING_SECONDS, self._publisher.unregister, where=self.name, doing="leaving the topic")

    def _await(self, arrivals: _Arrivals, listeners: int) -> None:
        deadline = time.monotonic() + _CONNECTING_SECONDS
        while self._publisher.get_num_connections() < listeners:
            left = deadline - time.monotonic()
            if left <= 0:
                connected = self._publisher.get_num_connections()
                _logger.warning("%s: %d of the %d nodes that hear it are reached", self.name, connected, listeners)
                return
            arrivals.wait(left)


class _Arrivals:
    """Tells that somebody who hears a topic has connected; rospy calls it."""

    def __init__(self) -> None:
        self._arrived = threading.Event()

    def peer_subscribe(self, *_: object) -> None:
        self._arrived.set()

    def peer_unsubscribe(self, *_: object) -> None:
        """Do nothing: rospy calls it, too."""

    def wait(self, timeout: float) -> None:
        self._arrived.wait(timeout)
        self._arrived.clear()


def _is_idle(connection: Any) -> bool:
    """Whether rospy has handed all of a connection's messages to the system.

    Its thread takes the whole queue and then sends it, so an empty queue says too little: it must wait for more.
    """
    wakes = connection._cond_data_available  # noqa: SLF001 - rospy tells it nowhere else
    with connection._lock:  # noqa: SLF001 - as above
        return connection.done or (not connection._queue and bool(wakes._waiters))  # noqa: SLF001 - as above


class Subscriber:
    """Hears one topic as bytes, and sees to the type of what comes.

    rospy shares one connection among all subscribers of a topic, with the class that the first of them asks for; with
    its class for any message there is nothing that they can disagree about.

    Args:
        rospy: the client library.
        name: the topic's full name.
        cls: the class of its messages.
        callback: called with each message, from a thread of rospy's.

    Raises:
        LinkError: the master does not answer.
    """

    def __init__(self, rospy: Any, name: str, cls: Any, callback: Callable[[RawMessage], None]) -> None:
        self._name = name
        self._type: str = cls._type
        self._digest: str = cls._md5sum
        self._callback = callback
        self._foreign: set[str] = set()
        self._is_closed = False
        self._subscriber = within(
            REGISTERING_SECONDS,
            lambda: rospy.Subscriber(name, rospy.AnyMsg, self._hear, tcp_nodelay=True),
            where=name,
            doing="registering the subscriber",
        )

    def close(self) -> None:
        """Hear no more messages; closing twice does nothing.

        Raises:
            LinkError: the master does not answer.
        """
        if not self._is_closed:
            self._is_closed = True
            within(REGISTERING_SECONDS, self._subscriber.unregister, where=self._name, doing="leaving the topic")

    def _hear(self, message: Any) -> None:
        received = time.time_ns()
        if self._is_closed:
            return
        header = message._connection_header  # noqa: SLF001 - where rospy documents it to be
        if header["md5sum"] in {self._digest, "*"}:
            self._callback(RawMessage(message._buff, received))  # noqa: SLF001 - as above
        elif header["callerid"] not in self._foreign:
            self._foreign.add(header["callerid"])
            text = "%s: %s publishes %s, or another version of it, which is not heard as %s"
            _logger.error(text, self._name, header["callerid"], header.get("type"), self._type)
