"""A connection to a rosbridge: it sends operations and waits for answers."""

from __future__ import annotations

import itertools
import logging
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.commanded_topics import topics_of_zero_first
from robot_runner.ros.graph_transport import link_closed, service_timeout
from robot_runner.ros.own_thread import OwnThread
from robot_runner.ros.rosbridge_frames import LARGEST_FRAME, FrameReader, as_json, connect, deliver_late, send_errors

if TYPE_CHECKING:
    from robot_runner.ros.graph_addresses import RosbridgeAddress

_logger = logging.getLogger(__name__)

#: The timeout for answers of the server itself, s.
ANSWER = 5.0
#: How long, s, the server may be silent before a ping, how long it may take to answer that, and how often the answer is
#: looked for.
_PING_INTERVAL, _PING_TIMEOUT, _PING_LOOK = 3.0, 5.0, 0.1
#: A service of the server's own node in each generation of ROS, as its launch file names it. A call of it shows that
#: the server has handled all earlier operations: it handles them in order, and answers every call, if only that there
#: is no such service. rosapi is a node of its own, and may hang although the server does not.
_OWN_SERVICES = ((1, "/rosbridge_websocket/get_loggers"), (2, "/rosbridge_websocket/list_parameters"))
_OTHERWISE = "/rosapi/get_time"

