"""Services that are offered through other middlewares than Cyclone DDS: Fast DDS, above all, which ROS 2 comes with.

Requests and replies have no header there. A request is identified by its writer and its number, which each sample has,
and a reply has both in its inline QoS (`related_sample_identity`). A reader of Cyclone DDS does not give access to
them, but Cyclone DDS can capture the packets that it receives, and these contain them.
"""

from __future__ import annotations

import ctypes
import itertools
import logging
import os
import shutil
import tempfile
import threading
import time
from contextlib import ExitStack
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Message
from robot_runner.ros.dds_graph import LINK_QOS, matched_publications, matched_subscriptions, reply_topic, request_topic
from robot_runner.ros.dds_qos import service_profile
from robot_runner.ros.dds_reception import Reception, delete, service_wire_type
from robot_runner.ros.rtps_replies import RequestId, RtpsReplies, captured_messages

if TYPE_CHECKING:
    from robot_runner.ros.dds_session import Session
    from robot_runner.ros.shapes import Shape

_logger = logging.getLogger(__name__)

_CONFIGURATION = "CYCLONEDDS_URI"
#: Cyclone DDS has one configuration for each domain of a process: the captured domain is one of its own here, under a
#: number that no domain on the network can have, and has the robot's number in the network.
_numbers = itertools.count(1000)
_PREFIX_BYTES = 12
#: How long the server's writer may take to announce its samples to our reader, s, once the two are matched here.
_MEETING_SECONDS = 1.0
#: So many pairs of a writer and a reader are kept: a robot has some hundred, and any node in the network may add more.
_MOST_MET = 10_000
_POLL = 0.005
_END_SECONDS = 5.0


class PacketCapture:
    """A participant of a domain of which each packet is read that it receives.

    Cyclone DDS writes its capture through a buffer of the C library, which a thread of its own empties: where it cannot
    be told from other buffers (`_stream_of`), that waits for anybody who reads from the standard input through the
    library, and no deadline of a call may depend on it.

    Raises:
        LinkError: the domain cannot be joined once more.
    """

    def __init__(self, domain: int, replies: RtpsReplies) -> None:
        self._replies = replies
        self._library = ctypes.CDLL(None)
        self._library.fflush.argtypes = self._library.fileno.argtypes = [ctypes.c_void_p]
        self._asked = threading.Event()
        self._is_closed = False
        with ExitStack() as undoing:
            folder = Path(tempfile.mkdtemp(prefix="robot-runner-"))  # nobody else may look into it
            pipe = folder / "packets"
            try:
                os.mkfifo(pipe, 0o600)
                reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # else it waits until Cyclone DDS opens it
                capture = undoing.enter_context(os.fdopen(reading, "rb"))
                self._number = next(_numbers)
                self._domain = Domain(self._number, _capturing(domain, pipe))
                self._stream = _stream_of(self._library, reading)
                self.participant = DomainParticipant(self._number, qos=LINK_QOS)
                os.set_blocking(reading, True)
            except DDSException as error:
                problem = f"services of another middleware than Cyclone DDS cannot be called here: {error}"
                fix = "Reach the robot by a rosbridge: docs/your-humble-robot.md."
                raise LinkError(problem, where="robot", fix=fix) from error
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            undoing.pop_all()
        receiver = self.participant.guid.bytes[:_PREFIX_BYTES]
        self._reader = threading.Thread(target=self._read, args=(capture, receiver), name="dds packets", daemon=True)
        self._flusher = threading.Thread(target=self._flush, name="dds flush", daemon=True)
        self._flusher.start()
        self.flush()
        self._reader.start()

    def flush(self) -> None:
        """Have the packets read that came until now."""
        self._asked.set()

    def close(self) -> None:
        """Leave the domain."""
        self._is_closed = True
        self._asked.set()
        delete(self.participant)
        self._flusher.join(_END_SECONDS)
        if self._flusher.is_alive():  # it waits for a reader of the standard input, as closing the capture would
            _logger.warning("the packet capture of domain %s is left open", self._number)
            return
        delete(self._domain)  # closes the capture, at which its reader ends
        self._reader.join(_END_SECONDS)

    def _flush(self) -> None:
        while self._asked.wait() and not self._is_closed:
            self._asked.clear()
            self._library.fflush(self._stream)

    def _read(self, capture: Any, receiver: bytes) -> None:
        with capture:
            for message in captured_messages(capture):
                self._replies.read(message, receiver)


