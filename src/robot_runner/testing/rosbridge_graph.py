"""The graph behind the rosbridge server that tests speak to: topics and services, and who is on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.links.rosbridge.conversion import from_protocol, to_protocol
from robot_runner.links.shapes import Shape, completed

if TYPE_CHECKING:
    from robot_runner.links.robot import Message
    from robot_runner.links.type_catalogue import TypeCatalogue

__all__ = ["Graph", "Hearer", "Refusal", "ServedTopic", "received"]


class Refusal(Exception):  # noqa: N818 - what a server says in a status message, which is no error of the test's
    """An operation that a server refuses, in its words."""


class Hearer(Protocol):
    """One who subscribes, publishes or offers: a connection, or the test itself."""

    def hear(self, topic: ServedTopic, message: Message) -> None:
        """Take a message of a topic."""
        ...


@dataclass(slots=True)
class ServedTopic:
    """A topic.

    Attributes:
        name: full name.
        type_name: of its messages.
        publishers: who publishes it, with whether it is latched.
        hearers: who hears it, by name of the subscription.
        last: the last message of a latched topic.
    """

    name: str
    type_name: str
    publishers: dict[int, bool] = field(default_factory=dict)
    hearers: dict[tuple[int, str], Hearer] = field(default_factory=dict)
    last: Message | None = None


@dataclass(frozen=True, slots=True)
class ServedService:
    """A service: its type, and what answers, which is an object with a method for it or a function of the test's."""

    type_name: str
    owner: object
    answer: Callable[[Message], Message] | None = None


class Graph:
    """Topics and services by full name; whoever uses it holds one lock.

    Args:
        types: what messages are made of.
    """

    def __init__(self, types: TypeCatalogue) -> None:
        self.types = types
        self.topics: dict[str, ServedTopic] = {}
        self.services: dict[str, ServedService] = {}

    def advertise(self, name: str, type_name: str, publisher: object, *, is_latched: bool = False) -> None:
        """Take a publisher; raises a `Refusal` where the topic carries another type."""
        self._topic(name, type_name).publishers[id(publisher)] = is_latched

    def unadvertise(self, name: str, publisher: object) -> None:
        """Let a publisher go."""
        if name in self.topics:
            self.topics[name].publishers.pop(id(publisher), None)
            self._tidy(name)

    def publish(self, name: str, message: Message, publisher: object) -> None:
        """Hand a complete message to who hears the topic."""
        topic = self.topics.get(name)
        if topic is None or id(publisher) not in topic.publishers:
            raise Refusal(f"publish: topic {name} is not advertised")
        if topic.publishers[id(publisher)]:
            topic.last = message
        for hearer in {id(each): each for each in topic.hearers.values()}.values():
            hearer.hear(topic, message)

    def subscribe(self, name: str, type_name: str | None, hearer: Hearer, label: str) -> None:
        """Take a hearer; raises a `Refusal` where the topic carries another type."""
        if type_name is None and name not in self.topics:
            raise Refusal(f"subscribe: cannot infer the type of topic {name}, which is not published yet")
        topic = self._topic(name, type_name or self.topics[name].type_name)
        topic.hearers[id(hearer), label] = hearer
        if topic.last is not None:
            hearer.hear(topic, topic.last)

    def unsubscribe(self, name: str, hearer: Hearer, label: str | None) -> None:
        """Let a hearer go, from one subscription or, without its label, from all of the topic."""
        topic = self.topics.get(name)
        if topic is not None:
            for key in [key for key in topic.hearers if key[0] == id(hearer) and label in {None, key[1]}]:
                del topic.hearers[key]
            self._tidy(name)

    def forget(self, who: Hearer) -> None:
        """Let somebody go from everywhere."""
        for name in list(self.topics):
            self.unsubscribe(name, who, None)
            self.unadvertise(name, who)
        for name in [name for name, service in self.services.items() if service.owner is who]:
            del self.services[name]

    def _topic(self, name: str, type_name: str) -> ServedTopic:
        topic = self.topics.get(name)
        if topic is None:
            topic = self.topics[name] = ServedTopic(name, type_name)
        if topic.type_name != type_name:
            raise Refusal(
                f"Tried to register topic {name} with type {type_name} but it is already established with type "
                f"{topic.type_name}"
            )
        return topic

    def _tidy(self, name: str) -> None:
        if not self.topics[name].publishers and not self.topics[name].hearers:
            del self.topics[name]


def received(shape: Shape, values: object, *, where: str) -> dict[str, Any]:
    """Return a message of the protocol, which may lack fields, as a complete one of ours.

    Raises:
        Refusal: it has a field that the type has not.
        LinkError: a value is not of its field's kind.
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