#: How much may wait for callbacks, messages and bytes; beyond that the connection fails with an error, as dropping
#: messages would falsify the results.
_MOST_WAITING = 20_000
_MOST_WAITING_BYTES = 4 * LARGEST_FRAME


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer of a service: whether it succeeded, and its response, or the error."""

    is_good: bool
    values: Any


@dataclass(slots=True)
class _Pending:
    event: threading.Event = field(default_factory=threading.Event)
    reply: Reply | None = None


class Session:
    """A connection, with a thread that receives, one for callbacks, and a prompt one for those that wait for none.

    Methods that send or wait raise a `LinkError` once the connection is lost.

    Args:
        address: of the rosbridge.
        barrier: the service that is called to learn that earlier operations were handled; None to find one.

    Attributes:
        barrier: that service.
        generation: of the robot's ROS, as the server's own node shows; None where it was not looked for, or shows none.
        on_message: called, in the thread that receives, with a topic's name and one of its messages.
        on_request: called, in the same thread, with an operation that calls a service that is offered here.
        on_action: called, in the same thread, with an operation about a goal of an action.
        on_lost: called once with the error that the connection is lost.
        stop_operations: returns what is sent to a server that no longer answers, before the connection is closed: if
            only its answers are lost, it receives them.

    Raises:
        LinkError: it cannot be reached, or is not a rosbridge.
    """

    def __init__(self, address: RosbridgeAddress, barrier: str | None = None) -> None:
        self.where = f"rosbridge at {address.place}"
        self.on_message: Callable[[str, Any], None] = lambda _topic, _message: None
        self.on_request: Callable[[Mapping[str, Any]], None] = lambda _operation: None
        self.on_action: Callable[[Mapping[str, Any]], None] = lambda _operation: None
        self.on_lost: Callable[[LinkError], None] = lambda _error: None
        self.stop_operations: Callable[[], Iterable[dict[str, Any]]] = tuple
        self.barrier = barrier or _OWN_SERVICES[-1][1]
        self.generation: int | None = None
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._sending = threading.Lock()  # nothing may be sent after the last words
        self._pending: dict[str, _Pending] = {}
        self._complaints: dict[str, str] = {}
        self._waiting: set[threading.Event] = set()
        self._lost: LinkError | None = None
        self._is_closed = False
        self._is_over = threading.Event()
        self._todo = {form: queue.SimpleQueue[tuple[Callable[[], None], int] | None]() for form in (False, True)}
        self._size, self._waiting_bytes = 0, 0
        self._closing = ExitStack()
        self._connection = connect(address, ANSWER, self._closing, where=self.where)
        self._sender = OwnThread()
        self._threads = [
            threading.Thread(target=target, name=f"rosbridge {name}", daemon=True)
            for name, target in (
                ("receiver", self._receive),
                ("callbacks", partial(self._call_back, self._todo[False])),
                ("prompt callbacks", partial(self._call_back, self._todo[True])),
                ("pings", self._keep_asking),
            )
        ]
        for thread in self._threads:
            thread.start()
        self._authenticate(address)
        self._greet(looks=barrier is None)

    @property
    def is_usable(self) -> bool:
        """Whether anything can be sent."""
        return not self._is_closed and self._lost is None

    def check_open(self, where: str) -> None:
        """Raise a `LinkError` if the session was closed or lost."""
        if self._is_closed:
            raise link_closed(where)
        if self._lost is not None:
            raise self._lost

    def send(self, operation: dict[str, Any]) -> None:
        """Send an operation without an answer."""
        text = as_json(operation)
        try:
            with self._sending:
                self.check_open(self.where)
                self._sender.call(partial(self._connection.send, text))
        except send_errors() as error:
            self._lose(str(error))
            raise (self._lost or self._loss(str(error))) from error

    def command_zero_first(self) -> None:
        """Command zero where `zero_first` says so, in operations that servers of both generations take.

        A server may take them although it answers nothing: its services, and rosapi, are handled by other threads.
        """
        for topic, message_type in topics_of_zero_first():
            self.send({"op": "advertise", "id": self.fresh_id("advertise"), "topic": topic, "type": message_type})
            self.send({"op": "publish", "topic": topic, "msg": {}})

    def flush(self, *, where: str) -> None:
        """Return when the server has handled all earlier operations; raise a `LinkError` if it does not in time."""
        self.call(self.barrier, {}, timeout=ANSWER, where=where)

    def request(self, operation: dict[str, Any], *, where: str) -> None:
        """Send an operation; return when the server has handled it, raise a `LinkError` if it refuses or is late."""
        name = operation.get("id") or self.fresh_id(operation["op"])
        self.send({**operation, "id": name})
        self.flush(where=where)
        if (complaint := self.complaint(name)) is not None:
            raise LinkError(f"the rosbridge refuses it: {complaint}", where=where, fix="Correct what it says.")

    def call(self, service: str, request: Mapping[str, Any], *, timeout: float, where: str = "") -> Reply:
        """Call a service and return its answer, in the protocol's form; raise a `LinkError` if it is late."""
        return self.calls([(service, request)], timeout=timeout, where=where)[0]

    def calls(self, questions: list[tuple[str, Mapping[str, Any]]], *, timeout: float, where: str = "") -> list[Reply]:
        """Call services all at once; otherwise as `call`."""
        names = [self._ask(service, request) for service, request in questions]
        try:
            return [
                self._answer(name, timeout, where or service)
                for name, (service, _) in zip(names, questions, strict=True)
            ]
        finally:
            with self._lock:
                for name in names:
                    self._pending.pop(name, None)
                    self._complaints.pop(name, None)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait at most `seconds` for an event."""
        with self._lock:
            self._waiting.add(event)
        try:
            if self._lost is None:
                event.wait(seconds)
        finally:
            with self._lock:
                self._waiting.discard(event)
        if self._lost is not None:
            raise self._lost

    def later(self, todo: Callable[[], None], *, is_prompt: bool = False) -> None:
        """Queue a function for the thread that executes callbacks, or for the one that is prompt.

        Called by the receiving thread, for the frame that it has just read. If callbacks are slower than messages
        arrive, the connection is closed before the memory is full.
        """
        size = self._size
        with self._lock:
            self._waiting_bytes += size
            waiting = self._waiting_bytes
        if (count := self._todo[is_prompt].qsize()) >= _MOST_WAITING or waiting > _MOST_WAITING_BYTES:
            self._lose(f"callbacks are too slow: {count:,} messages of {waiting >> 20:,} MiB wait for them")
            return
        self._todo[is_prompt].put((todo, size))

    def complaint(self, name: str) -> str | None:
        """Return the server's complaint about the operation with this id, if it has sent one."""
        with self._lock:
            return self._complaints.pop(name, None)

    def fresh_id(self, what: str) -> str:
        """Return an id that no operation of this session has."""
        return f"robot_runner:{what}:{next(self._numbers)}"

    def close(self) -> None:
        """Close the connection; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        self._is_over.set()
        for waiting in self._todo.values():
            waiting.put(None)
        with suppress(*send_errors()):
            self._closing.close()
        self._sender.close()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(ANSWER)

    def _authenticate(self, address: RosbridgeAddress) -> None:
        """Authenticate by rosauth if the address names a secret; a server that refuses it closes the connection.

        A robot that is to be stopped is stopped before any answer is awaited.
        """
        operation = address.security.authentication(socket.gethostname(), address.host)
        try:
            if operation is not None:
                self.send(operation)
            self.command_zero_first()
            if operation is not None:
                self.flush(where=self.where)
        except LinkError as error:
            self.close()
            if operation is None:
                raise
            problem = f"the rosbridge does not take our authentication by rosauth: {error.problem}"
            fix = "See that the secret is the one of rosauth's file on the robot, and that both clocks agree to 5 s."
            raise LinkError(problem, where=self.where, fix=fix) from error

    def _greet(self, *, looks: bool) -> None:
        try:
            if not looks:
                self.flush(where=self.where)
                return
            self.barrier = _OTHERWISE
            answers = self.calls([(service, {}) for _, service in _OWN_SERVICES], timeout=ANSWER, where=self.where)
            for (generation, service), answer in zip(_OWN_SERVICES, answers, strict=True):
                if answer.is_good:
                    self.generation, self.barrier = generation, service
        except LinkError as error:
            self.close()
            if self._lost is not None:
                fix = f"{error.fix} If it authenticates its clients by rosauth, name the secret: ?rosauth_env=VARIABLE."
                raise LinkError(error.problem, where=self.where, fix=fix) from error
            problem = f"what listens there does not answer as a rosbridge within {ANSWER:g} s"
            fix = "Name the port of the rosbridge server, or look at its log."
            raise LinkError(problem, where=self.where, fix=fix) from error

    def _ask(self, service: str, request: Mapping[str, Any]) -> str:
        name = self.fresh_id("call_service")
        with self._lock:
            self._pending[name] = _Pending()
        self.send({"op": "call_service", "id": name, "service": service, "args": dict(request)})
        return name

    def _answer(self, name: str, timeout: float, where: str) -> Reply:
        pending = self._pending[name]
        self.wait(pending.event, timeout)
        if pending.reply is None:
            raise service_timeout(where, timeout)
        return pending.reply

    def _receive(self) -> None:
        reader = FrameReader()
        try:
            for frame in self._connection:
                self._size = len(frame)
                try:
                    operation = reader.read(frame)
                except ValueError as error:
                    _logger.warning("%s sent what is not an operation: %s", self.where, error)
                    continue
                if operation is not None:
                    self._take(operation)
                if self._lost is not None:
                    break  # what the server has still to send waits there
        except send_errors() as error:
            self._lose(str(error))
        finally:
            self._lose("the server closed the connection")

    def _keep_asking(self) -> None:
        """Ping the server periodically, and close the connection if it does not answer.

        A server that is suspended, or behind a broken network, does not close its connections.
        """
        with suppress(*send_errors()):  # it is closed: the receiving thread reports why
            while not self._is_over.wait(_PING_INTERVAL):
                if not self._is_answered(self._connection.ping()):
                    self._give_up()
                    break

    def _is_answered(self, pong: threading.Event) -> bool:
        asked = time.monotonic()
        while not pong.wait(_PING_LOOK) and not self._is_over.is_set():
            if time.monotonic() - asked >= _PING_TIMEOUT:
                return False
        return True

    def _give_up(self) -> None:
        """Send the last words to a server that does not answer, and close the connection."""
        deliver_late(self._connection)  # the last words
        can_send = self._sending.acquire(timeout=_PING_LOOK)  # else the network takes nothing more
        try:
            for operation in self.stop_operations() if can_send and self.is_usable else ():
                self._connection.send(as_json(operation))
        finally:
            self._lose("the robot does not answer any more")
            if can_send:
                self._sending.release()
        self._connection.close()

    def _take(self, operation: dict[str, Any]) -> None:
        match operation["op"]:
            case "publish":
                self.on_message(str(operation.get("topic")), operation.get("msg"))
            case "service_response":
                self._take_response(operation)
            case "call_service":
                self.on_request(operation)
            case "action_feedback" | "action_result" | "send_action_goal" | "cancel_action_goal":
                self.on_action(operation)
            case "status":
                self._take_status(operation)
            case other:
                _logger.debug("%s sent %r, which is not needed here", self.where, other)

    def _take_response(self, operation: Mapping[str, Any]) -> None:
        with self._lock:
            pending = self._pending.get(str(operation.get("id")))
        if pending is not None:  # else: it came after its deadline
            pending.reply = Reply(operation.get("result") is not False, operation.get("values"))
            pending.event.set()

    def _take_status(self, operation: Mapping[str, Any]) -> None:
        text, name = str(operation.get("msg")), str(operation.get("id"))
        if operation.get("level") != "error":
            _logger.info("%s says: %s", self.where, text)
            return
        with self._lock:
            if name in self._pending:
                return  # its response says the same
            self._complaints[name] = text
        if not name.startswith("robot_runner:"):
            _logger.warning("%s complains: %s", self.where, text)

    def _call_back(self, queued: queue.SimpleQueue[tuple[Callable[[], None], int] | None]) -> None:
        while (waiting := queued.get()) is not None:
            todo, size = waiting
            with self._lock:
                self._waiting_bytes -= size
            try:
                if not self._is_closed:
                    todo()
            except LinkError:
                if not self._is_closed:  # else it was closed meanwhile, and nobody waits for what was to be sent
                    raise

    def _lose(self, reason: str) -> None:
        with self._lock:
            is_news = self._lost is None and not self._is_closed
            if is_news:
                self._lost = self._loss(reason)
            events = [*self._waiting]
        if is_news and self._lost is not None:
            self.on_lost(self._lost)
        for event in events:
            event.set()

    def _loss(self, reason: str) -> LinkError:
        fix = "Check whether the robot is on and in this network, and whether its rosbridge server runs."
        if "message too big" in reason:  # as RFC 6455 calls code 1009
            fix = f"Send less at once: {LARGEST_FRAME >> 20} MiB come at most, 10 MB go to ROS 2 (max_message_size)."
        return LinkError(f"the connection is lost: {reason}", where=self.where, fix=fix)
