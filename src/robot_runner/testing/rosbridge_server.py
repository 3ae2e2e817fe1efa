"""A rosbridge server for tests, with a graph of its own behind it; it takes no ROS.

Source: rosbridge v2.0 protocol specification.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from typing import TYPE_CHECKING, Any

from robot_runner.links.robot import Encoding
from robot_runner.links.rosbridge.conversion import to_protocol
from robot_runner.links.shapes import completed, plain_type
from robot_runner.links.type_catalogue import TypeCatalogue
from robot_runner.testing.rosbridge_client import ServedClient
from robot_runner.testing.rosbridge_graph import Graph, Refusal, ServedService, received
from robot_runner.testing.rosbridge_rosapi import ServedRosapi

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from robot_runner.links.robot import Message

__all__ = ["RosbridgeServer"]

_ALL = ("none", "cbor", "cbor-raw")
_DISTROS = {1: "noetic", 2: "humble"}


class RosbridgeServer:
    """A rosbridge server on a free port of this machine, in threads.

    Args:
        generation: of the ROS that it is a bridge to.
        has_rosapi: whether rosapi runs beside it.
        tells: whether it sends status messages, as the protocol says; today's servers only write them to their log.
        compressions: that it knows; a server sends JSON where it does not know one.
        types: files and folders with message types that the robot has beyond the standard ones.

    Attributes:
        graph: topics and services behind it.
        lock: held by whoever uses the graph.

    Example:
        >>> from robot_runner.events.clock import SystemClock
        >>> from robot_runner.links.rosbridge.opening import open_rosbridge_link
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
    ) -> None:
        from websockets.sync.server import serve  # noqa: PLC0415  # an extra

        self.generation = generation
        self.tells = tells
        self.compressions = tuple(compressions)
        self.graph = Graph(TypeCatalogue.of(generation, _DISTROS[generation], tuple(types)))
        self.lock = threading.RLock()
        nodes = ["/rosbridge_websocket", *(["/rosapi"] if has_rosapi else [])]
        self._rosapi = ServedRosapi(self.graph, generation, _DISTROS[generation], nodes) if has_rosapi else None
        self._clients: list[ServedClient] = []
        self._server = serve(self._serve, "127.0.0.1", 0, max_size=None, compression=None, logger=_quiet())
        self._thread = threading.Thread(target=self._server.serve_forever, name="rosbridge server", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._server.socket.getsockname()[1])

    @property
    def url(self) -> str:
        """What `robot` is set to, to reach it."""
        return f"rosbridge://127.0.0.1:{self.port}"

    @property
    def encoding(self) -> Encoding:
        """How its generation of ROS lays out bytes."""
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
        """End all connections, as a robot does whose battery is empty, and go on listening."""
        for client in list(self._clients):
            client.close()

    def close(self) -> None:
        """End; closing twice does nothing."""
        self._server.shutdown()
        self.drop_connections()
        self._thread.join(5.0)

    def call(self, caller: ServedClient, number: Any, service: str, request: Mapping[str, Any]) -> None:
        """Have a service answer to a client; called with the lock held.

        Raises:
            Refusal: there is no such service, or the request is not one of its type.
        """
        if self._rosapi is not None and (answer := self._rosapi.answer(service, request)) is not None:
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
        """Let a client go."""
        if client in self._clients:
            self._clients.remove(client)

    def hear(self, topic: object, message: Message) -> None:
        """Take nothing: the nodes behind the server hear no topics."""

    def now_ns(self) -> int:
        """Return the time on the robot, ns since the epoch."""
        return time.time_ns()

    def spelt(self, values: Any) -> Any:
        """Return values as they can be written in JSON: numbers that are none are null."""
        if isinstance(values, float):
            return values if math.isfinite(values) else None
        if isinstance(values, dict):
            return {name: self.spelt(value) for name, value in values.items()}
        return [self.spelt(each) for each in values] if isinstance(values, list) else values

    def _spelt_type(self, name: str, kind: str) -> str:
        return name if self.generation == 1 else name.replace("/", f"/{kind}/", 1)

    def _serve(self, connection: Any) -> None:
        client = ServedClient(self, connection)
        self._clients.append(client)
        client.serve()


def _quiet() -> logging.Logger:
    logger = logging.getLogger(f"{__name__}.websockets")
    logger.setLevel(logging.CRITICAL)  # clients that vanish are what tests are about
    return logger
