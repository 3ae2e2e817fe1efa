"""Topics and services over rclpy, where a ROS 2 is sourced; the process is one node, whatever the number of robots."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from robot_runner.core.errors import LinkError
from robot_runner.core.links.graph_names import missing
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, Qos
from robot_runner.ros.action_types import is_action_part
from robot_runner.ros.graph_transport import (
    LONGEST_DISCOVERY,
    Lane,
    ReceivedBytes,
    Reception,
    already_offered,
    check_type,
    is_hidden,
    nobody_publishes,
    service_timeout,
    silent_publishers,
    until,
    wrong_service_type,
)
from robot_runner.ros.qos_policies import WEAKEST, Policies, adapted, asked_by, offered_by, reachable, unmet_demand
from robot_runner.ros.ros2_actions import Ros2Actions
from robot_runner.ros.ros2_node import SETTLING, Graph, GraphNode, join_graph, policies_of
from robot_runner.ros.ros2_types import Ros2Types, as_mapping, as_message, message_class, service_class

try:
    from rclpy.event_handler import SubscriptionEventCallbacks
except ModuleNotFoundError:  # Humble
    from rclpy.qos_event import SubscriptionEventCallbacks


_logger = logging.getLogger(__name__)

#: How long after joining the graph the publishers and subscribers of a topic are known, s: Fast DDS discovers a process
#: within 3.2 s (see LONGEST_DISCOVERY), and its topics right afterwards.
_FINDING = 4.0
#: How long to wait for a message to be sent where the middleware does not report it, s.
_UNTOLD = 0.2
#: How long a publisher or subscription of this process may take to be listed, s, and the hash of an unknown version.
_FINDING_OWN, _UNKNOWN = 1.0, "INVALID"
#: How long a publisher waits for the subscribers that are known, s.
_MATCHING = 1.0
#: How long it waits for their acknowledgements, s: Fast DDS requests these every 3 s.
_ACKNOWLEDGING = 3.5


class Ros2Transport:
    """The primitives of a graph link over rclpy, on a DDS domain; None for what ROS_DOMAIN_ID says.

    Raw messages are stamped with `now_ns`; with `use_sim_time` the node follows the time on `/clock`; `is_shared` says
    whether the node is that of the process.

    Raises:
        LinkError: the graph cannot be joined.
    """

    has_threads = True
    encoding = Encoding.CDR

    def __init__(
        self, domain: int | None, now_ns: Callable[[], int], *, use_sim_time: bool, is_shared: bool = True
    ) -> None:
        self.rejoined = partial(Ros2Transport, domain, now_ns, use_sim_time=use_sim_time, is_shared=False)
        self.types = Ros2Types()
        self.actions = Ros2Actions(self)
        self._now_ns = now_ns
        self._lock = threading.Lock()
        self._clients: dict[tuple[str, str], _Client] = {}
        self._node = join_graph(domain, use_sim_time=use_sim_time, is_shared=is_shared)
        self._graph = Graph(self._node)
        self.topics, self.services, self.nodes = self._graph.topics, self._graph.services, self._graph.nodes

    def advertise(self, topic: str, message_type: str, qos: Qos) -> _Publisher:
        """Return a publisher, once the existing subscribers are connected."""
        return _Publisher(self._node, self._graph, topic, message_type, qos)

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, lane: Lane
    ) -> _Subscription:
        """Call `receive` with each message, in the node's thread for its lane."""
        cls = message_class(message_type)

        def decode(data: bytes) -> Message:
            return as_mapping(deserialize_message(data, cls))

        def take(data: bytes) -> None:
            reception = ReceivedBytes(bytes(data), self._now_ns(), decode)
            self._node.later(lambda: receive(reception), lane, size=len(reception.data))

        return _Subscription(self._node, self._graph, topic, message_type, take, qos)

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service and return its response; clients are reused, because their discovery takes time."""
        with self._lock:
            key = service, service_type
            if key not in self._clients:
                self._clients[key] = _Client(self._node, self._graph, service, service_type)
            client = self._clients[key]
        return client.call(request, timeout)

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> ExitStack:
        """Offer a service; where `answer` raises, no response is sent: services of ROS 2 cannot report a failure."""
        cls, offer = service_class(service_type), ExitStack()
        self._node.settle(lambda: self._graph.service_type(service))
        if self._graph.service_type(service) is not None:
            raise already_offered(service)

        def respond(request: Any, _response: Any) -> Any:
            return as_message(cls.Response, answer(as_mapping(request)))

        host = self._node.services()
        offered = host.create_service(cls, service, respond, callback_group=ReentrantCallbackGroup())
        offer.callback(host.destroy_service, offered)
        until(lambda: self._graph.service_type(service), LONGEST_DISCOVERY)
        return offer

    def publishers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the publishers of a topic."""
        return self._graph.endpoints(self._graph.publishers(topic))

    def subscribers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the subscribers of a topic."""
        return self._graph.endpoints(self._graph.subscriptions(topic))

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait at most `seconds` for an event."""
        event.wait(seconds)

    def close(self) -> None:
        """Leave the graph with the last link of the process."""
        self._node.leave()


