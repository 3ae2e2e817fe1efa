"""A topic that a link publishes over rospy."""

from __future__ import annotations

import logging
import threading
import time
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError
from robot_runner.links.robot import Qos
from robot_runner.links.ros1.message_types import as_message, shape_of
from robot_runner.links.ros1.node import REGISTERING_SECONDS, within
from robot_runner.links.shapes import completed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.links.robot import Message

__all__ = ["Publisher"]

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