def _capturing(domain: int, pipe: Path) -> str:
    ours = (
        f"<CycloneDDS><Domain id='any'><Discovery><ExternalDomainId>{domain}</ExternalDomainId></Discovery>"
        f"<Tracing><PacketCaptureFile>{escape(str(pipe))}</PacketCaptureFile></Tracing></Domain></CycloneDDS>"
    )
    return ",".join(filter(None, (os.environ.get(_CONFIGURATION), ours)))


def _stream_of(library: Any, pipe: int) -> int | None:
    """Return the C library's stream that writes to a pipe which was just opened; None where that cannot be told.

    In glibc the streams are a list, with the latest at its head.
    """
    try:
        latest = ctypes.c_void_p.in_dll(library, "_IO_list_all").value
    except ValueError:  # another C library
        return None
    same = latest and os.path.sameopenfile(library.fileno(latest), pipe)
    return latest if same else None


class _Sample(ctypes.Structure):
    """A sample as cyclonedds hands it to its C library: its bytes, and how many."""

    _fields_ = (("data", ctypes.c_char_p), ("size", ctypes.c_size_t))


class _CapturedWriter(DataWriter[Any]):
    """A writer whose packets are captured.

    The writer of cyclonedds blocks all threads of Python while it writes: the capture could not be read, and a
    request that fills the pipe would never be written.
    """

    def write_bytes(self, data: bytes) -> None:
        """Write a sample, given as its bytes; raise a `DDSException` if it cannot be written."""
        whole = data.ljust(-(-len(data) // 4) * 4, b"\0")
        write = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p)(("dds_write", self._dll_handle))
        code = write(self._ref, ctypes.byref(_Sample(whole, len(whole))))
        if code < 0:
            raise DDSException(code, f"Occurred while writing sample in {self!r}")


class ForeignServices:
    """The clients of a link for services of other middlewares; nothing is joined or captured before the first."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._clients: dict[tuple[str, str], _Client] = {}
        self._capture: PacketCapture | None = None
        self._reception: Reception | None = None
        self._answers: dict[RequestId, bytes | None] = {}
        self._met: set[tuple[bytes, bytes]] = set()

    def call(self, service: str, service_type: str, request: Message, deadline: float) -> Message | None:
        """Call a service that is there, and return its response; None if none came by the deadline."""
        with self._lock:
            client = self._client(service, service_type)
        if not self.wait_for(client.is_matched, deadline):
            return None
        # A reply that is written before the server knows of our reader is lost.
        self.wait_for(client.is_met, min(deadline, time.monotonic() + _MEETING_SECONDS))
        answer = client.ask(request, deadline)
        return None if answer is None else client.response_of(answer)

    def expect(self, request: RequestId) -> None:
        """Keep the reply to a request, when it comes."""
        self._answers[request] = None

    def forget(self, client: _Client, request: RequestId) -> None:
        """Take another client from now on, and wait for no reply to this request."""
        self._answers.pop(request, None)
        self._clients = {key: each for key, each in self._clients.items() if each is not client}

    def answer(self, request: RequestId, deadline: float) -> bytes | None:
        """Wait for the reply to a request, and return its bytes; None if none came by the deadline."""
        left = max(0.0, deadline - time.monotonic())
        self._session.reception.wait_for(lambda: self._answers[request] is not None, left)
        return self._answers.pop(request)

    def has_met(self, writer: bytes, reader: bytes) -> bool:
        """Whether a writer has announced to a reader what it has sent."""
        return (writer, reader) in self._met

    def wait_for(self, is_so: Any, deadline: float) -> bool:
        """Wait until `is_so` holds by polling: the captured domain has no event to wait for."""
        while not is_so():
            capture = self._capture
            if time.monotonic() > deadline or capture is None:
                return False
            capture.flush()
            time.sleep(_POLL)
        return True

    def close(self) -> None:
        """Leave the captured domain."""
        with self._lock:
            capture, self._capture = self._capture, None
            if self._reception is not None:
                self._reception.close()
            if capture is not None:
                capture.close()

    def _client(self, service: str, service_type: str) -> _Client:
        key = service, service_type
        if key not in self._clients:
            capture, reception = self._joined()
            self._clients[key] = _Client(self, self._session, capture, service, service_type)
            # A reply has been captured by the time a reader has it, all of its pieces.
            reception.add(self._clients[key].reader, lambda _: capture.flush(), service)
        return self._clients[key]

    def _joined(self) -> tuple[PacketCapture, Reception]:
        if self._capture is None or self._reception is None:
            replies = RtpsReplies(self._is_awaited, self._take, self._meet)
            self._capture = PacketCapture(self._session.domain, replies)
            self._session.own(self._capture.participant)
            self._reception = Reception(self._capture.participant)
            self._reception.start()
        return self._capture, self._reception

    def _is_awaited(self, request: RequestId) -> bool:
        return self._answers.get(request, b"") is None

    def _meet(self, writer: bytes, reader: bytes) -> None:
        if len(self._met) < _MOST_MET:
            self._met.add((writer, reader))

    def _take(self, request: RequestId, data: bytes) -> None:
        if request in self._answers:
            self._answers[request] = data
            self._session.reception.wake()


class _Client:
    def __init__(
        self, services: ForeignServices, session: Session, capture: PacketCapture, service: str, service_type: str
    ) -> None:
        self._services = services
        self._session = session
        self._service = service
        self._lock = threading.Lock()
        self._sent = 0
        self._request: Shape = session.types.request(service_type)
        self._response: Shape = session.types.response(service_type)
        participant, qos = capture.participant, service_profile("")
        wire_type = partial(service_wire_type, has_header=False)
        replies: Topic[Any] = Topic(participant, reply_topic(service), wire_type(self._response))
        requests: Topic[Any] = Topic(participant, request_topic(service), wire_type(self._request))
        self.reader: DataReader[Any] = DataReader(participant, replies, qos)
        self._writer = _CapturedWriter(participant, requests, qos)
        self._guid = self._writer.guid.bytes

    def is_matched(self) -> bool:
        return bool(matched_subscriptions(self._writer) and matched_publications(self.reader))

    def is_met(self) -> bool:
        own = self.reader.guid.bytes
        servers = self._session.graph.writers(reply_topic(self._service))
        return any(self._services.has_met(server.key.bytes, own) for server in servers)

    def ask(self, request: Message, deadline: float) -> bytes | None:
        """Send a request, and return the bytes of the reply to it; None if none came by the deadline."""
        data = self._session.types.serialise(self._request.type_name, request, Encoding.CDR)
        with self._lock:  # the numbers of requests are counted by the writer, each time that it writes
            self._sent += 1
            identity = RequestId(self._guid, self._sent)
            self._services.expect(identity)
            try:
                self._writer.write_bytes(data)
            except DDSException as error:
                self._services.forget(self, identity)  # whether the writer has counted it is not known
                problem = f"the request cannot be sent: {error}"
                raise LinkError(problem, where=self._service, fix="Try again.") from error
        return self._services.answer(identity, deadline)

    def response_of(self, data: bytes) -> dict[str, Any]:
        return self._session.types.deserialise(self._response.type_name, data, Encoding.CDR)
