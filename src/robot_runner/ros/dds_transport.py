"""Topics over DDS as a participant that looks like a node of ROS 2; services are in `dds_services`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from cyclonedds.core import DDSException

from robot_runner.core.errors import LinkError
from robot_runner.core.links.commanded_topics import VELOCITIES, topics_of_zero_first
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, Qos, RawMessage
from robot_runner.ros.action_types import is_action_part
from robot_runner.ros.dds_foreign_services import ForeignServices
from robot_runner.ros.dds_graph import Endpoint, matched_subscriptions, ros_type, wire_topic
from robot_runner.ros.dds_qos import adapted_profile, policies_of, reader_profile, writer_profile
from robot_runner.ros.dds_reception import RawSample, Source, WireType, delete, topic_wire_type
from robot_runner.ros.dds_services import OfferedService, ServiceClient, await_service, is_foreign
from robot_runner.ros.dds_session import Session
from robot_runner.ros.graph_transport import (
    LONGEST_DISCOVERY,
    Lane,
    ReceivedBytes,
    Reception,
    check_type,
    service_timeout,
)
from robot_runner.ros.qos_policies import KEPT, reachable, unmet_demand
from robot_runner.ros.ros2_actions import Ros2Actions

if TYPE_CHECKING:
    from cyclonedds.qos import Qos as DdsQos

    from robot_runner.ros.graph_addresses import DdsSettings

#: How long a publisher that is closed waits until its readers have received what it published, s.
_CLOSING_SECONDS = 0.5
#: How long readers on the graph may take to be matched, s; one that requests more than is offered never is.
_MATCHING_SECONDS = 1.0
#: Before the source timestamp of any sample, in ns.
_NEVER = -(2**63)


class DdsTransport:
    """The primitives of a graph link over DDS, from a machine without ROS.

    Raises:
        LinkError: the domain cannot be joined, or a type definition cannot be used.
    """

    has_threads = True
    encoding = Encoding.CDR

    def __init__(self, settings: DdsSettings, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._lock = threading.Lock()
        self._clients: dict[tuple[str, str], ServiceClient] = {}
        self._subscriptions: list[_Subscription] = []
        self._session = Session(settings)
        self._foreign = ForeignServices(self._session)
        self._session.graph.on_writer = self._adapt
        self.types = self._session.types
        self.actions = Ros2Actions(self)

    def advertise(self, topic: str, message_type: str, qos: Qos) -> _Publisher:
        """Return a publisher, once the existing readers are matched."""
        return _Publisher(self._session, topic, message_type, qos)

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, lane: Lane
    ) -> _Subscription:
        """Have `receive` called with each message, in the session's thread for its lane."""
        decode = partial(self.types.deserialise, message_type, encoding=Encoding.CDR)

        def take(data: bytes) -> None:
            misfit = subscription.misfit
            receive(_Misread(misfit) if misfit else ReceivedBytes(data, self._now_ns(), decode))

        subscription = _Subscription(self._session, topic, message_type, take, qos, lane)
        # Under one lock: a publisher that is discovered meanwhile is adapted to either here or in `_adapt`.
        with self._lock:
            subscription.open()
            self._subscriptions = [each for each in self._subscriptions if each.is_open]
            self._subscriptions.append(subscription)
        return subscription

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service and return its response; the client is kept, as its discovery takes a while."""
        deadline = time.monotonic() + timeout
        await_service(self._session, service, service_type, deadline)
        if is_foreign(self._session, service):
            response = self._foreign.call(service, service_type, request, deadline)
        else:
            with self._lock:
                key = service, service_type
                if key not in self._clients:
                    self._clients[key] = ServiceClient(self._session, service, service_type)
                client = self._clients[key]
            response = client.call(request, deadline)
        if response is None:
            raise service_timeout(service, timeout)
        return response

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> OfferedService:
        """Offer a service; requests are answered in threads of their own."""
        return OfferedService(self._session, service, service_type, answer)

    def topics(self) -> Mapping[str, str]:
        """Return the type of each ROS topic that has a publisher or a subscriber."""
        self._session.settle(lambda: False)
        return self._session.graph.topics()

    def services(self) -> Mapping[str, str]:
        """Return the type of each service that is offered."""
        self._session.settle(lambda: False)
        return self._session.graph.services()

    def nodes(self) -> Iterable[str]:
        """Return the full names of the nodes that participants have announced."""
        self._session.settle(lambda: False)
        return self._session.nodes.names()

    def publishers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the publishers of a topic."""
        self._session.settle(lambda: False)
        return map(self._endpoint, self._session.graph.writers(wire_topic(topic)))

    def subscribers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the subscribers of a topic; on a graph that was just joined, as soon as there is another node."""
        wire, own = wire_topic(topic), self._session.guid
        # A process that has to stop a robot must not wait until everything on the graph is discovered.
        self._session.settle(lambda: any(reader.participant != own for reader in self._session.graph.readers(wire)))
        return map(self._endpoint, self._session.graph.readers(wire))

    def _endpoint(self, found: Endpoint) -> GraphEndpoint:
        node, is_own = self._session.nodes.name_of(found), found.participant == self._session.guid
        return GraphEndpoint(node, ros_type(found.type_name), is_own, policies_of(found.qos).profile)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait for an event; in a callback, what arrives meanwhile is received within it."""
        self._session.wait_event(event, seconds)

    def close(self) -> None:
        """Leave the graph."""
        self._foreign.close()
        self._session.close()

    def _adapt(self, writer: Endpoint) -> None:
        with self._lock:
            subscriptions = list(self._subscriptions)
        for subscription in subscriptions:
            subscription.adapt(writer)


