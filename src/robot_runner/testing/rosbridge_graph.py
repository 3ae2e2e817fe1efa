"""The graph behind the rosbridge server of the tests, with the part of rosapi that describes it."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Message
from robot_runner.ros.action_types import is_action_part, python_name
from robot_runner.ros.rosbridge_frames import from_protocol, to_protocol
from robot_runner.ros.shapes import BYTE_KINDS, UNBOUNDED, Field, Shape, UpTo, completed, plain_type, stamp_of

if TYPE_CHECKING:
    from cbor2 import CBORTag

    from robot_runner.ros.type_catalogue import TypeCatalogue

#: Tag and layout of an array of numbers, by the kind of its elements.
_TYPED = MappingProxyType(
    {
        "uint16": (69, "H"),
        "uint32": (70, "I"),
        "uint64": (71, "Q"),
        "int8": (72, "b"),
        "int16": (77, "h"),
        "int32": (78, "i"),
        "int64": (79, "q"),
        "float32": (85, "f"),
        "float64": (86, "d"),
    }
)


def typed_array(kind: str, numbers: Sequence[Any]) -> CBORTag:
    """Return numbers of one kind as a typed array, little endian.

    Example:
        >>> from cbor2 import dumps
        >>> dumps(typed_array("int8", [1, -1])).hex()
        'd8484201ff'
    """
    from cbor2 import CBORTag  # noqa: PLC0415  # an extra

    tag, layout = _TYPED[kind]
    return CBORTag(tag, struct.pack(f"<{len(numbers)}{layout}", *numbers))


def with_typed_arrays(shape: Shape, values: Mapping[str, Any], message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a message of the protocol with its arrays of numbers and bytes in CBOR.

    Args:
        shape: of its type.
        values: the message in the protocol's JSON.
        message: the same message as a plain mapping.

    Raises:
        Refusal: servers cannot write one of its arrays in CBOR (cbor_conversion.py of rosbridge_library 0.11).
    """
    return {field.name: _value(field, values[field.name], message[field.name]) for field in shape.fields}


def _value(field: Field, value: Any, ours: Any) -> Any:
    if isinstance(field.kind, Shape):
        if field.count is None:
            return with_typed_arrays(field.kind, value, ours)
        return [with_typed_arrays(field.kind, *pair) for pair in zip(value, ours, strict=True)]
    if field.count is None:
        return value
    if field.count != UNBOUNDED or field.kind in {"string", "time", "duration"}:
        raise Refusal(f"{field.name} is not a message")
    if field.kind in BYTE_KINDS:
        return ours
    return typed_array(field.kind, ours) if field.kind in _TYPED else value


class Refusal(Exception):  # noqa: N818 - what a server says in a status message, which is not an error of the test's
    """A refused operation, with the server's message."""


def imported_type(told: str) -> str:
    """Return the type that a server of ROS 2 imports by this name; a `Refusal` says that it finds none there."""
    package, short = told.partition("/")[0], told.rpartition("/")[2]
    name = f"{package}/{short}"
    if not is_action_part(name):
        return told
    if told != python_name(name):
        raise Refusal(f"Unable to import class {short} from package {package}")
    return f"{package}/action/{short}"


class Client(Protocol):
    """A subscriber, publisher or offerer: a connection, or the test itself."""

    def receive(self, topic: ServedTopic, message: Message) -> None:
        """Receive a message of a topic."""


@dataclass(slots=True)
class ServedTopic:
    """A topic.

    Attributes:
        name: full name.
        type_name: of its messages.
        publishers: whether each is latched, by id.
        subscribers: by id and name of the subscription.
        last: the last message of a latched topic.
        published_until: until when the server stays a publisher without clients, monotonic, s.
    """

    name: str
    type_name: str
    publishers: dict[int, bool] = field(default_factory=dict)
    subscribers: dict[tuple[int, str], Client] = field(default_factory=dict)
    last: Message | None = None
    published_until: float = 0.0

    @property
    def is_published(self) -> bool:
        """Whether the server publishes it, for a client or after the last one has left."""
        return bool(self.publishers) or time.monotonic() < self.published_until

    @property
    def is_there(self) -> bool:
        """Whether it is on the graph."""
        return self.is_published or bool(self.subscribers)


@dataclass(frozen=True, slots=True)
class ServedService:
    """A service: its type, and its server, which is an object with a method for it or a function of the test."""

    type_name: str
    owner: object
    answer: Callable[[Message], Message] | None = None


