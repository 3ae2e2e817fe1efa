"""Topics over rclpy: a publisher whose listeners are reached, and a subscription that fits its publishers."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from robot_runner.core.errors import LinkError, nearest
from robot_runner.core.links.robot import Qos, RawMessage
from robot_runner.ros.listening import guarded
from robot_runner.ros.ros2.message_types import as_mapping, as_message, message_class, shape_of
from robot_runner.ros.ros2.node import check_type
from robot_runner.ros.shapes import completed, plain_type

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.core.links.robot import Message
    from robot_runner.ros.ros2.node import Graph, GraphNode

__all__ = [
    "TopicPublisher",
    "TopicSubscription",
    "adapted",
    "incompatibility",
    "reader_profile",
    "weakest",
    "writer_profile",
]


# The QoS profiles of ROS 2 as rclpy has them, and what of a publisher's offer does not satisfy them.

#: How much of a topic is kept while the callbacks are behind, where the user names no profile: a second of 1 kHz.
_KEPT = 1000
# rmw/qos_profiles.h of ROS 2, for the depths; 0 is as many as come.
_DEPTHS = {Qos.DEFAULT: 10, Qos.SENSOR_DATA: 5, Qos.RELIABLE: 0, Qos.TRANSIENT_LOCAL: 1}


def writer_profile(qos: Qos) -> QoSProfile:
    """Return a profile of ROS for a publisher."""
    return _profile(_DEPTHS[qos], is_reliable=qos is not Qos.SENSOR_DATA, is_kept=qos is Qos.TRANSIENT_LOCAL)


def reader_profile(qos: Qos) -> QoSProfile:
    """Return a profile of ROS for a subscription."""
    # The last message of each publisher: the depth of a reader is that of them all.
    depth = _KEPT if qos is Qos.TRANSIENT_LOCAL else _DEPTHS[qos]
    return _profile(depth, is_reliable=qos is not Qos.SENSOR_DATA, is_kept=qos is Qos.TRANSIENT_LOCAL)


def adapted(offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return the profile of a subscription that all these publishers satisfy, as strong as they allow.

    Where there is none yet it is reliable, which is what most publishers are.
    """
    is_reliable = all(_is_reliable(offer) for offer in offers)
    is_kept = is_reliable and bool(offers) and all(_is_kept(offer) for offer in offers)
    return _profile(_KEPT, is_reliable=is_reliable, is_kept=is_kept)


def weakest() -> QoSProfile:
    """Return the profile of a subscription that every publisher satisfies."""
    return _profile(_KEPT, is_reliable=False, is_kept=False)


def incompatibility(asked: QoSProfile, offered: QoSProfile) -> str | None:
    """Say which policy of an offer is less than what is asked for, or return None if none is.

    The rules are those of DDS 1.4, 2.2.3, for the policies that the profiles of ROS set.
    """
    if _is_reliable(asked) and not _is_reliable(offered):
        return "reliability: it is published best effort, and heard reliable"
    if _is_kept(asked) and not _is_kept(offered):
        return "durability: it is published volatile, and heard transient local"
    return None


def _profile(depth: int, *, is_reliable: bool, is_kept: bool) -> QoSProfile:
    history: dict[str, Any] = {"history": HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL}
    if depth:
        history["depth"] = depth
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_kept else DurabilityPolicy.VOLATILE,
        **history,
    )


def _is_reliable(profile: QoSProfile) -> bool:
    return bool(profile.reliability != ReliabilityPolicy.BEST_EFFORT)


def _is_kept(profile: QoSProfile) -> bool:
    return bool(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)


try:
    from rclpy.event_handler import SubscriptionEventCallbacks
except ModuleNotFoundError:  # Humble
    from rclpy.qos_event import SubscriptionEventCallbacks

#: How long a new publisher waits for those who hear the topic already, s.
_MATCHING = 1.0


class TopicPublisher:
    """A publisher of one topic.

    Args:
        node: to publish from.
        graph: of the node.
        name: full name of the topic.
        message_type: ROS name.
        qos: how messages are delivered.

    Raises:
        LinkError: there is no such type, or the topic carries another.
    """

    def __init__(self, node: GraphNode, graph: Graph, name: str, message_type: str, qos: Qos) -> None:
        self.name = name
        self.message_type = plain_type(message_type)
        self.qos = qos
        self._node = node
        self._cls = message_class(message_type)
        node.settle(lambda: graph.publishers(name) or graph.listeners(name))
        listeners = graph.listeners(name)
        check_type(name, message_type, [*graph.publishers(name), *listeners])
        profile = writer_profile(qos)
        reachable = sum(incompatibility(each.qos_profile, profile) is None for each in listeners)
        self._publisher = node.node.create_publisher(self._cls, name, profile)
        node.until(lambda: self._publisher.get_subscription_count() >= reachable, _MATCHING)

    def publish(self, message: Message) -> None:
        """Publish one message; raises a `LinkError` where it does not follow its definition."""
        complete = completed(shape_of(self._cls), message, where=self.name)
        self._publisher.publish(as_message(self._cls, complete))

    def flush(self, seconds: float) -> None:
        """Wait until all listeners have what was published, for so long at most."""
        self._publisher.wait_for_all_acked(Duration(seconds=seconds))

    def close(self) -> None:
        """Publish no more."""
        self._node.node.destroy_publisher(self._publisher)