class _Publisher:
    def __init__(self, session: Session, topic: str, message_type: str, qos: Qos) -> None:
        self._session = session
        self._topic = topic
        self._message_type = message_type
        self._wire_type = topic_wire_type(session.types.shape(message_type))
        self._wire = wire_topic(topic)
        self._user_data = session.type_hash(message_type)
        _check_types(session, topic, self._wire_type, self._user_data)
        self._qos = qos
        self._offered = writer_profile(qos, self._user_data)
        self._writer = session.writer(self._wire, self._wire_type, self._offered)
        # A message that is published before its readers are discovered does not reach them.
        # A stop is repeated until it reaches a robot, and that of another one must not wait for it.
        session.settle(self._reaches_others, awaits_robot=message_type in VELOCITIES and not topics_of_zero_first())
        try:
            _check_types(session, topic, self._wire_type, self._user_data)
            if qos is not Qos.DEFAULT:  # with that, this may have to stop a robot that is discovered later
                self._check_demands()
        except LinkError:
            self.close()
            raise

    def publish(self, message: Message) -> None:
        data = self._session.types.serialise(self._message_type, message, Encoding.CDR)
        try:
            self._writer.write(self._wire_type(data))
        except DDSException as error:
            fix = "Publish more slowly, or with a QoS that may drop messages: a subscriber does not keep up."
            raise LinkError(f"the message cannot be published: {error}", where=self._topic, fix=fix) from error

    def _reaches_others(self) -> bool:
        readers = self._session.graph.readers(self._wire)
        return any(each.participant != self._session.guid for each in readers) and self._is_matched(readers)

    def _is_matched(self, readers: list[Endpoint]) -> bool:
        wanted = reachable([policies_of(each.qos) for each in readers], policies_of(self._offered))
        return len(matched_subscriptions(self._writer)) >= wanted

    def reach(self) -> bool:
        graph = self._session.graph
        is_matched = graph.wait_for(partial(self._is_matched, graph.readers(self._wire)), _MATCHING_SECONDS)
        self._check_demands()
        # A reader that is cut off stays matched for seconds, and receives nothing of what is published.
        # Once it counts as gone, no reader is left that has to acknowledge anything.
        matched = set(matched_subscriptions(self._writer))
        is_taken = is_matched and self._is_acknowledged(_MATCHING_SECONDS)
        return is_taken and matched.issubset(matched_subscriptions(self._writer))

    def is_heard(self) -> bool:
        return bool(matched_subscriptions(self._writer))

    def flush(self, seconds: float) -> None:
        # A process of Fast DDS may be matched here seconds before it discovers us; then it gets what was sent since.
        seconds = max(seconds, LONGEST_DISCOVERY)
        if not self._is_acknowledged(seconds):
            fix = "Check whether the robot is on and in this network."
            raise LinkError(f"a subscriber does not take it within {seconds:g} s", where=self._topic, fix=fix)

    def _is_acknowledged(self, seconds: float) -> bool:
        try:
            return bool(self._writer.wait_for_acks(int(seconds * 1e9)))
        except (AttributeError, DDSException):
            # cyclonedds 11.0 raises AttributeError at a timeout: it looks for that error code on a wrong class.
            return False

    def close(self) -> None:
        self._is_acknowledged(_CLOSING_SECONDS)  # not longer, for subscribers that do not acknowledge
        self._session.nodes.remove(self._writer.guid)
        delete(self._writer)

    def _check_demands(self) -> None:
        """Refuse a QoS with which no subscriber but our own receives anything, as all request more and do not adapt."""
        graph, own = self._session.graph, self._session.guid

        def unmet() -> LinkError | None:
            others = [policies_of(each.qos) for each in graph.readers(self._wire) if each.participant != own]
            return unmet_demand(self._topic, self._qos, others)

        error = unmet()
        if error is not None and not graph.wait_for(lambda: unmet() is None, _MATCHING_SECONDS):
            raise error


