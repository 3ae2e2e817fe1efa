"""Topics and services over a rosbridge, with one subscription and one publisher a topic, shared by all users here."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.commanded_topics import VELOCITIES
from robot_runner.core.links.graph_names import missing
from robot_runner.core.links.robot import GraphEndpoint, Message, Qos, RawMessage
from robot_runner.ros.graph_transport import (
    ClosedBy,
    Lane,
    Reception,
    already_offered,
    check_type,
    is_hidden,
    wrong_service_type,
)
from robot_runner.ros.ros1_actions import GOAL_ID_TYPE, Ros1Actions
from robot_runner.ros.rosbridge_actions import RosbridgeActions
from robot_runner.ros.rosbridge_callers import Callers
from robot_runner.ros.rosbridge_frames import from_protocol, passes_as_cbor, to_protocol
from robot_runner.ros.rosbridge_session import Reply, Session
from robot_runner.ros.rosbridge_types import RobotTypes, Rosapi, RosapiParameters
from robot_runner.ros.shapes import completed

if TYPE_CHECKING:
    from robot_runner.ros.action_calls import ActionDialect
    from robot_runner.ros.graph_addresses import RosbridgeAddress
    from robot_runner.ros.shapes import Shape

_logger = logging.getLogger(__name__)

#: Bytes as the robot has them; a server that does not know this compression sends JSON.
RAW = "cbor-raw"
_RAW_FIELDS = frozenset({"bytes", "secs", "nsecs"})

#: A type that several nodes latch on one topic (`/tf_static`), and how many of its messages a late receiver gets; of
#: other types it gets the last one.
_TOGETHER, _MOST_TOGETHER = "tf2_msgs/TFMessage", 100
#: So many calls of services that are offered here are answered at a time, each in a thread.
_MOST_ANSWERING = 64

#: The types of which an empty message ends what was commanded: the motion, or all goals of an action of ROS 1.
_ENDING = {*VELOCITIES, GOAL_ID_TYPE}

#: How long a server's new publisher may take to be connected with the robot's nodes, s.
_CONNECTING = 1.0


class RosbridgeTransport:
    """The primitives of a graph link over a rosbridge, which runs on the robot, from a machine without ROS.

    A rosbridge adapts the QoS of its subscriptions to the publishers of a topic; of our QoS it supports only
    `TRANSIENT_LOCAL`, for publishing.

    Raises:
        LinkError: it cannot be reached, is not a rosbridge, or does not report its generation of ROS.
    """

    has_threads = True

    def __init__(self, address: RosbridgeAddress, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._lock = threading.RLock()
        self._topics: dict[str, _Topic] = {}
        self._publishers: dict[str, _Publisher] = {}
        self._answers: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {}
        self._answering = threading.BoundedSemaphore(_MOST_ANSWERING)
        self._session = Session(address)
        connect = partial(Session, address, self._session.barrier)
        self._callers = Callers(connect)
        try:
            self._rosapi = Rosapi(self._session, self._callers)
            self.types = RobotTypes(self._rosapi, address)
        except LinkError:
            self.close()
            raise
        self.encoding = self.types.encoding
        self.parameter_server = RosapiParameters(self._rosapi) if self.types.generation == 1 else None
        # Each raises a `LinkError` where rosapi does not run beside the server.
        self.topics, self.services, self.nodes = self._rosapi.topics, self._rosapi.services, self._rosapi.nodes
        self.actions: ActionDialect = (
            Ros1Actions(self)
            if self.types.generation == 1
            else RosbridgeActions(self, self._session, self._rosapi, connect)
        )
        self._session.on_message = self._take_message
        self._session.on_request = self._take_request
        self._session.stop_operations = self._stops

    def advertise(self, topic: str, message_type: str, qos: Qos) -> _Publisher:
        """Return the publisher of a topic, a new one where messages are to be latched and were not before."""
        self._session.check_open(topic)
        is_latched = qos is Qos.TRANSIENT_LOCAL
        with self._lock:
            known = self._publishers.get(topic)
            if known is not None and known.offers(message_type, is_latched=is_latched):
                return known
            self._session.command_zero_first()  # asking rosapi may take long
            check_type(topic, message_type, self._told_type(topic))
            if known is not None:
                known.close()
            fresh = _Publisher(self._session, topic, message_type, self.types, is_latched=is_latched)
            self._rosapi.confirm_publisher(topic, message_type)
            self._publishers[topic] = fresh
            return fresh

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, lane: Lane
    ) -> ClosedBy:
        """Call `receive` with each message, in the session's thread for callbacks, or in the one that is prompt."""
        self._session.check_open(topic)
        is_raw, is_prompt = lane is Lane.BYTES, lane is not Lane.CALLBACKS
        with self._lock:
            known = self._topics.get(topic)
            if known is None:
                known = self._subscribed(topic, message_type, receive, is_raw=is_raw, is_prompt=is_prompt)
            else:
                check_type(topic, message_type, [known.message_type])
                if (is_raw and known.compression != RAW) or (not is_raw and known.shape is None):
                    raise _one_form(topic, message_type)
                kept = known.join(receive, is_prompt=is_prompt)
                for each in kept if qos is Qos.TRANSIENT_LOCAL else ():
                    receive(each)
        return ClosedBy(lambda: self._unsubscribe(known, receive))

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service and return its response."""
        self._session.check_open(service)
        values = to_protocol(self.types.request(service_type), request)
        true = None if is_hidden(service) else self._rosapi.service_type(service)
        if true == "":
            raise self._missing(service)
        if true not in {None, service_type}:
            raise wrong_service_type(service, str(true), service_type)
        reply = self._called(service, values, timeout)
        if not reply.is_good:
            if "does not exist" in str(reply.values):
                raise self._missing(service)
            raise LinkError(f"the service failed: {reply.values}", where=service, fix="Look at the log of its node.")
        return from_protocol(self.types.response(service_type), reply.values or {}, where=service)

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> ClosedBy:
        """Offer a service; each request is answered in a thread of its own."""
        self._session.check_open(service)
        if service in self._answers or self._rosapi.service_type(service):
            raise already_offered(service)
        asked, answered = self.types.request(service_type), self.types.response(service_type)
        self._answers[service] = lambda request: to_protocol(
            answered, answer(from_protocol(asked, request, where=service))
        )
        wire_type = self.types.wire_name(service_type, "srv")
        try:
            self._session.request({"op": "advertise_service", "service": service, "type": wire_type}, where=service)
            self._rosapi.confirm_service(service, service_type)
        except LinkError:
            del self._answers[service]
            raise
        return ClosedBy(partial(self._withdraw, service))

    def publishers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the publishers of a topic; the server counts as one for all its clients."""
        return self._rosapi.endpoints("publishers", topic)

    def subscribers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the subscribers of a topic; otherwise as `publishers`."""
        return self._rosapi.endpoints("subscribers", topic)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait for an event; raises a `LinkError` as soon as the connection is lost."""
        self._session.wait(event, seconds)

    def close(self) -> None:
        """Close the connection; the server removes our publishers, subscriptions and services."""
        self._session.close()
        self._callers.close()

    def _called(self, service: str, values: Mapping[str, Any], timeout: float) -> Reply:
        """Call a service, in ROS 2 over a separate connection; in ROS 1 calls do not delay each other."""
        if self.types.generation == 1:
            return self._session.call(service, values, timeout=timeout, where=service)
        self._session.flush(where=service)  # what was sent before the call is to be dealt with before it
        return self._callers.call(service, values, timeout=timeout, where=service)

    def _stops(self) -> list[dict[str, Any]]:
        """Return the operations that command zero wherever velocities are published here, and cancel goals."""
        stops = self.actions.cancel_requests() if isinstance(self.actions, RosbridgeActions) else []
        for each in list(self._publishers.values()):
            with suppress(Exception):  # a failure at one robot must not affect the others
                stops += [each.stop()] if each.is_open and each.message_type in _ENDING else []
        return stops

    def _told_type(self, topic: str) -> list[str]:
        told = self._rosapi.topic_type(topic)
        return [] if told is None else [told]

    def _subscribed(
        self, name: str, message_type: str, receive: Callable[[Reception], None], *, is_raw: bool, is_prompt: bool
    ) -> _Topic:
        is_known = self.types.is_known_here(message_type)
        shape = None if is_raw and not is_known else self.types.shape(message_type)
        # A server's own CBOR fails at some arrays, in ROS 2 at more; and its JSON has neither NaN nor infinity.
        plain = "cbor" if self.types.generation == 1 and shape is not None and passes_as_cbor(shape) else "none"
        check_type(name, message_type, self._told_type(name))
        request_id = self._session.fresh_id("subscribe")
        most = _MOST_TOGETHER if message_type == _TOGETHER else 1
        kept = {form: deque[Reception](maxlen=most) for form in (False, True)}
        topic = _Topic(name, message_type, shape, RAW if is_known or is_raw else plain, request_id, kept)
        # Joins at once: latched messages come before the server has answered.
        topic.join(receive, is_prompt=is_prompt)
        self._topics[name] = topic
        operation = {"op": "subscribe", "id": request_id, "topic": name, "type": self.types.wire_name(message_type)}
        try:
            self._session.request({**operation, "compression": topic.compression}, where=name)
            if not is_hidden(name):
                self._rosapi.confirm_subscription(name, message_type)
        except BaseException:  # also a stop request: making the robot safe may subscribe to this topic again
            del self._topics[name]
            raise
        return topic

    def _unsubscribe(self, topic: _Topic, receive: Callable[[Reception], None]) -> None:
        with self._lock:
            topic.leave(receive)
            if not topic.receivers and self._topics.pop(topic.name, None) is not None and self._session.is_usable:
                self._session.send({"op": "unsubscribe", "id": topic.request_id, "topic": topic.name})

    def _withdraw(self, service: str) -> None:
        self._answers.pop(service, None)
        if self._session.is_usable:
            self._session.request({"op": "unadvertise_service", "service": service}, where=service)

    def _missing(self, service: str) -> LinkError:
        fix = "Start the node that offers it."
        return missing("service", service, self._rosapi.service_names(), where=service, fix=fix)

    def _take_message(self, name: str, message: Any) -> None:
        if (topic := self._topics.get(name)) is not None:
            reception = _Reception(self.types, topic, message, self._now_ns())
            for is_prompt in (True, False):
                self._session.later(partial(topic.hand_on, reception, is_prompt=is_prompt), is_prompt=is_prompt)

    def _take_request(self, operation: Mapping[str, Any]) -> None:
        if not self._answering.acquire(blocking=False):
            self._send_response(operation, {"values": "too many calls are being answered", "result": False})
            return
        # In another thread: a slow service must delay neither messages nor other services.
        threading.Thread(target=self._respond, args=(operation,), name="rosbridge service", daemon=True).start()

    def _respond(self, operation: Mapping[str, Any]) -> None:
        service = str(operation.get("service"))
        answer = self._answers.get(service)
        try:
            if answer is None:
                raise LinkError("the service is not offered any more", where=service, fix="Offer it again.")  # noqa: TRY301
            outcome = {"values": answer(operation.get("args") or {}), "result": True}
        except Exception as fault:  # noqa: BLE001 - the link has logged it; the client is told
            outcome = {"values": str(fault), "result": False}
        finally:
            self._answering.release()
        self._send_response(operation, outcome)

    def _send_response(self, operation: Mapping[str, Any], outcome: Mapping[str, Any]) -> None:
        service = str(operation.get("service"))
        if self._session.is_usable:
            try:
                self._session.send({"op": "service_response", "service": service, "id": operation.get("id"), **outcome})
            except LinkError as error:
                _logger.warning("the response of %s is lost: %s", service, error)


