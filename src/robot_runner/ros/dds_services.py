"""Services as in rmw_cyclonedds: a topic for requests and one for replies, each with a header before the message.

Those of other middlewares are in `dds_foreign_services`.
"""

from __future__ import annotations

import itertools
import logging
import struct
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from cyclonedds.core import DDSException
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos

from robot_runner.core.errors import LinkError
from robot_runner.core.links.graph_names import missing
from robot_runner.core.links.robot import Encoding, Message
from robot_runner.ros.dds_graph import (
    matched_publications,
    matched_subscriptions,
    reply_topic,
    request_topic,
    ros_service_type,
)
from robot_runner.ros.dds_qos import service_profile
from robot_runner.ros.dds_reception import HEADER_BYTES, READING_QOS, RawSample, Source, delete, service_wire_type
from robot_runner.ros.graph_transport import already_offered, wrong_service_type

if TYPE_CHECKING:
    from robot_runner.ros.dds_session import Session
    from robot_runner.ros.shapes import Shape

_logger = logging.getLogger(__name__)

#: The client (rmw_cyclonedds: the instance handle of its writer), and the number of its request.
_HEADER = struct.Struct("<Qq")

_BODY = HEADER_BYTES + _HEADER.size
_UINT64 = 2**64 - 1

#: How long a reply waits for the client's reader to be discovered, s; rmw_cyclonedds waits as long.
_REPLY_SECONDS = 0.1

_numbers = itertools.count(1)


class _Side:
    """The two topics of a service, seen from one side of it."""

    def __init__(self, session: Session, service: str, service_type: str) -> None:
        self.session = session
        self.service = service
        self.request: Shape = session.types.request(service_type)
        self.response: Shape = session.types.response(service_type)
        self.request_topic = request_topic(service)
        self.reply_topic = reply_topic(service)

    def pack(self, shape: Shape, header: bytes, message: Message) -> bytes:
        """Return the bytes of a request or reply; the header of 16 bytes does not change the message's alignment."""
        body = self.session.types.serialise(shape.type_name, message, Encoding.CDR)
        return body[:HEADER_BYTES] + header + body[HEADER_BYTES:]

    def unpack(self, shape: Shape, data: bytes) -> dict[str, Any]:
        body = data[:HEADER_BYTES] + data[_BODY:]
        return self.session.types.deserialise(shape.type_name, body, Encoding.CDR)

    def user_data(self, role: str, shape: Shape) -> str:
        """Return the user data of an endpoint: its client or service, and the hash of its type."""
        identity = self.session.guid.bytes[:12] + next(_numbers).to_bytes(4, "big")
        return f"{role}={'.'.join(f'{octet:x}' for octet in identity)};{self.session.type_hash(shape.type_name)}"


class ServiceClient:
    """The client of one service."""

    def __init__(self, session: Session, service: str, service_type: str) -> None:
        self._side = side = _Side(session, service, service_type)
        self._service_type = service_type
        self._answers: dict[int, bytes | None] = {}
        self._sequence = itertools.count(1)
        request_type, reply_type = service_wire_type(side.request), service_wire_type(side.response)
        identity = side.user_data("clientid", side.request)
        self._reader = session.reader(side.reply_topic, reply_type, service_profile(identity))
        self._writer = session.writer(side.request_topic, request_type, service_profile(identity))
        self._request_type = request_type
        self._guid = self._writer.get_instance_handle() & _UINT64  # cyclonedds reads it as signed
        # Last, as from now on replies arrive, also those to other clients.
        self._source = session.reception.add(self._reader, self._take, service)

    def call(self, request: Message, deadline: float) -> dict[str, Any] | None:
        """Send a request and return the response to it; None if none came by the deadline."""
        number = next(self._sequence)
        data = self._side.pack(self._side.request, _HEADER.pack(self._guid, number), request)
        if not self._is_matched(deadline):
            return None
        self._answers[number] = None
        try:
            self._writer.write(self._request_type(data))
            left = max(0.0, deadline - time.monotonic())
            self._side.session.reception.wait_for(lambda: self._answers[number] is not None, left)
        except DDSException as error:
            fix = "Try again."
            raise LinkError(f"the request cannot be sent: {error}", where=self._side.service, fix=fix) from error
        finally:
            answer = self._answers.pop(number)
        return None if answer is None else self._side.unpack(self._side.response, answer)

    def _is_matched(self, deadline: float) -> bool:
        """Return whether the service's endpoints are matched by the deadline; raise a `LinkError` if it is gone."""

        def is_there() -> bool:
            return bool(matched_subscriptions(self._writer) and matched_publications(self._reader))

        session = self._side.session
        if session.graph.wait_for(is_there, max(0.0, deadline - time.monotonic())):
            return True
        await_service(session, self._side.service, self._service_type, deadline)
        return False

    def _take(self, sample: RawSample) -> None:
        if sample.sample_info.valid_data and len(sample.data) >= _BODY:
            guid, number = _HEADER.unpack_from(sample.data, HEADER_BYTES)
            if guid == self._guid and number in self._answers:
                self._answers[number] = sample.data


