"""The part of rosapi that the rosbridge server of the tests offers."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from robot_runner.links.shapes import Field, Shape, UpTo, plain_type
from robot_runner.testing.rosbridge_graph import Refusal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.testing.rosbridge_graph import Graph

__all__ = ["ServedRosapi"]


class ServedRosapi:
    """Answers questions about a graph.

    Args:
        graph: that it is asked about.
        generation: of ROS.
        distro: of ROS.
        nodes: full names of the nodes that there are.
    """

    def __init__(self, graph: Graph, generation: int, distro: str, nodes: list[str]) -> None:
        self._graph = graph
        self._generation = generation
        self._distro = distro
        self.nodes = nodes

    def answer(self, service: str, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the response of a service of rosapi's, or None if it is none of them."""
        questions: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
            "get_time": lambda _: {"time": self._stamp()},
            "topics": lambda _: self._topics(),
            "topic_type": lambda asked: {"type": self._topic_type(asked["topic"])},
            "services": lambda _: {"services": [*self._graph.services, "/rosapi/topics"]},
            "service_type": lambda asked: {"type": self._service_type(asked["service"])},
            "nodes": lambda _: {"nodes": list(self.nodes)},
            "message_details": lambda asked: _details(self._graph.types.shape(plain_type(asked["type"]))),
            "service_request_details": lambda asked: _details(self._graph.types.request(plain_type(asked["type"]))),
            "service_response_details": lambda asked: _details(self._graph.types.response(plain_type(asked["type"]))),
            "topics_and_raw_types": lambda _: self._raw(),
        }
        if self._generation > 1:
            questions["get_ros_version"] = lambda _: {"version": self._generation, "distro": self._distro}
        question = questions.get(service.removeprefix("/rosapi/")) if service.startswith("/rosapi/") else None
        if question is None:
            return None
        try:
            return question(request)
        except KeyError as error:
            raise Refusal(f"the request of {service} lacks {error}") from error

    def _stamp(self) -> dict[str, int]:
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        names = ("secs", "nsecs") if self._generation == 1 else ("sec", "nanosec")
        return dict(zip(names, (seconds, nanoseconds), strict=True))

    def _topics(self) -> dict[str, Any]:
        topics = self._graph.topics.values()
        return {"topics": [topic.name for topic in topics], "types": [topic.type_name for topic in topics]}

    def _topic_type(self, name: str) -> str:
        topic = self._graph.topics.get(name)
        return "" if topic is None else topic.type_name

    def _service_type(self, name: str) -> str:
        service = self._graph.services.get(name)
        return "" if service is None else service.type_name

    def _raw(self) -> dict[str, Any]:
        topics = self._topics()
        texts = [self._graph.types.definition(plain_type(name)) for name in topics["types"]]
        return {**topics, "typedefs_full_text": texts}


def _details(shape: Shape) -> dict[str, Any]:
    found: dict[str, dict[str, Any]] = {}
    _describe(shape, found)
    return {"typedefs": list(found.values())}


def _describe(shape: Shape, found: dict[str, dict[str, Any]]) -> None:
    if shape.type_name in found:
        return
    found[shape.type_name] = {
        "type": shape.type_name,
        "fieldnames": list(shape.names),
        "fieldtypes": [_kind(field) for field in shape.fields],
        "fieldarraylen": [_length(field) for field in shape.fields],
        "examples": ["" for _ in shape.fields],
        "constnames": [],
        "constvalues": [],
    }
    for field in shape.fields:
        if isinstance(field.kind, Shape):
            _describe(field.kind, found)


def _kind(field: Field) -> str:
    return field.kind.type_name if isinstance(field.kind, Shape) else field.kind


def _length(field: Field) -> int:
    if field.count is None:
        return -1
    return 0 if isinstance(field.count, UpTo) else field.count
