"""Topics and services over rospy; the process is one node, whatever the number of robots."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from robot_runner.core.errors import LinkError
from robot_runner.core.links.graph_names import missing
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, Qos
from robot_runner.ros.graph_transport import (
    Lane,
    ReceivedBytes,
    Reception,
    already_offered,
    check_type,
    nobody_publishes,
    silent_publishers,
    until,
)
from robot_runner.ros.ros1_actions import Ros1Actions
from robot_runner.ros.ros1_node import completed_first, join_graph, offers_to_us, pid_in_name, within
from robot_runner.ros.ros1_publisher import CONNECTING, POLL, Publisher
from robot_runner.ros.ros1_services import call_service, service_type
from robot_runner.ros.ros1_types import Ros1Types, as_mapping, as_message, message_class, service_class
from robot_runner.ros.shapes import plain_type

if TYPE_CHECKING:
    from robot_runner.ros.ros1_master import Master

_logger = logging.getLogger(__name__)

#: The timeout for a connected publisher to report the connection, s: it takes a millisecond, or is not supported.
_TELLING_SECONDS = 0.5
#: The timeout for asking a service for its type, and a subscriber whether it is there, s.
_PROBING_SECONDS = 0.5
_START = "Start the node that offers it."


class Ros1Transport:
    """The primitives of a graph link over rospy; raises a `LinkError` if there is no such master, or no rospy.

    Every topic is received as bytes and decoded here, so that a recorder and a callback share one connection.
    """

    has_threads = True
    encoding = Encoding.ROS1

    def __init__(self, master: Master, now_ns: Callable[[], int]) -> None:
        self.types = Ros1Types()
        self.actions = Ros1Actions(self)
        self._master = self.parameter_server = master
        self._now_ns = now_ns
        self._rospy = join_graph(master)

    def advertise(self, topic: str, message_type: str, qos: Qos) -> Publisher:
        """Return a publisher, once the existing subscribers are connected."""
        self._check_type(topic, message_type)
        return Publisher(self._rospy, topic, message_class(message_type), qos, partial(self.subscribers, topic))

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, lane: Lane
    ) -> _Subscription:
        """Call `receive` with each message, in a thread of rospy; in ROS 1 only publishers choose a QoS.

        It returns once the publishers that are there already are connected: what they publish next is received. Bytes,
        which are measured or recorded, and prompt callbacks get each message before the others, which may take long.
        """
        del qos  # each topic has a thread for each of its publishers
        self._check_type(topic, message_type, publishers_only=True)
        publishers = [each.node for each in self.publishers(topic)]
        subscription = _Subscription(self, topic, message_class(message_type), receive)
        if lane in {Lane.PROMPT, Lane.BYTES}:
            subscription.come_first()
        try:
            subscription.connect(publishers)
        except BaseException:  # the run ends now
            subscription.close()
            raise
        return subscription

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service and return its response."""
        cls = service_class(service_type)
        uri = self._master.service(service)
        if uri is None:
            known = self._master.state().services
            raise missing("service", service, known, where=f"ros1 {self._master.uri}", fix=_START)
        return as_mapping(call_service(service, uri, cls, as_message(cls._request_class, request), timeout=timeout))

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> ExitStack:
        """Offer a service; rospy tells the caller only that a request failed."""
        self._check_free(service)
        cls, offer = service_class(service_type), ExitStack()

        def respond(request: Any) -> Any:
            return as_message(cls._response_class, answer(as_mapping(request)))

        # Without a handler rospy would print the exception of the callback, which the link has logged already.
        register = partial(self._rospy.Service, service, cls, respond, error_handler=lambda *_: None)
        offered = within(register, where=service, doing="registering the service")
        offer.callback(within, offered.shutdown, where=service, doing="withdrawing the service")
        return offer

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that has a publisher or a subscriber."""
        state, types = self._master.state(), self._master.topic_types()
        return {name: plain_type(types.get(name, "")) for name in sorted({*state.publishers, *state.subscribers})}

    def services(self) -> Mapping[str, str]:
        """Return the type of each service, as the service reports it; those that do not answer are left out."""
        found = {}
        for name in sorted(self._master.state().services):
            try:
                uri = self._master.service(name)
                found[name] = "" if uri is None else service_type(name, uri, timeout=_PROBING_SECONDS)
            except LinkError as error:
                _logger.info("%s", error)
        return {name: known for name, known in found.items() if known}

    def nodes(self) -> Iterable[str]:
        """Return the names of the nodes that publish, subscribe or offer something."""
        return self._master.state().nodes

    def answers(self, node: str) -> bool:
        """Whether a node is there: a killed one stays registered; one whose machine is silent may be."""
        return self._is_there(node, is_alone=False, may_be_silent=True)

    def publishers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the publishers of a topic, with the type known to the master; QoS only of those connected to us."""
        offered = offers_to_us(topic)
        found = self._endpoints(topic, self._master.state().publishers)
        return [replace(each, qos=offered.get(each.node)) for each in found]

    def subscribers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the subscribers of a topic, all with the type that the master knows."""
        return self._endpoints(topic, self._master.state().subscribers, may_be_silent=True)

    def _endpoints(
        self, topic: str, by_topic: Mapping[str, tuple[str, ...]], *, may_be_silent: bool = False
    ) -> list[GraphEndpoint]:
        known, own = plain_type(self._master.topic_types().get(topic, "")), self._rospy.get_name()
        nodes = by_topic.get(topic, ())
        return [
            GraphEndpoint(node, known, node == own)
            for node in nodes
            if node == own or self._is_there(node, is_alone=len(nodes) == 1, may_be_silent=may_be_silent)
        ]

    def _is_there(self, node: str, *, is_alone: bool, may_be_silent: bool) -> bool:
        """Whether a node answers: a killed node stays registered at the master.

        One of ours is unregistered then. Otherwise each run that is killed would leave one more, which the master
        reports to the robot, and which the robot tries to reach, at each new publisher. The only one of a topic
        is there until it was taken away. With `may_be_silent`, so is one that does not answer, unless its machine
        refuses the connection: a robot that is out of reach has not gone, even if others subscribe to its commands.
        """
        began, is_taken_away, is_silent = pid_in_name(node), False, False
        if is_alone and began is None:
            return True
        try:
            # The stop of a robot asks repeatedly, and must not take long: a later answer counts as none.
            answered = self._master.pid_of(node, timeout=_PROBING_SECONDS if may_be_silent else None)
            is_gone = began is not None and answered not in {None, began}  # another process has its address by now
        except LinkError as error:
            is_refused = isinstance(error.__cause__, ConnectionRefusedError)
            answered, is_gone = None, began is not None and is_refused
            is_silent = may_be_silent and isinstance(error.__cause__, OSError) and not is_refused
        if is_gone:
            with suppress(LinkError):
                is_taken_away = self._is_forgotten(node)
        return not is_taken_away if is_alone else is_silent or (answered is not None and not is_gone)

    def _is_forgotten(self, node: str) -> bool:
        """Unregister a node with this machine's address: on other machines, it may be a firewall that refuses us."""
        hosts = {urlsplit(uri or "").hostname for uri in (self._master.uri_of(node), self._rospy.get_node_uri())}
        if is_here := len(hosts) == 1:
            self._master.forget(node)
        return is_here

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait at most `seconds` for an event."""
        event.wait(seconds)

    def close(self) -> None:
        """Do nothing: rospy's node ends with the process, and is not visible once nothing is open on it."""

    def explain_silence(self, topic: str) -> str:
        """Return the advice where no message came on a topic."""
        publishers = self._master.state().publishers
        return silent_publishers(publishers[topic]) if topic in publishers else nobody_publishes(topic, publishers)

    def open_subscriber(self, topic: str, receive: Callable[[Any], None]) -> Any:
        """Return a subscriber of rospy for messages of any type.

        rospy shares one connection among all subscribers of a topic, with the class of the first. Its class for any
        message suits all of them.
        """

        def complete(subscriber: Any) -> None:
            subscriber.set_tcp_nodelay(True)
            _connect_once(subscriber)

        def register() -> Any:
            with completed_first(topic, "sub", complete):
                return self._rospy.Subscriber(topic, self._rospy.AnyMsg, receive, tcp_nodelay=True)

        return within(register, where=topic, doing="registering the subscriber")

    def is_served(self, topic: str, publishers: Iterable[str]) -> bool:
        """Whether all of these nodes report that they send a topic to this one."""
        return all(self._master.is_serving(each, topic, self._rospy.get_name()) for each in publishers)

    def received(self, data: bytes, decode: Callable[[bytes], Message]) -> ReceivedBytes:
        """Return bytes as a message received now."""
        return ReceivedBytes(data, self._now_ns(), decode)

    def _check_type(self, topic: str, wanted: str, *, publishers_only: bool = False) -> None:
        true = self._master.topic_types().get(topic, wanted)
        if true == wanted:
            return
        state = self._master.state()  # the master keeps the types of topics that no longer exist
        if state.publishers.get(topic) or (not publishers_only and state.subscribers.get(topic)):
            check_type(topic, wanted, [true])

    def _check_free(self, service: str) -> None:
        uri = self._master.service(service)
        if uri is None:
            return
        try:
            service_type(service, uri, timeout=_PROBING_SECONDS)
        except LinkError:
            return  # the registration of a dead node
        raise already_offered(service, ", ".join(self._master.state().services.get(service, ("another node",))))


