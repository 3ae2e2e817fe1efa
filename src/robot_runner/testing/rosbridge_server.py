"""A rosbridge server for tests, with a graph of its own; it needs no ROS.

Source: rosbridge v2.0 protocol specification.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import RobotRunnerError
from robot_runner.core.links.robot import Encoding, Message
from robot_runner.ros.rosbridge_frames import FrameReader, send_errors, to_protocol
from robot_runner.ros.rosbridge_security import TurnTakingSocket
from robot_runner.ros.shapes import completed, plain_type
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.testing.rosbridge_graph import (
    Graph,
    Refusal,
    ServedRosapi,
    ServedService,
    ServedTopic,
    imported_type,
    received,
    with_typed_arrays,
)
from robot_runner.testing.served_actions import ServedActions

if TYPE_CHECKING:
    from ssl import SSLContext

_logger = logging.getLogger(__name__)
_vanishing = logging.getLogger(f"{__name__}.websockets")
_vanishing.setLevel(logging.CRITICAL)  # tests let clients vanish on purpose


class ServedClient:
    """The server's side of a client's WebSocket connection."""

    def __init__(self, server: RosbridgeServer, connection: Any) -> None:
        self._server = server
        self._connection = connection
        self._numbers = itertools.count(1)
        self._compressions: dict[str, str] = {}
        self._fragment_sizes: dict[str, int] = {}
        self._open_requests: dict[str, tuple[ServedClient, Any]] = {}
        self._is_authenticated = False
        self.asking: set[str] = set()  # calls of services that are not answered yet

    def serve(self) -> None:
        """Handle operations until the connection ends."""
        reader = FrameReader()
        with suppress(*send_errors()):
            for frame in self._connection:
                try:
                    operation = reader.read(frame)
                except ValueError as error:
                    self._complain(None, str(error))
                    continue
                if operation is not None:
                    self._take(operation)
                while self._server.calls_in_turn and self.asking and self._connection.close_code is None:
                    time.sleep(0.01)
        self._leave()

    def close(self) -> None:
        """End the connection."""
        with suppress(*send_errors()):
            self._connection.close()

    def receive(self, topic: ServedTopic, message: Message) -> None:
        """Send a message of a topic, in the requested compression."""
        compression = self._compressions.get(topic.name, "none")
        operation: dict[str, Any] = {"op": "publish", "topic": topic.name}
        types, name = self._server.graph.types, plain_type(topic.type_name)
        if compression == "cbor-raw":
            seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
            data = types.serialise(name, message, self._server.encoding)
            self._send_bytes({**operation, "msg": {"secs": seconds, "nsecs": nanoseconds, "bytes": data}})
            return
        shape = types.shape(name)
        values = self._server.spelt(to_protocol(shape, message))
        if compression == "cbor":
            with suppress(Refusal):  # a real server only logs it
                self._send_bytes({**operation, "msg": with_typed_arrays(shape, values, message)})
        else:
            self._send({**operation, "msg": values}, self._fragment_sizes.get(topic.name))

    def ask(self, caller: ServedClient, number: Any, service: str, request: Mapping[str, Any]) -> None:
        """Forward a call of a service that this client offers."""
        name = f"service_request:{service}:{next(self._numbers)}"
        self._open_requests[name] = (caller, number)
        caller.asking.add(str(number))
        self.send({"op": "call_service", "id": name, "service": service, "args": dict(request)})

    def respond(self, number: Any, service: str, values: Any, *, is_good: bool) -> None:
        """Send the response of a service that this client called."""
        self.asking.discard(str(number))
        self.send({"op": "service_response", "id": number, "service": service, "values": values, "result": is_good})

    def send(self, operation: dict[str, Any]) -> None:
        """Send an operation."""
        self._send(self._server.spelt(operation))

    def _take(self, operation: dict[str, Any]) -> None:
        takers: dict[str, Callable[[dict[str, Any]], None]] = {
            "advertise": self._advertise,
            "unadvertise": lambda op: self._server.graph.unadvertise(op["topic"], self),
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": lambda op: self._server.graph.unsubscribe(op["topic"], self, op.get("id")),
            "call_service": self._call,
            "advertise_service": self._advertise_service,
            "unadvertise_service": self._unadvertise_service,
            "service_response": self._pass_on,
            "set_level": lambda _: None,
            **dict.fromkeys(self._server.actions.takers, lambda op: self._server.actions.take(op, self)),
        }
        if self._server.secret and not self._is_authenticated:
            # As in rosauth: the SHA-512 of the secret and these fields, in this order.
            said = "".join(str(operation.get(name)) for name in ("client", "dest", "rand", "t", "level", "end"))
            mac = hashlib.sha512((self._server.secret + said).encode()).hexdigest()
            self._is_authenticated = operation["op"] == "auth" and operation.get("mac") == mac
            if not self._is_authenticated:
                self.close()
            return
        try:
            with self._server.lock:
                taker = takers.get(operation["op"])
                if taker is None:
                    raise Refusal(f"Unknown operation: {operation['op']}")  # noqa: TRY301 - answered as all others
                taker(operation)
        except KeyError as error:
            self._complain(operation.get("id"), f"{operation['op']}: the field {error} is missing")
        except (Refusal, RobotRunnerError) as error:
            self._complain(operation.get("id"), f"{operation['op']}: {error}")

    def _advertise(self, operation: dict[str, Any]) -> None:
        type_name = imported_type(operation["type"])
        self._server.graph.types.shape(plain_type(type_name))
        is_latched = bool(operation.get("latch", False))
        self._server.graph.advertise(operation["topic"], type_name, self, is_latched=is_latched)

    def _publish(self, operation: dict[str, Any]) -> None:
        name = operation["topic"]
        topic = self._server.graph.topics.get(name)
        if topic is None:
            raise Refusal(f"topic {name} is not advertised")
        shape = self._server.graph.types.shape(plain_type(topic.type_name))
        self._server.graph.publish(name, received(shape, operation["msg"], where=name), self)

    def _subscribe(self, operation: dict[str, Any]) -> None:
        name, asked = operation["topic"], operation.get("compression", "none")
        type_name = operation.get("type") and imported_type(operation["type"])
        if type_name is not None:
            self._server.graph.types.shape(plain_type(type_name))
        self._compressions[name] = asked if asked in self._server.compressions else "none"
        if operation.get("fragment_size"):
            self._fragment_sizes[name] = operation["fragment_size"]
        self._server.graph.subscribe(name, type_name, self, str(operation.get("id")))

    def _call(self, operation: dict[str, Any]) -> None:
        name, number, request = operation["service"], operation.get("id"), operation.get("args") or {}
        try:
            self._server.call(self, number, name, request)
        except (Refusal, RobotRunnerError) as error:
            self._complain(number, f"call_service {type(error).__name__}: {error}")
            self.respond(number, name, str(error), is_good=False)

    def _advertise_service(self, operation: dict[str, Any]) -> None:
        self._server.graph.types.request(plain_type(operation["type"]))
        self._server.graph.services[operation["service"]] = ServedService(operation["type"], self)

    def _unadvertise_service(self, operation: dict[str, Any]) -> None:
        service = self._server.graph.services.get(operation["service"])
        if service is None or service.owner is not self:
            raise Refusal(f"Service {operation['service']} has not been advertised externally.")
        del self._server.graph.services[operation["service"]]

    def _pass_on(self, operation: dict[str, Any]) -> None:
        caller, number = self._open_requests.pop(operation["id"], (None, None))
        if caller is not None:
            values, is_good = operation.get("values"), operation.get("result", True)
            caller.respond(number, operation["service"], values, is_good=is_good)

    def _leave(self) -> None:
        with self._server.lock:
            self._server.actions.forget(self)
            self._server.graph.forget(self)
            for caller, number in self._open_requests.values():
                caller.respond(number, "", "the service's node is gone", is_good=False)
            self._open_requests.clear()
        self._server.forget(self)

    def _complain(self, number: Any, text: str) -> None:
        if not self._server.tells:
            _logger.debug("refused: %s", text)
            return
        status = {"op": "status", "level": "error", "msg": text}
        self._send(status if number is None else {**status, "id": number})

    def _send(self, operation: dict[str, Any], fragment_size: int | None = None) -> None:
        text = json.dumps(operation)
        if fragment_size is None or len(text) <= fragment_size:
            self._send_frame(text)
            return
        parts = [text[at : at + fragment_size] for at in range(0, len(text), fragment_size)]
        name = str(next(self._numbers))
        for number, part in enumerate(parts):
            fragment = {"op": "fragment", "id": name, "data": part, "num": number, "total": len(parts)}
            self._send_frame(json.dumps(fragment))

    def _send_bytes(self, operation: dict[str, Any]) -> None:
        from cbor2 import dumps  # noqa: PLC0415  # an extra

        self._send_frame(dumps(operation))

    def _send_frame(self, frame: str | bytes) -> None:
        with suppress(*send_errors()):
            self._connection.send(frame)


_ALL = ("none", "cbor", "cbor-raw")
_DISTROS = {1: "noetic", 2: "humble"}


class RosbridgeServer:
    """A rosbridge server on a free port of this machine, in threads.

    Args:
        generation: of ROS.
        has_rosapi: whether rosapi runs, too.
        tells: whether it sends status messages, as the protocol says; today's servers only log them.
        compressions: those that it supports; it sends JSON in place of any other.
        types: files and folders with the robot's message types beyond the standard ones.
        tls: with its certificate; None for a server without TLS.
        authorization: the HTTP header that it requires, or answers 401; empty for none.
        secret: for the authentication of clients by rosauth, without which they are disconnected; empty for none.

    Attributes:
        graph: its topics and services.
        actions: its actions, for ROS 2.
        lock: to be held while the graph is used.
        calls_in_turn: whether a connection's operations wait until the service that it calls has answered, as by
            default in ROS 2 (`call_services_in_new_thread`).

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> from robot_runner.ros.link_opening import open_rosbridge_link
        >>> server = RosbridgeServer()
        >>> server.offer("/task/stop", "std_srvs/Trigger", lambda request: {"success": True})
        >>> link = open_rosbridge_link(server.url, SystemClock())
        >>> link.call("task/stop", "std_srvs/Trigger")
        {'success': True, 'message': ''}
        >>> link.close()
        >>> server.close()
    """

    def __init__(
        self,
        *,
        generation: int = 1,
        has_rosapi: bool = True,
        tells: bool = False,
        compressions: Sequence[str] = _ALL,
        types: Sequence[Path] = (),
        tls: SSLContext | None = None,
        authorization: str = "",
        secret: str = "",
    ) -> None:
        from websockets.sync.server import serve  # noqa: PLC0415  # an extra

        self.generation = generation
        self.calls_in_turn = generation > 1
        self.tells = tells
        self.compressions = tuple(compressions)
        self.graph = Graph(TypeCatalogue.of(generation, _DISTROS[generation], tuple(types)))
        self.actions = ServedActions(self.graph, is_known=generation > 1)
        self.lock = threading.RLock()
        self._rosapi = ServedRosapi(self.graph, generation, _DISTROS[generation])
        self._rosapi.has_ended = not has_rosapi
        self._clients: list[ServedClient] = []
        self._scheme = "rosbridge" if tls is None else "rosbridge+tls"
        self.secret = secret
        self._authorization = authorization
        if tls is not None:
            tls.sslsocket_class = TurnTakingSocket
        self._server = serve(
            self._serve,
            "127.0.0.1",
            0,
            ssl=tls,
            process_request=self._judge,
            max_size=None,
            compression=None,
            logger=_vanishing,
        )
        self._thread = threading.Thread(target=self._server.serve_forever, name="rosbridge server", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._server.socket.getsockname()[1])

    @property
    def url(self) -> str:
        """The value of `robot` in a config, to reach it."""
        return f"{self._scheme}://127.0.0.1:{self.port}"

    @property
    def encoding(self) -> Encoding:
        """The encoding of raw messages in its generation of ROS."""
        return Encoding.ROS1 if self.generation == 1 else Encoding.CDR

    def publish(self, topic: str, message_type: str, message: Message, *, is_latched: bool = False) -> None:
        """Publish a message from a node behind the server; names are full."""
        complete = completed(self.graph.types.shape(message_type), message, where=topic)
        with self.lock:
            self.graph.advertise(topic, self._spelt_type(message_type, "msg"), self, is_latched=is_latched)
            self.graph.publish(topic, complete, self)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> None:
        """Offer a service from a node behind the server; names are full."""
        with self.lock:
            self.graph.services[service] = ServedService(self._spelt_type(service_type, "srv"), self, answer)

    def drop_connections(self) -> None:
        """Close all connections, as when the battery of the robot is empty, and go on listening."""
        for client in list(self._clients):
            client.close()

    def close(self) -> None:
        """End the server; closing twice does nothing."""
        self._server.shutdown()
        self.drop_connections()
        self._thread.join(5.0)

    def call(self, caller: ServedClient, number: Any, service: str, request: Mapping[str, Any]) -> None:
        """Let a service answer a client, or raise a `Refusal`; called with the lock held."""
        if self._rosapi.hangs and service.startswith("/rosapi/"):
            caller.asking.add(str(number))
            return
        if (answer := self._rosapi.answer(service, request)) is not None:
            caller.respond(number, service, answer, is_good=True)
            return
        served = self.graph.services.get(service)
        if served is None:
            raise Refusal(f"Service {service} does not exist")
        asked = received(self.graph.types.request(plain_type(served.type_name)), request, where=service)
        if isinstance(served.owner, ServedClient):
            spelt = to_protocol(self.graph.types.request(plain_type(served.type_name)), asked)
            served.owner.ask(caller, number, service, spelt)
        elif served.answer is not None:
            response = self.graph.types.response(plain_type(served.type_name))
            values = to_protocol(response, completed(response, served.answer(asked), where=service))
            caller.respond(number, service, values, is_good=True)

    def forget(self, client: ServedClient) -> None:
        """Remove a client."""
        if client in self._clients:
            self._clients.remove(client)

    def receive(self, topic: object, message: Message) -> None:
        """Do nothing: the nodes behind the server subscribe no topics."""

    def spelt(self, values: Any) -> Any:
        """Return values for JSON: null in place of NaN and infinity."""
        if isinstance(values, float):
            return values if math.isfinite(values) else None
        if isinstance(values, dict):
            return {name: self.spelt(value) for name, value in values.items()}
        return [self.spelt(each) for each in values] if isinstance(values, list) else values

    def _spelt_type(self, name: str, kind: str) -> str:
        return name if self.generation == 1 else name.replace("/", f"/{kind}/", 1)

    def _judge(self, connection: Any, request: Any) -> Any:
        is_known = self._authorization in {"", request.headers.get("Authorization")}
        return None if is_known else connection.respond(401, "who are you?")

    def _serve(self, connection: Any) -> None:
        client = ServedClient(self, connection)
        self._clients.append(client)
        client.serve()
