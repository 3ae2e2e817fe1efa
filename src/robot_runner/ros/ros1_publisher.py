"""A publisher of rospy: configured before it is registered, which knows whether its messages were sent."""

from __future__ import annotations

import logging
import math
import sys
import termios
import threading
import time
from array import array
from collections.abc import Callable, Iterable
from contextlib import suppress
from fcntl import ioctl
from functools import partial
from importlib import import_module
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import GraphEndpoint, Message, Qos
from robot_runner.core.words import enumerated
from robot_runner.ros.own_thread import OwnThread
from robot_runner.ros.qos_policies import DEPTHS
from robot_runner.ros.ros1_node import check_running, completed_first, within
from robot_runner.ros.ros1_types import as_message
from robot_runner.ros.undelivered import drop_undelivered

_logger = logging.getLogger(__name__)

#: The timeout for existing nodes to connect to a new publisher or subscriber, s.
CONNECTING = 2.0
#: The timeout for sending the last message before a publisher is closed, s.
_CLOSING_SECONDS = 0.5
#: How long to wait for a message to be sent where rospy does not report it, s.
_UNTOLD_SECONDS = 0.2
#: For how long after connecting a subscriber may reconnect, s. A node of rospy does so when the master announces a
#: publisher twice, as when one begins and another is killed, and loses the messages that it has not read by then.
_SETTLING = 1.0
#: How often it is checked whether a queue is empty, s.
POLL = 0.002

#: For all publishers: rospy only queues what it is to send.
_sender = OwnThread()


class Publisher:
    """Publishes one topic with rospy; an existing subscriber receives the first message.

    `cls` is rospy's class of its messages; `subscribers` returns those that the master knows.

    Raises:
        LinkError: it cannot be registered.
    """

    def __init__(
        self, rospy: Any, topic: str, cls: Any, qos: Qos, subscribers: Callable[[], Iterable[GraphEndpoint]]
    ) -> None:
        self._subscribers = subscribers
        self._topic = topic
        self._cls = cls
        self._arrivals = _Arrivals()
        self._rospy = rospy
        self._most = 0  # the largest number of subscribers connected at a time
        self._publisher = within(partial(self._register, qos), where=topic, doing="registering the publisher")
        try:
            self.reach()
        except BaseException:  # also where the run ends now
            self.close()
            raise

    def _register(self, qos: Qos) -> Any:
        depth, is_latched = DEPTHS[qos], qos is Qos.TRANSIENT_LOCAL

        def complete(publisher: Any) -> None:
            _have_undelivered_die_with_us(publisher)
            publisher.set_queue_size(depth)
            if is_latched:
                publisher.enable_latch()
            import_module("rospy.impl.tcpros").get_tcpros_handler().set_tcp_nodelay(self._topic, tcp_nodelay=True)

        with completed_first(self._topic, "pub", complete):
            return self._rospy.Publisher(
                self._topic,
                self._cls,
                subscriber_listener=self._arrivals,
                tcp_nodelay=True,  # a command is small, and should not wait for the next
                latch=is_latched,
                queue_size=depth,
            )

    def publish(self, message: Message) -> None:
        """Publish a message that has every field of its type."""
        self._most = max(self._most, self._publisher.get_num_connections())
        # A part of a message stays in rospy's buffer if it is interrupted, and would be sent before the next one.
        _sender.call(partial(self._publisher.publish, as_message(self._cls, message)))
        check_running(self._rospy.is_shutdown, self._topic)

    def is_heard(self) -> bool:
        """Whether a subscriber is connected."""
        return bool(self._publisher.get_num_connections())

    def flush(self, seconds: float) -> None:
        """Return once the connected subscribers have the messages, as far as this machine can know.

        It raises a `LinkError` if one does not receive them, or has lost its connection; or rospy was shut down.
        """
        deadline = time.monotonic() + seconds
        connections = list(self._publisher.impl.connections)
        for connection in connections:
            if (is_idle := _await_idle(connection, deadline)) is False:
                raise self._not_taken(f"a message is not taken within {seconds:g} s by {connection.endpoint_id}")
            if is_idle is None:
                time.sleep(_UNTOLD_SECONDS)
        check_running(getattr(self._rospy.core, "is_shutdown_requested", self._rospy.is_shutdown), self._topic)
        # rospy notices a broken connection only at the next message, and removes it then.
        broken = {each.endpoint_id for each in connections if getattr(each, "_error", None) is not None}
        count = self._publisher.get_num_connections()
        if broken or count < self._most:
            there = {each.node for each in self._subscribers()}  # a node that left is not registered any more
            if broken & there or count < len(there):
                names = enumerated(sorted(broken & there or there))
                raise self._not_taken(f"not all of its subscribers are connected any more: {names}")

    def close(self) -> None:
        """Leave the topic."""
        with suppress(Exception):  # a subscriber that receives nothing must not block closing
            self.flush(_CLOSING_SECONDS)
        within(self._publisher.unregister, where=self._topic, doing="leaving the topic")

    def reach(self) -> bool:
        """Wait until all subscribers are connected, and have what was published; return whether they are.

        They have to be connected for long enough not to reconnect.
        """
        subscribers = [each.node for each in self._subscribers()]  # without dead nodes, which would not connect
        deadline = time.monotonic() + CONNECTING
        while self._publisher.get_num_connections() < len(subscribers):
            left = deadline - time.monotonic()
            if left <= 0:
                missing = set(subscribers).difference(each.endpoint_id for each in self._publisher.impl.connections)
                # Of a machine that was switched off, only `rosnode cleanup` takes its nodes from the master.
                _logger.warning("%s: subscribers are not reached: %s", self._topic, enumerated(sorted(missing)))
                return False
            self._arrivals.wait(left)
        # A subscriber whose network is cut stays connected for minutes, and receives nothing of what is published.
        for connection in list(self._publisher.impl.connections):
            if _await_idle(connection, deadline) is False:
                _logger.warning("%s: %s does not take what is published", self._topic, connection.endpoint_id)
                return False
        return time.monotonic() - self._arrivals.last >= _SETTLING

    def _not_taken(self, problem: str) -> LinkError:
        return LinkError(problem, where=self._topic, fix="Check whether the robot is on and in this network.")


