"""The link to a robot that runs ROS 2, over DDS, from a machine without ROS."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.events.clock import SystemClock
from robot_runner.links.dds.services import OfferedService, ServiceClient
from robot_runner.links.dds.session import Session
from robot_runner.links.dds.topics import TopicSubscription, TopicWriter
from robot_runner.links.graph_names import full_name
from robot_runner.links.listening import first_message
from robot_runner.links.robot import Encoding, Qos
from robot_runner.links.shapes import plain_type
from robot_runner.links.velocity_commands import VELOCITY_COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.events.clock import Clock
    from robot_runner.links.dds.graph import Endpoint
    from robot_runner.links.dds.settings import DdsSettings
    from robot_runner.links.robot import Message, RawMessage, Subscription

__all__ = ["DdsRobotLink"]

#: How long what was published is waited for to arrive before the link leaves.
_CLOSING_SECONDS = 0.5


class DdsRobotLink:
    """A robot on a graph of ROS 2, reached as a participant of its DDS domain.

    Example:
        >>> from robot_runner.events.clock import SystemClock
        >>> from robot_runner.links.dds.settings import DdsSettings
        >>> link = DdsRobotLink(DdsSettings.of({"domain": "99"}), SystemClock())  # doctest: +SKIP
        >>> link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})  # doctest: +SKIP
        >>> link.close()  # doctest: +SKIP
    """

    def __init__(self, settings: DdsSettings, clock: Clock, *, namespace: str = "") -> None:
        """Join the graph.

        Raises:
            LinkError: the domain cannot be joined, or a type definition cannot be used.
        """
        # A clock that is not this machine's is a simulation's, whose time the messages are stamped by.
        self._now_ns = time.time_ns if isinstance(clock, SystemClock) else lambda: int(clock.now() * 1e9)
        self._namespace = namespace
        self._lock = threading.RLock()
        self._writers: dict[str, TopicWriter] = {}
        self._clients: dict[tuple[str, str], ServiceClient] = {}
        self._subscriptions: list[TopicSubscription] = []
        self._moved: set[str] = set()
        self._open_ends = ExitStack()
        self._is_closed = False
        self._session = Session(settings)
        self._session.graph.on_writer = self._adapt

    @property
    def is_simulated(self) -> bool:
        """Never: what is behind a graph cannot be told from it."""
        return False

    @property
    def encoding(self) -> Encoding:
        """CDR."""
        return Encoding.CDR

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message.

        Raises:
            LinkError: the topic carries another type, or the message does not follow its definition.
        """
        name = full_name(self._namespace, topic)
        self._session.check_open(name)
        with self._lock:
            writer = self._writer(name, message_type, qos)
        writer.publish(message)
        if writer.message_type in VELOCITY_COMMANDS:
            self._moved.add(name)

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic, in a thread of the link.

        Raises:
            LinkError: the topic carries another type, its publishers offer less than `qos`, or there is no such type.
        """
        return self.subscribe_raw(topic, message_type, self._decoded(message_type, callback), qos=qos)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic; as `subscribe` in all else."""
        return self._subscribe(full_name(self._namespace, topic), message_type, callback, qos)

    def wait_for(
        self,
        topic: str,
        message_type: str,
        condition: Callable[[Message], bool] | None = None,
        *,
        timeout: float = 5.0,
    ) -> Message:
        """Return the first message from now on that satisfies the condition; `timeout` is in seconds.

        Raises:
            LinkError: none came in time, or as `subscribe`.
        """
        name = full_name(self._namespace, topic)
        opened: list[TopicSubscription] = []

        def subscribe(hear: Callable[[Message], None]) -> Subscription:
            opened.append(self._subscribe(name, message_type, self._decoded(message_type, hear), None))
            return opened[0]

        return first_message(
            subscribe,
            condition,
            timeout=timeout,
            where=name,
            explain=lambda: opened[0].explain(),  # noqa: PLW0108  # there is none before it is subscribed
            wait=lambda event, seconds: self._session.reception.wait_for(event.is_set, seconds),
        )

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds.

        Raises:
            LinkError: there is no such service, it has another type, it does not answer in time, or the request does
                not follow its definition.
        """
        name = full_name(self._namespace, service)
        self._session.check_open(name)
        with self._lock:
            if (name, service_type) not in self._clients:
                self._clients[name, service_type] = ServiceClient(self._session, name, service_type)
            client = self._clients[name, service_type]
        return client.call(request or {}, timeout)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; requests are answered in threads of their own.

        Raises:
            LinkError: there is no such type, or somebody offers a service of this name already.
        """
        offered = OfferedService(self._session, full_name(self._namespace, service), service_type, answer)
        self._open_ends.callback(offered.close)
        return offered

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that is published or heard on the graph, by its full name."""
        return self._settled().graph.topics()

    def services(self) -> Mapping[str, str]:
        """Return the type of each service on the graph, by its full name."""
        return self._settled().graph.services()

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted."""
        return self._settled().nodes.names()

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, with those that it is made of after it.

        Raises:
            LinkError: there is no such type.
        """
        return self._session.types.definition(message_type)

    def close(self) -> None:
        """Stop what was driven, end all subscriptions and offers, and leave; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        with ExitStack() as stack:
            stack.callback(self._session.close)
            stack.callback(self._open_ends.close)
            stack.callback(self._flush)
            for topic in self._moved:
                stack.callback(self._writers[topic].publish, {})

    def _flush(self) -> None:
        deadline = time.monotonic() + _CLOSING_SECONDS
        for writer in self._writers.values():
            writer.flush(max(0.0, deadline - time.monotonic()))

    def _settled(self) -> Session:
        self._session.check_open("the graph")
        self._session.settle(lambda: False)
        return self._session

    def _subscribe(
        self, name: str, message_type: str, callback: Callable[[RawMessage], None], qos: Qos | None
    ) -> TopicSubscription:
        subscription = TopicSubscription(self._session, name, message_type, callback, qos=qos, now_ns=self._now_ns)
        with self._lock:
            self._subscriptions = [each for each in self._subscriptions if each.is_open]
            self._subscriptions.append(subscription)
        return subscription

    def _writer(self, topic: str, message_type: str, qos: Qos) -> TopicWriter:
        writer = self._writers.get(topic)
        if writer is not None and (writer.message_type, writer.qos) == (plain_type(message_type), qos):
            return writer
        fresh = TopicWriter(self._session, topic, message_type, qos)
        if writer is not None:
            writer.close()
        self._writers[topic] = fresh
        return fresh

    def _adapt(self, writer: Endpoint) -> None:
        for subscription in self._subscriptions:
            subscription.adapt(writer)

    def _decoded(self, message_type: str, callback: Callable[[Message], None]) -> Callable[[RawMessage], None]:
        types = self._session.types
        return lambda raw: callback(types.deserialise(message_type, raw.data, Encoding.CDR))
