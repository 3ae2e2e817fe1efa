"""What is published and heard on the topics of a graph."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

from cyclonedds.core import DDSException
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Qos, RawMessage
from robot_runner.ros.dds.graph import matched_subscriptions, wire_topic
from robot_runner.ros.dds.reception import delete, topic_wire_type
from robot_runner.ros.shapes import completed, plain_type

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.core.links.robot import Message
    from robot_runner.ros.dds.graph import Endpoint
    from robot_runner.ros.dds.reception import RawSample
    from robot_runner.ros.dds.session import Session

__all__ = [
    "TopicSubscription",
    "TopicWriter",
    "adapted",
    "incompatibility",
    "reader_profile",
    "service_profile",
    "writer_profile",
]


# The QoS profiles of ROS as DDS policies, and what of a publisher's offer does not satisfy them.

#: A writer waits this long in ns for readers that do not keep up before it gives up, where nothing may be lost.
_MAX_BLOCKING_NS = 500_000_000

#: How much of a topic is kept while a callback runs, where the user names no profile: a second of 1 kHz.
_KEPT = 1000

#: XCDR1, the one encoding that all middlewares of ROS 2 speak.
_REPRESENTATION = Policy.DataRepresentation(use_cdrv0_representation=True)

_RELIABLE = Policy.Reliability.Reliable(_MAX_BLOCKING_NS)
_TRANSIENT_LOCAL = Policy.Durability.TransientLocal

# rmw/qos_profiles.h of ROS 2, for the depths.
_PROFILES: dict[Qos, tuple[Any, Any, Any]] = {
    Qos.DEFAULT: (_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10)),
    Qos.SENSOR_DATA: (Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5)),
    Qos.RELIABLE: (_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepAll),
    Qos.TRANSIENT_LOCAL: (_RELIABLE, _TRANSIENT_LOCAL, Policy.History.KeepLast(1)),
}


def writer_profile(qos: Qos, user_data: str = "") -> DdsQos:
    """Return a profile of ROS as policies of a writer."""
    return _policies(*_PROFILES[qos], user_data)


def reader_profile(qos: Qos, user_data: str = "") -> DdsQos:
    """Return a profile of ROS as policies of a reader."""
    reliability, durability, history = _PROFILES[qos]
    if qos is Qos.TRANSIENT_LOCAL:
        # The last message of each publisher: the depth of a reader is that of them all.
        history = Policy.History.KeepLast(_KEPT)
    return _policies(reliability, durability, history, user_data)


def service_profile(user_data: str) -> DdsQos:
    """Return the policies of services: nothing is lost, and nothing is kept for who comes later."""
    return writer_profile(Qos.RELIABLE, user_data)


def adapted(offers: Sequence[DdsQos], user_data: str = "") -> DdsQos:
    """Return the policies of a reader that all of these publishers satisfy, as strong as they allow."""
    is_reliable = bool(offers) and all(_is_reliable(offer) for offer in offers)
    is_kept = is_reliable and all(_is_kept(offer) for offer in offers)
    reliability = _RELIABLE if is_reliable else Policy.Reliability.BestEffort
    durability = _TRANSIENT_LOCAL if is_kept else Policy.Durability.Volatile
    return _policies(reliability, durability, Policy.History.KeepLast(_KEPT), user_data)


def incompatibility(asked: DdsQos, offered: DdsQos) -> str | None:
    """Say which policy of an offer is less than what is asked for, or return None if none is.

    The rules are those of DDS 1.4, 2.2.3, for the policies that the profiles of ROS set, and for what else is offered.
    """
    if _is_reliable(asked) and not _is_reliable(offered):
        return "reliability: it is published best effort, and heard reliable"
    if _is_kept(asked) and not _is_kept(offered):
        return "durability: it is published volatile, and heard transient local"
    return None


def _policies(reliability: Any, durability: Any, history: Any, user_data: str) -> DdsQos:
    policies = [reliability, durability, history, _REPRESENTATION, Policy.WriterDataLifecycle(autodispose=False)]
    if durability is _TRANSIENT_LOCAL:
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    if user_data:
        policies.append(Policy.Userdata(user_data.encode()))
    return DdsQos(*policies)


def _is_reliable(qos: DdsQos) -> bool:
    return Policy.Reliability.BestEffort not in qos


def _is_kept(qos: DdsQos) -> bool:
    return any(each in qos for each in (_TRANSIENT_LOCAL, Policy.Durability.Transient, Policy.Durability.Persistent))


#: Before any stamp, in ns.
_NEVER = -(2**63)


class TopicWriter:
    """A publisher of one topic."""

    def __init__(self, session: Session, topic: str, message_type: str, qos: Qos) -> None:
        session.check_open(topic)
        self._session = session
        self._topic = topic
        self.message_type = plain_type(message_type)
        self.qos = qos
        self._shape = session.types.shape(message_type)
        self._wire_type = topic_wire_type(self._shape)
        wire = wire_topic(topic)
        session.check_type(wire, self._wire_type, topic)
        offered = writer_profile(qos, session.type_hash(message_type))
        self._writer = session.writer(wire, self._wire_type, offered)
        # A message that is published before its readers are discovered is lost to them.
        session.settle(lambda: bool(matched_subscriptions(self._writer)))
        session.check_type(wire, self._wire_type, topic)
        self._check_demands(wire, offered)

    def publish(self, message: Message) -> None:
        """Publish one message."""
        whole = completed(self._shape, message, where=self._topic)
        data = self._session.types.serialise(self._shape.type_name, whole, Encoding.CDR)
        try:
            self._writer.write(self._wire_type(data))
        except DDSException as error:
            raise LinkError(
                f"the message cannot be published: {error}",
                where=self._topic,
                fix="Publish more slowly, or with a QoS that may drop messages: a subscriber does not keep up.",
            ) from error

    def _check_demands(self, wire: str, offered: DdsQos) -> None:
        """Refuse what none of the subscribers takes, because all ask for more."""
        if matched_subscriptions(self._writer):
            return
        for reader in self._session.graph.readers(wire):
            less = incompatibility(reader.qos, offered)
            if less is not None:
                self.close()
                raise LinkError(
                    f"its subscriber asks for more than the QoS {str(self.qos)!r} offers: {less}",
                    where=self._topic,
                    fix="Publish with the QoS 'reliable' or 'transient_local'.",
                )

    def flush(self, timeout: float) -> None:
        """Wait until who hears it reliably has received what was published; `timeout` is in seconds."""
        # Where time runs out, cyclonedds 11.0 raises AttributeError: it looks for the code of that on a wrong class.
        with suppress(AttributeError, DDSException):
            self._writer.wait_for_acks(int(timeout * 1e9))

    def close(self) -> None:
        """Publish no more."""
        self._session.nodes.remove(self._writer.guid)
        delete(self._writer)


class TopicSubscription:
    """A subscriber of one topic, which adapts to its publishers where no profile is asked for."""

    def __init__(
        self,
        session: Session,
        topic: str,
        message_type: str,
        callback: Callable[[RawMessage], None],
        *,
        qos: Qos | None,
        now_ns: Callable[[], int],
    ) -> None:
        session.check_open(topic)
        self._session = session
        self._topic = topic
        self._wire_topic = wire_topic(topic)
        self._callback = callback
        self._now_ns = now_ns
        self._qos = qos
        # The stamps of the last sample of each publisher, and those after which a reader that took over has to begin.
        self._last: dict[int, int] = {}
        self._before: dict[int, int] = {}
        self._user_data = session.type_hash(message_type)
        self._wire_type = topic_wire_type(session.types.shape(message_type))
        session.settle(lambda: bool(session.graph.writers(self._wire_topic)))
        session.check_type(self._wire_topic, self._wire_type, topic)
        self._asked = self._policies()
        self._check_offers()
        self._source = self._open()

    @property
    def is_open(self) -> bool:
        """Whether it is heard."""
        return bool(self._source.is_open)

    def explain(self) -> str:
        """Say why nothing may be heard, for the error of who waited.

        Raises:
            LinkError: publishers that came later carry another type, or offer less than is asked for.
        """
        self._session.check_type(self._wire_topic, self._wire_type, self._topic)
        self._check_offers()
        if self._session.is_alone():
            return self._session.loneliness()
        if not self._session.graph.writers(self._wire_topic):
            return "Nobody publishes it: start the node that does."
        return ""

    def adapt(self, writer: Endpoint) -> None:
        """Ask for what the topic's publishers offer, now that there is another."""
        if self._qos is not None or writer.topic != self._wire_topic or not self._source.is_open:
            return
        asked = self._policies()
        if asked != self._asked:
            self._asked = asked
            fresh = self._open()
            self._session.reception.drain(self._source)
            self._before = dict(self._last)
            stale, self._source = self._source, fresh
            self._end(stale)

    def close(self) -> None:
        """Hear no more; closing twice does nothing."""
        if self._source.is_open:
            self._end(self._source)

    def _policies(self) -> DdsQos:
        if self._qos is not None:
            return reader_profile(self._qos, self._user_data)
        return adapted([writer.qos for writer in self._session.graph.writers(self._wire_topic)], self._user_data)

    def _check_offers(self) -> None:
        for writer in self._session.graph.writers(self._wire_topic):
            less = incompatibility(self._asked, writer.qos)
            if less is not None:
                raise LinkError(
                    f"its publisher offers less than the QoS {str(self._qos)!r} asks for: {less}",
                    where=self._topic,
                    fix="Leave the QoS out, so that it fits the publishers.",
                )

    def _open(self) -> Any:
        reader = self._session.reader(self._wire_topic, self._wire_type, self._asked)
        return self._session.reception.add(reader, self._hear, self._topic)

    def _end(self, source: Any) -> None:
        self._session.nodes.remove(source.reader.guid)
        self._session.reception.remove(source)

    def _hear(self, sample: RawSample) -> None:
        info = sample.sample_info
        if not info.valid_data or info.source_timestamp <= self._before.get(info.publication_handle, _NEVER):
            return
        self._last[info.publication_handle] = info.source_timestamp
        self._callback(RawMessage(sample.data, self._now_ns()))