class _Subscription:
    """Receives one topic as bytes; adapts to the topic's publishers where no profile is requested."""

    def __init__(
        self,
        session: Session,
        topic: str,
        message_type: str,
        take: Callable[[bytes], None],
        qos: Qos | None,
        lane: Lane,
    ) -> None:
        self._session = session
        self._reception = session.reception_of(lane)
        self._topic = topic
        self._wire_topic = wire_topic(topic)
        self._take = take
        self._qos = qos
        self._lock = threading.Lock()
        self._is_closed = False
        self.misfit: LinkError | None = None
        # The stamp of the last sample of each publisher, and the one after which a reader that takes over begins.
        self._last: dict[int, int] = {}
        self._before: dict[int, int] = {}
        self._user_data = session.type_hash(message_type)
        self._wire_type = topic_wire_type(session.types.shape(message_type))
        session.settle(lambda: bool(session.graph.writers(self._wire_topic)))
        _check_types(session, topic, self._wire_type, self._user_data)
        self._asked = self._policies()
        self._check_offers()

    def open(self) -> None:
        self._asked = self._policies()
        self._source = self._reading()
        self._reception.serve(self._source)

    @property
    def is_open(self) -> bool:
        return bool(self._source.is_open)

    def explain(self) -> str:
        """Return the fix where no message arrived; raise a `LinkError` where a later publisher does not fit the QoS."""
        _check_types(self._session, self._topic, self._wire_type, self._user_data)
        self._check_offers()
        if self._session.is_alone():
            return self._session.loneliness()
        if not self._session.graph.writers(self._wire_topic):
            return "No node publishes it: start the one that does."
        return ""

    def adapt(self, writer: Endpoint) -> None:
        """Request what the topic's publishers offer, now that there is another."""
        if writer.topic == self._wire_topic:
            self.misfit = self.misfit or _other_version(self._topic, self._wire_type, writer, self._user_data)
        if self._qos is None and writer.topic == self._wire_topic:
            # Not while its callback waits: messages that have arrived would be lost, or handled out of order.
            self._reception.when_idle(self._source, self._adapt)

    def close(self) -> None:
        with self._lock:
            self._is_closed = True
        self._end(self._source)

    def _policies(self) -> DdsQos:
        if self._qos is not None:
            return reader_profile(self._qos, self._user_data)
        offers = [writer.qos for writer in self._session.graph.writers(self._wire_topic)]
        return adapted_profile(offers, self._user_data)

    def _adapt(self) -> None:
        asked = self._policies()
        if asked == self._asked or not self.is_open:
            return
        self._asked = asked
        former, fresh = self._source, self._reading()
        self._reception.drain(former)
        # While a callback waited, another thread may have closed this, or it may have adapted once more.
        with self._lock:
            takes_over = not self._is_closed and self._source is former
            if takes_over:
                self._source, self._before = fresh, dict(self._last)
                self._reception.serve(fresh)  # only now is it known what both have received
        self._end(former if takes_over else fresh)

    def _check_offers(self) -> None:
        for writer in self._session.graph.writers(self._wire_topic):
            if (less := policies_of(self._asked).shortfall(policies_of(writer.qos))) is not None:
                problem = f"a publisher offers less than the QoS {str(self._qos)!r} asks for: {less}"
                raise LinkError(problem, where=self._topic, fix="Leave the QoS out, so that it fits the publishers.")

    def _reading(self) -> Any:
        reader = self._session.reader(self._wire_topic, self._wire_type, self._asked)
        # A profile of one's own may drop; and a topic that keeps messages may send as many to a late subscriber.
        depth = 0 if self._qos is not None or policies_of(self._asked).is_kept else KEPT
        return Source(reader, self._receive, self._topic, depth=depth)

    def _end(self, source: Any) -> None:
        self._session.nodes.remove(source.reader.guid)
        self._reception.remove(source)

    def _receive(self, sample: RawSample) -> None:
        info = sample.sample_info
        if not info.valid_data or info.source_timestamp <= self._before.get(info.publication_handle, _NEVER):
            return
        self._before.pop(info.publication_handle, None)  # from now on samples arrive in order, whatever their stamps
        self._last[info.publication_handle] = info.source_timestamp
        self._take(sample.data)


def _check_types(session: Session, topic: str, wire_type: WireType, user_data: str) -> None:
    """Refuse a topic whose other publishers or subscribers have another type, or another version of it.

    DDS silently does not match the former. Values of the latter would be taken for others, of the same bytes.
    """
    wire = wire_topic(topic)
    endpoints = (*session.graph.writers(wire), *session.graph.readers(wire))
    check_type(topic, _type_of(wire_type), [ros_type(each.type_name) for each in endpoints])
    for each in endpoints:
        if misfit := _other_version(topic, wire_type, each, user_data):
            raise misfit


def _type_of(wire_type: WireType) -> str:
    return ros_type(wire_type.__idl_typename__.replace(".", "::"))


def _other_version(topic: str, wire_type: WireType, endpoint: Endpoint, user_data: str) -> LinkError | None:
    """Return the error that a publisher or subscriber has another version of our type, where both are known."""
    name, told = _type_of(wire_type), endpoint.type_hash
    is_ours = ros_type(endpoint.type_name) != name or told in {"", user_data}
    if is_ours or not user_data or is_action_part(name):
        return None
    problem = f"the topic carries another version of {name} than the one that is known here"
    fix = "Give the robot's own definition, or its distribution: robot = 'dds:types=path/to/its/package,distro=...'."
    return LinkError(problem, where=topic, fix=fix)


class _Misread(NamedTuple):
    """A message of a topic on which values would be taken for others."""

    misfit: LinkError

    def message(self) -> Message:
        raise self.misfit

    def raw(self) -> RawMessage:
        raise self.misfit