class _Publisher:
    def __init__(self, node: GraphNode, graph: Graph, topic: str, message_type: str, qos: Qos) -> None:
        self._node, self._graph, self._topic = node, graph, topic
        self._cls = message_class(message_type)
        # Without a subscriber a message is lost, unless it is transient local. On hidden topics, those of actions, only
        # nodes that have sent a request before are subscribers.
        is_awaited = qos is not Qos.TRANSIENT_LOCAL and not is_hidden(topic)
        node.settle(lambda: graph.subscriptions(topic), _FINDING if is_awaited else SETTLING)
        _check_types(topic, message_type, [*graph.publishers(topic), *graph.subscriptions(topic)])
        self._qos, self._offered = qos, offered_by(qos)
        self._publisher = node.node.create_publisher(self._cls, topic, _as_profile(self._offered))
        try:
            _check_version(node, graph, topic, message_type)
            # Subscribers that ask for more are no error yet: this may have to stop a robot that is discovered later.
            self._is_matched()
        except LinkError:
            self.close()
            raise

    def publish(self, message: Message) -> None:
        self._publisher.publish(as_message(self._cls, message))

    def reach(self) -> bool:
        is_matched = self._is_matched()
        unmet = self._unmet()
        if unmet is not None and not until(lambda: self._unmet() is None, _MATCHING):  # some adapt
            raise unmet
        # A subscriber that is cut off stays matched for seconds, and acknowledges nothing.
        # Once it counts as gone, no acknowledgement is missing any more.
        matched = self._publisher.get_subscription_count()
        is_taken = is_matched and self._is_taken(_ACKNOWLEDGING) is not False
        return is_taken and self._publisher.get_subscription_count() >= matched

    def _is_matched(self) -> bool:
        wanted = reachable(self._demands(), self._offered)
        return until(lambda: self._publisher.get_subscription_count() >= wanted, _MATCHING)

    def _demands(self, *, but_of: str | None = None) -> list[Policies]:
        there = self._graph.subscriptions(self._topic)
        return [policies_of(each.qos_profile) for each in there if _owner(each) != but_of]

    def _unmet(self) -> LinkError | None:
        return unmet_demand(self._topic, self._qos, self._demands(but_of=self._node.own_name))

    def is_heard(self) -> bool:
        return bool(self._publisher.get_subscription_count())

    def flush(self, seconds: float) -> None:
        # A process of Fast DDS may be matched here seconds before it discovers us; it receives the messages then.
        seconds = max(seconds, LONGEST_DISCOVERY)
        match self._is_taken(seconds):
            case None:
                time.sleep(min(seconds, _UNTOLD))
            case False:
                fix = "Check whether the robot is on and in this network."
                raise LinkError(f"a subscriber does not take it within {seconds:g} s", where=self._topic, fix=fix)

    def _is_taken(self, seconds: float) -> bool | None:
        """Whether all messages are acknowledged within that time; None where the middleware does not report it."""
        try:
            return bool(self._publisher.wait_for_all_acked(Duration(seconds=seconds)))
        except Exception as error:  # noqa: BLE001 - not every middleware reports it: what was published may well arrive
            _logger.info("%s: it is not known whether it was taken: %s", self._topic, error)
            return None

    def close(self) -> None:
        self._node.node.destroy_publisher(self._publisher)