class Graph:
    """Topics and services by full name; callers hold the server's lock.

    Args:
        types: the message types.

    Attributes:
        action_types: returns the type of each offered action; for rosapi.
        unregister_timeout: how long the server stays a publisher after the last client has left, s; 10 in
            rosbridge_suite.
    """

    def __init__(self, types: TypeCatalogue) -> None:
        self.types = types
        self.topics: dict[str, ServedTopic] = {}
        self.services: dict[str, ServedService] = {}
        self.action_types: Callable[[], Mapping[str, str]] = dict
        self.unregister_timeout = 0.0

    def advertise(self, name: str, type_name: str, publisher: object, *, is_latched: bool = False) -> None:
        """Add a publisher; raise a `Refusal` where the topic has another type."""
        self._topic(name, type_name).publishers[id(publisher)] = is_latched

    def unadvertise(self, name: str, publisher: object) -> None:
        """Remove a publisher."""
        topic = self.topics.get(name)
        if topic is not None and topic.publishers.pop(id(publisher), None) is not None:
            topic.published_until = time.monotonic() + self.unregister_timeout
            self._tidy(name)

    def publish(self, name: str, message: Message, publisher: object) -> None:
        """Send a complete message to the subscribers of the topic."""
        topic = self.topics.get(name)
        if topic is None or id(publisher) not in topic.publishers:
            raise Refusal(f"publish: topic {name} is not advertised")
        if topic.publishers[id(publisher)]:
            topic.last = message
        for subscriber in {id(each): each for each in topic.subscribers.values()}.values():
            subscriber.receive(topic, message)

    def subscribe(self, name: str, type_name: str | None, subscriber: Client, label: str) -> None:
        """Add a subscriber; raise a `Refusal` where the topic has another type."""
        if type_name is None and name not in self.topics:
            raise Refusal(f"subscribe: cannot infer the type of topic {name}, which is not published yet")
        topic = self._topic(name, type_name or self.topics[name].type_name)
        topic.subscribers[id(subscriber), label] = subscriber
        if topic.last is not None:
            subscriber.receive(topic, topic.last)

    def unsubscribe(self, name: str, subscriber: Client, label: str | None) -> None:
        """Remove one subscription of a subscriber or, without a label, all of the topic."""
        topic = self.topics.get(name)
        if topic is not None:
            for key in [key for key in topic.subscribers if key[0] == id(subscriber) and label in {None, key[1]}]:
                del topic.subscribers[key]
            self._tidy(name)

    def forget(self, client: Client) -> None:
        """Remove a client from all topics and services."""
        for name in list(self.topics):
            self.unsubscribe(name, client, None)
            self.unadvertise(name, client)
        for name in [name for name, service in self.services.items() if service.owner is client]:
            del self.services[name]

    def _topic(self, name: str, type_name: str) -> ServedTopic:
        topic = self.topics.get(name)
        if topic is None or not topic.is_there:
            topic = self.topics[name] = ServedTopic(name, type_name)
        if plain_type(topic.type_name) != plain_type(type_name):  # servers of ROS 2 take both spellings
            tried = f"Tried to register topic {name} with type {type_name}"
            raise Refusal(f"{tried} but it is already established with type {topic.type_name}")
        return topic

    def _tidy(self, name: str) -> None:
        if not self.topics[name].is_there:
            del self.topics[name]


def received(shape: Shape, values: object, *, where: str) -> dict[str, Any]:
    """Convert a message of the protocol, which may lack fields, to a complete plain mapping.

    A `Refusal` says that it has a field that the type does not have, a `LinkError` that a value is of another kind.
    """
    defaults = to_protocol(shape, completed(shape, {}, where=where))
    return completed(shape, from_protocol(shape, _merged(defaults, values or {}, where), where=where), where=where)


def _merged(defaults: Mapping[str, Any], given: object, where: str) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise Refusal(f"{where}: expected an object but received {given!r}")
    for name in given:
        if name not in defaults:
            raise Refusal(f"Message type {where} does not have a field {name}")
    return {
        name: _merged(default, given[name], where)
        if isinstance(default, dict) and name in given
        else given.get(name, default)
        for name, default in defaults.items()
    }