class _Arrivals:
    """Notices when a subscriber connects, the `last` on the monotonic clock (s); rospy calls it."""

    def __init__(self) -> None:
        self._arrived = threading.Event()
        self.last = -math.inf

    def peer_subscribe(self, *_: object) -> None:
        self.last = time.monotonic()
        self._arrived.set()

    def peer_unsubscribe(self, *_: object) -> None:
        """Do nothing; rospy requires this method."""

    def wait(self, timeout: float) -> None:
        self._arrived.wait(timeout)
        self._arrived.clear()


def _have_undelivered_die_with_us(publisher: Any) -> None:
    """Have the system drop what is not delivered yet where this process is killed, but not where the topic is left."""
    add, close = publisher.add_connection, publisher.close

    def add_dropping(connection: Any) -> Any:
        drop_undelivered(connection.socket)
        return add(connection)

    def close_delivering() -> None:
        for connection in list(publisher.connections):
            drop_undelivered(getattr(connection, "socket", None), is_dropped=False)
        close()

    publisher.add_connection, publisher.close = add_dropping, close_delivering


def _await_idle(connection: Any, deadline: float) -> bool | None:
    """Wait until all messages of a connection are delivered, or the deadline has passed; return as `_is_idle` does."""
    while (is_idle := _is_idle(connection)) is False and time.monotonic() <= deadline:
        time.sleep(POLL)
    return is_idle


def _is_idle(connection: Any) -> bool | None:
    """Return whether the other machine has all messages of a connection; None where that is not known.

    rospy's thread takes the whole queue and then sends it. So an empty queue is not enough: the thread must be waiting,
    too. It is not known without a queue, as of a config's own publisher, or in another version of rospy.
    """
    try:
        waiters = connection._cond_data_available._waiters  # noqa: SLF001 - no public function of rospy returns it
        with connection._lock:  # noqa: SLF001 - as above
            is_sent = bool(connection.done or (not connection._queue and waiters))  # noqa: SLF001 - as above
    except (AttributeError, TypeError):
        return None
    return is_sent and not _is_unacknowledged(connection)


def _is_unacknowledged(connection: Any) -> bool:
    """Return whether the system keeps something that the other machine has not acknowledged; False if not known.

    Source: tcp(7), SIOCOUTQ.
    """
    if sys.platform != "linux":
        return False
    count = array("i", [0])
    with suppress(AttributeError, OSError, ValueError):  # it was closed meanwhile: its descriptor is -1 then
        ioctl(connection.socket.fileno(), termios.TIOCOUTQ, count)
    return count[0] > 0