def _connect_once(subscriber: Any) -> None:
    """Have rospy keep its connection to a publisher that is announced twice at a time.

    rospy would replace the connection, and lose the messages that it has not yet read from the former one.
    """
    add = subscriber.add_connection

    def add_first(connection: Any) -> bool:
        with subscriber.c_lock:
            return not subscriber.has_connection(connection.endpoint_id) and bool(add(connection))

    subscriber.add_connection = add_first


class _Subscription:
    """Receives one topic as bytes, and drops messages of another type than the requested one."""

    def __init__(self, transport: Ros1Transport, topic: str, cls: Any, receive: Callable[[Reception], None]) -> None:
        self._transport = transport
        self._topic = topic
        self._cls = cls
        self._type: str = cls._type
        self._digests = {cls._md5sum, "*"}
        self._receive = receive
        self._foreign: set[str] = set()
        self._kept: Any = None
        # Callbacks must not overlap, as on all other links, but rospy has a thread for each publisher of the topic.
        self._taking = threading.RLock()
        self._subscriber = transport.open_subscriber(topic, self._take)

    def connect(self, publishers: Sequence[str]) -> None:
        until(lambda: self._subscriber.get_num_connections() >= len(publishers), CONNECTING, every=POLL)
        # Our side is connected; a publisher begins to send a little later, and not every one reports that.
        until(lambda: self._transport.is_served(self._topic, publishers), _TELLING_SECONDS, every=POLL)

    def come_first(self) -> None:
        """Get each message before the other subscriptions of the topic: rospy calls all of them one after the other."""
        topic = self._subscriber.impl
        with topic.c_lock:
            topic.callbacks = sorted(topic.callbacks, key=lambda each: each[0] != self._take)

    def explain(self) -> str:
        return self._transport.explain_silence(self._topic)

    def close(self) -> None:
        within(self._subscriber.unregister, where=self._topic, doing="leaving the topic")

    def _take(self, message: Any) -> None:
        with self._taking:
            header = message._connection_header  # noqa: SLF001 - where rospy documents it to be
            # rospy delivers a latched message twice if it arrives while the subscription begins.
            is_known, self._kept = message is self._kept, message if header.get("latching") == "1" else None
            if header["md5sum"] in self._digests and not is_known:
                self._receive(self._transport.received(message._buff, self._decode))  # noqa: SLF001 - as above
            elif header["md5sum"] not in self._digests and header["callerid"] not in self._foreign:
                self._foreign.add(header["callerid"])
                text = "%s: %s publishes %s, or another version of it, which is not received as %s"
                _logger.error(text, self._topic, header["callerid"], header.get("type"), self._type)

    def _decode(self, data: bytes) -> dict[str, Any]:
        return as_mapping(self._cls().deserialize(data))