class _Subscription:
    """Receives one topic as bytes; adapts its QoS to the publishers where no profile is requested."""

    def __init__(
        self,
        node: GraphNode,
        graph: Graph,
        topic: str,
        message_type: str,
        take: Callable[[bytes], None],
        qos: Qos | None,
    ) -> None:
        self._node = node
        self._graph = graph
        self._topic = topic
        self._cls = message_class(message_type)
        self._take = take
        self._lock = threading.Lock()
        self._is_open = True
        self._mismatch = ""
        # A publisher that is discovered later may be transient local, and this subscription would not request that.
        node.settle(lambda: graph.publishers(topic), _FINDING if qos is None else SETTLING)
        publishers = graph.publishers(topic)
        _check_types(topic, message_type, publishers)
        # Most publishers are reliable: where there is none yet, a reliable one is expected.
        offers = [policies_of(each.qos_profile) for each in publishers]
        self._asked = adapted(offers, alone=True) if qos is None else asked_by(qos)
        for each in publishers:
            self._check_offer(each)
        self._is_adapting = qos is None
        with self._lock:  # an incompatible publisher may be reported while it is made, and replaces it
            self._subscription = self._created(self._asked)
        try:
            _check_version(node, graph, topic, message_type)
        except LinkError:
            self.close()
            raise

    def explain(self) -> str:
        if self._mismatch:
            return self._mismatch
        if publishers := self._graph.publishers(self._topic):
            return silent_publishers(each.node_name for each in publishers)
        return nobody_publishes(self._topic, self._graph.topics())

    def close(self) -> None:
        with self._lock:
            self._is_open = False
            self._node.node.destroy_subscription(self._subscription)

    def _created(self, asked: Policies) -> Any:
        events = SubscriptionEventCallbacks(incompatible_qos=self._note_mismatch)
        return self._node.node.create_subscription(
            self._cls, self._topic, self._take, _as_profile(asked), event_callbacks=events, raw=True
        )

    def _note_mismatch(self, event: Any) -> None:
        del event
        if self._is_adapting:
            self._node.later(self._weaken)
            return
        for each in self._graph.publishers(self._topic):
            self._mismatch = self._asked.shortfall(policies_of(each.qos_profile)) or self._mismatch

    def _weaken(self) -> None:
        """Request less, so that the newly discovered publisher is compatible, too."""
        with self._lock:
            if self._is_open and self._is_adapting:
                self._is_adapting = False  # every publisher satisfies the weakest
                former, self._subscription = self._subscription, self._created(WEAKEST)
                self._node.node.destroy_subscription(former)

    def _check_offer(self, publisher: Any) -> None:
        if (less := self._asked.shortfall(policies_of(publisher.qos_profile))) is not None:
            problem = f"the publisher {_owner(publisher)} offers less than is asked for: {less}"
            fix = "Leave qos out, so that the subscription fits its publishers."
            raise LinkError(problem, where=self._topic, fix=fix)


class _Client:
    def __init__(self, node: GraphNode, graph: Graph, service: str, service_type: str) -> None:
        self._node = node
        self._graph = graph
        self._service = service
        self._type = service_type
        self._cls = service_class(service_type)
        self._check_type()  # Fast DDS makes no client if this process offers the service with another type
        self._client = node.node.create_client(self._cls, service)

    def call(self, request: Message, timeout: float) -> Message:
        deadline = time.monotonic() + timeout
        self._find(min(timeout, LONGEST_DISCOVERY))
        answered = threading.Event()
        future = self._client.call_async(as_message(self._cls.Request, request))
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(deadline - time.monotonic(), 0.0)):
            self._client.remove_pending_request(future)
            raise service_timeout(self._service, timeout)
        return as_mapping(future.result())

    def _find(self, seconds: float) -> None:
        if until(self._client.service_is_ready, seconds):
            return
        self._check_type()
        fix = "Start the node that offers it."
        raise missing("service", self._service, self._graph.services(), where="ros2", fix=fix)

    def _check_type(self) -> None:
        true = self._graph.service_type(self._service)
        if true is not None and true != self._type:
            raise wrong_service_type(self._service, true, self._type)


def _check_types(topic: str, wanted: str, endpoints: Sequence[Any]) -> None:
    for each in endpoints:
        check_type(topic, wanted, [each.topic_type], owner=_owner(each))


def _check_version(node: GraphNode, graph: Graph, topic: str, message_type: str) -> None:
    """Refuse a topic of which this node has an endpoint, and another one has another version of the type.

    ROS 2 connects them, and values would be taken for others of the same bytes. Before Iron, versions are not known.
    """

    def told(*, own: bool) -> dict[str, str]:
        endpoints = [*graph.publishers(topic), *graph.subscriptions(topic)]
        hashes = {
            str(getattr(each, "topic_type_hash", _UNKNOWN)): _owner(each)
            for each in endpoints
            if (_owner(each) == node.own_name) is own
        }
        return {digest: owner for digest, owner in hashes.items() if digest != _UNKNOWN}

    others = told(own=False)
    if not others or is_action_part(message_type):
        return
    until(lambda: told(own=True), _FINDING_OWN)
    ours = told(own=True)
    for owner in (owner for digest, owner in others.items() if ours and digest not in ours):
        problem = f"{owner} has another version of {message_type} than the one that is known here"
        fix = "Build the package of that type on both computers from the same source, and source that workspace."
        raise LinkError(problem, where=topic, fix=fix)


def _owner(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _as_profile(policies: Policies) -> QoSProfile:
    history: dict[str, Any] = {"history": HistoryPolicy.KEEP_LAST if policies.depth else HistoryPolicy.KEEP_ALL}
    if policies.depth:
        history["depth"] = policies.depth
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if policies.is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if policies.is_kept else DurabilityPolicy.VOLATILE,
        **history,
    )