class _Publisher:
    """A topic that the server publishes for this link."""

    def __init__(self, session: Session, topic: str, message_type: str, types: RobotTypes, *, is_latched: bool) -> None:
        self.message_type = message_type
        self.is_latched = is_latched
        self._session = session
        self._topic = topic
        self._shape = types.shape(message_type)
        self._id: str | None = session.fresh_id("advertise")
        operation = {"op": "advertise", "id": self._id, "topic": topic, "type": types.wire_name(message_type)}
        session.request({**operation, "latch": is_latched}, where=topic)
        self._since = time.monotonic()

    @property
    def is_open(self) -> bool:
        return self._id is not None

    def offers(self, message_type: str, *, is_latched: bool) -> bool:
        """Whether messages of this type can be published by it, and latched where that is wanted."""
        return self.is_open and self.message_type == message_type and (self.is_latched or not is_latched)

    def publish(self, message: Message) -> None:
        self._session.send(self._operation(message))

    def stop(self) -> dict[str, Any]:
        """Return the operation that publishes a message without any field: zero, where it is a velocity."""
        return self._operation(completed(self._shape, {}, where=self._topic))

    def _operation(self, message: Message) -> dict[str, Any]:
        return {"op": "publish", "topic": self._topic, "msg": to_protocol(self._shape, message)}

    def reach(self) -> bool:
        """Whether the server has published the topic for so long that it is connected: it does not tell."""
        self._session.flush(where=self._topic)
        return time.monotonic() - self._since >= _CONNECTING

    def is_heard(self) -> bool:
        return True  # the server does not tell

    def flush(self, seconds: float) -> None:
        del seconds  # the session's own deadline: the server answers at once, or is gone
        self._session.flush(where=self._topic)

    def close(self) -> None:
        """Leave the topic; closing twice does nothing: the link may publish with several QoS, this is all of them."""
        advertised, self._id = self._id, None
        if advertised is not None and self._session.is_usable:
            self._session.send({"op": "unadvertise", "id": advertised, "topic": self._topic})