class TopicSubscription:
    """A subscription of one topic's bytes; `callback` is called in the thread that calls back.

    Args:
        node: to hear at.
        graph: of the node.
        name: full name of the topic.
        message_type: ROS name.
        callback: called with the bytes of each message.
        qos: None for what fits the publishers, also those that come later.
        now_ns: the time that messages are stamped with.

    Raises:
        LinkError: there is no such type, the topic carries another, or its publishers offer less than `qos`.
    """

    def __init__(
        self,
        node: GraphNode,
        graph: Graph,
        name: str,
        message_type: str,
        callback: Callable[[RawMessage], None],
        *,
        qos: Qos | None,
        now_ns: Callable[[], int],
    ) -> None:
        self._node = node
        self._graph = graph
        self._name = name
        self._cls = message_class(message_type)
        self._callback = guarded(callback, name)
        self._now_ns = now_ns
        self._lock = threading.Lock()
        self._is_open = True
        self._mismatch = ""
        node.settle(lambda: graph.publishers(name))
        publishers = graph.publishers(name)
        check_type(name, message_type, publishers)
        profile = adapted([each.qos_profile for each in publishers]) if qos is None else reader_profile(qos)
        for each in publishers:
            self._check_offer(profile, each)
        self._is_adapting = qos is None
        self._profile = profile
        self._subscription = self._created(profile)

    @classmethod
    def of_messages(cls, message_type: str, callback: Callable[[Message], None]) -> Callable[[RawMessage], None]:
        """Return a callback for bytes of a callback for messages."""
        message = message_class(message_type)
        return lambda raw: callback(as_mapping(deserialize_message(raw.data, message)))

    def explain(self) -> str:
        """Say why nothing may have come."""
        if self._mismatch:
            return self._mismatch
        publishers = self._graph.publishers(self._name)
        if publishers:
            names = ", ".join(sorted({each.node_name for each in publishers}))
            return f"Look whether {names}, which publishes it, is alive and reachable from here."
        near = nearest(self._name, self._graph.topics().keys() - {self._name})
        return f"Nobody publishes {self._name!r}: " + (
            f"did you mean {near!r}?" if near else "start the node that does."
        )

    def close(self) -> None:
        """Hear no more; closing twice does nothing."""
        with self._lock:
            if not self._is_open:
                return
            self._is_open = False
            self._node.node.destroy_subscription(self._subscription)

    def _created(self, profile: Any) -> Any:
        events = SubscriptionEventCallbacks(incompatible_qos=self._hear_of_mismatch)
        return self._node.node.create_subscription(
            self._cls, self._name, self._hear, profile, event_callbacks=events, raw=True
        )

    def _hear(self, data: bytes) -> None:
        raw = RawMessage(bytes(data), self._now_ns())
        self._node.later(lambda: self._call_back(raw))

    def _call_back(self, raw: RawMessage) -> None:
        if self._is_open:
            self._callback(raw)

    def _hear_of_mismatch(self, event: Any) -> None:
        del event
        if self._is_adapting:
            self._node.later(self._weaken)
            return
        for each in self._graph.publishers(self._name):
            self._mismatch = incompatibility(self._profile, each.qos_profile) or self._mismatch

    def _weaken(self) -> None:
        """Take what the publisher that came now has to offer, too."""
        with self._lock:
            if self._is_open and self._is_adapting:
                self._is_adapting = False  # every publisher satisfies the weakest
                former, self._subscription = self._subscription, self._created(weakest())
                self._node.node.destroy_subscription(former)

    def _check_offer(self, profile: Any, publisher: Any) -> None:
        less = incompatibility(profile, publisher.qos_profile)
        if less is not None:
            who = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
            raise LinkError(
                f"its publisher {who} offers less than is asked for: {less}",
                where=self._name,
                fix="Leave qos out, so that the subscription fits its publishers.",
            )
