"""Services as rmw_cyclonedds carries them: a topic for requests, one for replies, both led in by a header."""

from __future__ import annotations

import itertools
import logging
import struct
import threading
import time
from typing import TYPE_CHECKING, Any

from cyclonedds.core import DDSException
from cyclonedds.qos import Policy

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding
from robot_runner.ros.dds_graph import (
    matched_publications,
    matched_subscriptions,
    reply_topic,
    request_topic,
    ros_service_type,
)
from robot_runner.ros.dds_qos import service_profile
from robot_runner.ros.dds_reception import HEADER_BYTES, READING_QOS, delete, service_wire_type
from robot_runner.ros.graph_links import missing
from robot_runner.ros.graph_transport import already_offered, service_timeout, wrong_service_type

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclonedds.qos import Qos as DdsQos

    from robot_runner.core.links.robot import Message
    from robot_runner.ros.dds_reception import RawSample
    from robot_runner.ros.dds_session import Session
    from robot_runner.ros.shapes import Shape

__all__ = ["OfferedService", "ServiceClient", "foreign_service"]

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
        """Return the bytes of a request or reply; a header of 16 bytes leaves what follows aligned as it is."""
        body = self.session.types.serialise(shape.type_name, message, Encoding.CDR)
        return body[:HEADER_BYTES] + header + body[HEADER_BYTES:]

    def unpack(self, shape: Shape, data: bytes) -> dict[str, Any]:
        """Return the request or reply that follows the header."""
        body = data[:HEADER_BYTES] + data[_BODY:]
        return self.session.types.deserialise(shape.type_name, body, Encoding.CDR)

    def user_data(self, role: str, shape: Shape) -> str:
        """Return what an endpoint says of itself: which client or service it belongs to, and the hash of its type."""
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
        session.settle(lambda: bool(session.graph.readers(side.request_topic)))
        self._check_type()
        identity = side.user_data("clientid", side.request)
        self._reader = session.reader(side.reply_topic, reply_type, service_profile(identity))
        self._source = session.reception.add(self._reader, self._take, service)
        self._writer = session.writer(side.request_topic, request_type, service_profile(identity))
        self._request_type = request_type
        self._guid = self._writer.get_instance_handle() & _UINT64  # cyclonedds reads it as signed

    def call(self, request: Message, timeout: float) -> dict[str, Any]:
        """Send a request and return the response to it."""
        deadline = time.monotonic() + timeout
        number = next(self._sequence)
        data = self._side.pack(self._side.request, _HEADER.pack(self._guid, number), request)
        self._await_service(timeout)
        self._answers[number] = None
        try:
            self._writer.write(self._request_type(data))
            self._side.session.reception.wait_for(
                lambda: self._answers[number] is not None, max(0.0, deadline - time.monotonic())
            )
        except DDSException as error:
            raise LinkError(
                f"the request cannot be sent: {error}", where=self._side.service, fix="Try again."
            ) from error
        finally:
            answer = self._answers.pop(number)
        if answer is None:
            raise service_timeout(self._side.service, timeout)
        return self._side.unpack(self._side.response, answer)

    def _await_service(self, timeout: float) -> None:
        def is_there() -> bool:
            return bool(matched_subscriptions(self._writer) and matched_publications(self._reader))

        if not self._side.session.graph.wait_for(is_there, timeout):
            self._check_type()
            raise self._missing()
        # Such a service would take the header of our request for its fields: a false for a true, and no answer.
        foreign = foreign_service(self._side.session, self._side.service)
        if foreign is not None:
            raise foreign

    def _missing(self) -> LinkError:
        session = self._side.session
        fix = session.loneliness() if session.is_alone() else "Start the node that offers it."
        return missing("service", self._side.service, session.graph.services(), where="dds", fix=fix)

    def _check_type(self) -> None:
        _check_service_type(self._side, self._service_type)

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
        session.settle(lambda: bool(session.graph.readers(side.request_topic)))
        if session.graph.readers(side.request_topic):
            raise already_offered(service)
        identity = side.user_data("serviceid", side.response)
        self._reply_type = service_wire_type(side.response)
        self._writer = session.writer(side.reply_topic, self._reply_type, service_profile(identity))
        reader = session.reader(side.request_topic, service_wire_type(side.request), service_profile(identity))
        self._source = session.reception.add(reader, self._take, service)

    def close(self) -> None:
        """Offer it no more."""
        for endpoint in (self._writer, self._source.reader):
            self._side.session.nodes.remove(endpoint.guid)
        self._side.session.reception.remove(self._source)
        delete(self._writer)

    def _take(self, sample: RawSample) -> None:
        if sample.sample_info.valid_data and len(sample.data) >= _BODY:
            # An answer may take its time, and may subscribe or call meanwhile.
            with READING_QOS:
                client = self._source.reader.get_matched_publication_data(sample.sample_info.publication_handle)
            identity = _client_id(client.qos) if client is not None else None
            threading.Thread(target=self._reply, args=(sample.data, identity), daemon=True).start()

    def _reply(self, data: bytes, client: str | None) -> None:
        side = self._side
        try:
            response = self._answer(side.unpack(side.request, data))
            reply = side.pack(side.response, data[HEADER_BYTES:_BODY], response)
        except Exception as fault:  # noqa: BLE001 - the link has logged it
            _logger.info("%s is not answered: ROS 2 cannot tell a client that it failed (%s)", side.service, fault)
            return
        # A reply that is written before the client's reader is discovered is lost to it.
        side.session.graph.wait_for(lambda: not self._source.is_open or self._is_matched(client), _REPLY_SECONDS)
        if self._source.is_open:
            self._writer.write(self._reply_type(reply))

    def _is_matched(self, client: str | None) -> bool:
        handles = matched_subscriptions(self._writer)
        if client is None:
            return bool(handles)
        with READING_QOS:
            readers = [self._writer.get_matched_subscription_data(handle) for handle in handles]
        return any(reader is not None and _client_id(reader.qos) == client for reader in readers)


def foreign_service(session: Session, service: str) -> LinkError | None:
    """Return why a service cannot be called; None where it can, or where there is none.

    rmw_cyclonedds tells the identity of a service with its endpoints. rmw_fastrtps and rmw_connextdds carry that of a
    request beside it (related_sample_identity of DDS-RPC), which cyclonedds can neither write nor read.
    """
    readers = session.graph.readers(request_topic(service))
    if not readers or any("serviceid=" in reader.user_data for reader in readers):
        return None
    return LinkError(
        "the service is not offered through rmw_cyclonedds_cpp, and services do not cross middlewares",
        where=service,
        fix="Start its node with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or reach the robot by a rosbridge: "
        "docs/your-humble-robot.md.",
    )


def _client_id(qos: DdsQos) -> str | None:
    data = qos[Policy.Userdata].data if Policy.Userdata in qos else b""
    entries = dict(entry.partition("=")[::2] for entry in data.decode(errors="replace").split(";"))
    return entries.get("clientid")


def _check_service_type(side: _Side, service_type: str) -> None:
    for reader in side.session.graph.readers(side.request_topic):
        offered = ros_service_type(reader.type_name)
        if f"{offered}_Request" != side.request.type_name:
            raise wrong_service_type(side.service, offered, service_type)