@dataclass(slots=True)
class _Topic:
    """A topic that the server sends here, and its receivers, each with whether it is prompt: it waits for no other."""

    name: str
    message_type: str
    shape: Shape | None
    compression: str
    request_id: str
    kept: Mapping[bool, deque[Reception]]
    receivers: list[tuple[Callable[[Reception], None], bool]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def join(self, receive: Callable[[Reception], None], *, is_prompt: bool) -> list[Reception]:
        """Add a receiver of later messages, and return the messages that are kept, which it does not get."""
        with self._lock:
            self.receivers.append((receive, is_prompt))
            return list(self.kept[is_prompt])

    def leave(self, receive: Callable[[Reception], None]) -> None:
        """Remove a receiver."""
        with self._lock:
            self.receivers = [each for each in self.receivers if each[0] is not receive]

    def hand_on(self, reception: Reception, *, is_prompt: bool) -> None:
        """Keep a message for later receivers of this kind, and pass it to the present ones."""
        with self._lock:
            self.kept[is_prompt].append(reception)
            receivers = [receive for receive, is_its_kind in self.receivers if is_its_kind is is_prompt]
        for receive in receivers:
            receive(reception)


class _Reception:
    """A received message, decoded or encoded once, and only if that form is requested."""

    def __init__(self, types: RobotTypes, topic: _Topic, message: Any, received_ns: int) -> None:
        self._types = types
        self._topic = topic
        self._message = message
        self._received_ns = received_ns
        is_raw = isinstance(message, dict) and message.keys() == _RAW_FIELDS and isinstance(message["bytes"], bytes)
        self._data: bytes | None = message["bytes"] if is_raw else None

    def message(self) -> Message:
        """Return the message as a mapping."""
        topic = self._topic
        if self._data is not None:
            return self._types.deserialise(topic.message_type, self._data)
        if topic.shape is None:
            raise _one_form(topic.name, topic.message_type)
        return from_protocol(topic.shape, self._message, where=topic.name)

    def raw(self) -> RawMessage:
        """Return the message as bytes."""
        if self._data is None:
            self._data = self._types.serialise(self._topic.message_type, self.message())
        return RawMessage(self._data, self._received_ns)


def _one_form(topic: str, message_type: str) -> LinkError:
    """Return the error that messages of a type unknown here cannot be received in both forms."""
    problem = f"messages of {message_type} can be received here as bytes or as messages, not as both"
    fix = "Give its definition: robot = 'rosbridge://robot:9090?types=path/to/its/package'."
    return LinkError(problem, where=topic, fix=fix)