class ServedRosapi:
    """Answers the services of rosapi about a graph.

    Attributes:
        nodes: full names of the nodes, the server's first.
        parameters: the parameter server of ROS 1, by full names.
        has_ended: whether it has crashed, as in ROS 2 after a request for the details of a service type that is not
            installed on the robot.
        hangs: whether it is listed but does not answer, like a node that is suspended, or was killed a moment ago.
    """

    def __init__(self, graph: Graph, generation: int, distro: str) -> None:
        self._graph = graph
        self._generation = generation
        self._distro = distro
        self.nodes = ["/rosbridge_websocket", "/rosapi"]
        self.parameters: dict[str, Any] = {}
        self.has_ended = self.hangs = False

    def answer(self, service: str, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the response of a service of rosapi, or None for another service, or if rosapi has ended."""
        topics, services, types = self._graph.topics, self._graph.services, self._graph.types
        questions: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
            "get_time": lambda _: {"time": self._stamp()},
            "topics": lambda _: self._topics(),
            "topic_type": lambda asked: {"type": getattr(topics.get(asked["topic"]), "type_name", "")},
            "services": lambda _: {"services": [*services, "/rosapi/topics"]},
            "service_type": lambda asked: {"type": getattr(services.get(asked["service"]), "type_name", "")},
            "nodes": lambda _: {"nodes": list(self.nodes)},
            "publishers": lambda asked: {"publishers": self._endpoints(asked["topic"], "publishers")},
            "subscribers": lambda asked: {"subscribers": self._endpoints(asked["topic"], "subscribers")},
            "message_details": lambda asked: _details(types.shape(plain_type(asked["type"]))),
            "service_request_details": lambda asked: _details(types.request(plain_type(asked["type"]))),
            "service_response_details": lambda asked: _details(types.response(plain_type(asked["type"]))),
            "topics_and_raw_types": lambda _: {
                **self._topics(),
                "typedefs_full_text": [types.definition(plain_type(topic.type_name)) for topic in topics.values()],
            },
        }
        if self._generation == 1:
            questions |= self._parameter_questions()
        else:
            questions["action_servers"] = lambda _: {"action_servers": list(self._graph.action_types())}
            questions["action_type"] = lambda asked: {"type": self._graph.action_types().get(asked["action"], "")}
            questions["get_ros_version"] = lambda _: {"version": self._generation, "distro": self._distro}
        if service == f"{self.nodes[0]}/{'get_loggers' if self._generation == 1 else 'list_parameters'}":
            return {}  # the server's own node answers, whatever rosapi does
        question = questions.get(service.removeprefix("/rosapi/")) if service.startswith("/rosapi/") else None
        if question is None or self.has_ended:
            return None
        try:
            return question(request)
        except KeyError as error:
            raise Refusal(f"the request of {service} lacks {error}") from error
        except LinkError:
            self.has_ended = self._generation > 1 and service.startswith("/rosapi/service_re")
            raise

    def _parameter_questions(self) -> dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]]:
        """Return rosapi's services for parameters, whose values are JSON."""
        there = self.parameters

        def change(asked: Mapping[str, Any]) -> dict[str, Any]:
            there[asked["name"]] = json.loads(asked["value"])
            return {}

        def delete(asked: Mapping[str, Any]) -> dict[str, Any]:
            there.pop(asked["name"], None)
            return {}

        return {
            "get_param": lambda asked: {"value": json.dumps(_nested(there, asked["name"]))},
            "get_param_names": lambda _: {"names": sorted(there)},
            "set_param": change,
            "delete_param": delete,
        }

    def _endpoints(self, name: str, kind: str) -> list[str]:
        """Return the server's node where any client uses the topic: the clients themselves are not on the graph."""
        topic = self._graph.topics.get(name)
        if topic is None:
            return []
        is_there = topic.is_published if kind == "publishers" else bool(topic.subscribers)
        return [self.nodes[0]] if is_there else []

    def _stamp(self) -> dict[str, int]:
        now = stamp_of(time.time_ns())
        return {"secs": now["sec"], "nsecs": now["nanosec"]} if self._generation == 1 else now

    def _topics(self) -> dict[str, Any]:
        topics = [topic for topic in self._graph.topics.values() if topic.is_there]
        return {"topics": [topic.name for topic in topics], "types": [topic.type_name for topic in topics]}


def _nested(parameters: Mapping[str, Any], name: str) -> Any:
    """Return the parameter of this name, or those below it as a mapping; None where there is none."""
    below = {each.removeprefix(f"{name}/").partition("/")[0] for each in parameters if each.startswith(f"{name}/")}
    return {each: _nested(parameters, f"{name}/{each}") for each in sorted(below)} or parameters.get(name)


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
        "fieldtypes": [each.kind.type_name if isinstance(each.kind, Shape) else each.kind for each in shape.fields],
        "fieldarraylen": [_length(field) for field in shape.fields],
        "examples": ["" for _ in shape.fields],
        "constnames": [],
        "constvalues": [],
    }
    for each in shape.fields:
        if isinstance(each.kind, Shape):
            _describe(each.kind, found)


def _length(field: Field) -> int:
    if field.count is None:
        return -1
    return 0 if isinstance(field.count, UpTo) else field.count