class OfferedService:
    """A service that this link offers. Each request is answered in a thread of its own."""

    def __init__(self, session: Session, service: str, service_type: str, answer: Callable[[Message], Message]) -> None:
        self._side = side = _Side(session, service, service_type)
        self._answer = answer
        self._has_refused = False
        session.settle(lambda: bool(session.graph.readers(side.request_topic)))
        if session.graph.readers(side.request_topic):
            raise already_offered(service)
        identity = side.user_data("serviceid", side.response)
        self._reply_type = service_wire_type(side.response)
        self._writer = session.writer(side.reply_topic, self._reply_type, service_profile(identity))
        reader = session.reader(side.request_topic, service_wire_type(side.request), service_profile(identity))
        self._source = Source(reader, self._take, service)  # set before the first request, whose reply needs it
        session.reception.serve(self._source)

    def close(self) -> None:
        """Withdraw the service."""
        for endpoint in (self._writer, self._source.reader):
            self._side.session.nodes.remove(endpoint.guid)
        self._side.session.reception.remove(self._source)
        delete(self._writer)

    def _take(self, sample: RawSample) -> None:
        if sample.sample_info.valid_data and len(sample.data) >= _BODY:
            # In a thread: an answer may take a while, and may subscribe or call meanwhile.
            with READING_QOS:
                client = self._source.reader.get_matched_publication_data(sample.sample_info.publication_handle)
            identity = _client_id(client.qos) if client is not None else None
            if client is not None and identity is None:
                self._refuse()
                return
            threading.Thread(target=self._reply, args=(sample.data, identity), daemon=True).start()

    def _refuse(self) -> None:
        """Ignore a request without a header, as its fields would be read as one, and log that."""
        if not self._has_refused:
            self._has_refused = True
            _logger.warning(
                "%s is asked by a node of another middleware than rmw_cyclonedds_cpp, which cannot be answered from"
                " here: start that node with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp",
                self._side.service,
            )

    def _reply(self, data: bytes, client: str | None) -> None:
        side = self._side
        try:
            response = self._answer(side.unpack(side.request, data))
            reply = side.pack(side.response, data[HEADER_BYTES:_BODY], response)
        except Exception as fault:  # noqa: BLE001 - the link has logged it
            _logger.info("%s is not answered: ROS 2 cannot tell a client that it failed (%s)", side.service, fault)
            return
        try:
            # A reply that is written before the client's reader is discovered does not reach it.
            side.session.graph.wait_for(lambda: not self._source.is_open or self._is_matched(client), _REPLY_SECONDS)
            if self._source.is_open:
                self._writer.write(self._reply_type(reply))
        except DDSException:
            if self._source.is_open and not side.session.is_closed:  # else the writer was closed meanwhile
                raise

    def _is_matched(self, client: str | None) -> bool:
        handles = matched_subscriptions(self._writer)
        if client is None:
            return bool(handles)
        with READING_QOS:
            readers = [self._writer.get_matched_subscription_data(handle) for handle in handles]
        return any(reader is not None and _client_id(reader.qos) == client for reader in readers)


def is_foreign(session: Session, service: str) -> bool:
    """Whether an existing service is offered through another middleware.

    rmw_cyclonedds announces the identity of a service with its endpoints; rmw_fastrtps and rmw_connextdds do not.
    """
    readers = session.graph.readers(request_topic(service))
    return bool(readers) and not any("serviceid=" in reader.user_data for reader in readers)


def await_service(session: Session, service: str, service_type: str, deadline: float) -> None:
    """Wait until a service is offered; raise a `LinkError` if it is not by the deadline, or has another type."""
    wire = request_topic(service)

    def is_there() -> bool:
        return bool(session.graph.readers(wire))

    if not session.settle(is_there) and not session.graph.wait_for(is_there, max(0.0, deadline - time.monotonic())):
        fix = session.loneliness() if session.is_alone() else "Start the node that offers it."
        raise missing("service", service, session.graph.services(), where="dds", fix=fix)
    asked = session.types.request(service_type).type_name
    for reader in session.graph.readers(wire):
        offered = ros_service_type(reader.type_name)
        if f"{offered}_Request" != asked:
            raise wrong_service_type(service, offered, service_type)


def _client_id(qos: DdsQos) -> str | None:
    data = qos[Policy.Userdata].data if Policy.Userdata in qos else b""
    entries = dict(entry.partition("=")[::2] for entry in data.decode(errors="replace").split(";"))
    return entries.get("clientid")
