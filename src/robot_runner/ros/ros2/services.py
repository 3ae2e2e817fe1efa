"""Services over rclpy, with deadlines."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.graph_links import missing
from robot_runner.ros.ros2.message_types import as_mapping, as_message, service_class, shape_of
from robot_runner.ros.shapes import completed, plain_type

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.core.links.robot import Message
    from robot_runner.ros.ros2.node import Graph, GraphNode

__all__ = ["OfferedService", "ServiceClient"]

#: How long a service that is not there is waited for, s; a node that starts up takes as long.
_PATIENCE = 1.5


class ServiceClient:
    """One who calls a service.

    Args:
        node: to call from.
        graph: of the node.
        name: full name of the service.
        service_type: ROS name.

    Raises:
        LinkError: there is no such type.
    """

    def __init__(self, node: GraphNode, graph: Graph, name: str, service_type: str) -> None:
        self._node = node
        self._graph = graph
        self._name = name
        self._type = plain_type(service_type)
        self._cls = service_class(service_type)
        self._client = node.node.create_client(self._cls, name)

    def call(self, request: Mapping[str, Any], timeout: float) -> dict[str, Any]:
        """Return the response.

        Raises:
            LinkError: there is no such service, it has another type, it does not answer within `timeout` s, or the
                request does not follow its definition.
        """
        deadline = time.monotonic() + timeout
        complete = completed(shape_of(self._cls.Request), request, where=self._name)
        self._find(min(timeout, _PATIENCE))
        answered = threading.Event()
        future = self._client.call_async(as_message(self._cls.Request, complete))
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(deadline - time.monotonic(), 0.0)):
            self._client.remove_pending_request(future)
            fix = "Look whether its node is alive and did not fail, or give a longer timeout."
            raise LinkError(f"the service does not answer within {timeout:g} s", where=self._name, fix=fix)
        return as_mapping(future.result())

    def _find(self, seconds: float) -> None:
        if self._node.until(self._client.service_is_ready, seconds):
            return
        true = self._graph.service_type(self._name)
        if true is not None and true != self._type:
            raise LinkError(
                f"it is of type {true}, not {self._type!r}", where=self._name, fix=f"Name the type {true!r}."
            )
        raise missing("service", self._name, self._graph.services(), where="ros2", fix="Start the node that offers it.")


class OfferedService:
    """A service that is offered until it is closed.

    Args:
        node: to offer it at.
        graph: of the node.
        name: full name of the service.
        service_type: ROS name.
        answer: makes the response of a request. A request at which it raises is not answered: services of ROS 2 have no
            words for it.

    Raises:
        LinkError: there is no such type, or somebody offers a service of this name already.
    """

    def __init__(
        self, node: GraphNode, graph: Graph, name: str, service_type: str, answer: Callable[[Message], Message]
    ) -> None:
        self._name = name
        self._cls = service_class(service_type)
        self._answer = answer
        self._is_open = True
        node.settle(lambda: graph.service_type(name))
        if graph.service_type(name) is not None:
            fix = "End the other, or give the robots namespaces of their own."
            raise LinkError(f"somebody offers the service {name!r} already", where=name, fix=fix)
        self._host = node.services()
        self._service = self._host.create_service(self._cls, name, self._respond)
        node.until(lambda: graph.service_type(name), _PATIENCE)

    def close(self) -> None:
        """Offer it no more; closing twice does nothing."""
        if self._is_open:
            self._is_open = False
            self._host.destroy_service(self._service)

    def _respond(self, request: Any, response: Any) -> Any:
        del response
        made = completed(shape_of(self._cls.Response), self._answer(as_mapping(request)), where=self._name)
        return as_message(self._cls.Response, made)
