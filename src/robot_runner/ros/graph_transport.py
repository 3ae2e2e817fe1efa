"""What a graph link asks of the client library below it, and the errors that all transports raise alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from robot_runner.core.errors import LinkError, nearest
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, Qos, RawMessage, Subscription
from robot_runner.ros.shapes import Shape, plain_type

if TYPE_CHECKING:
    import threading

    from robot_runner.ros.action_calls import ActionDialect

#: How long it takes at most until a graph of ROS 2 is known to who has just joined it, s. On Fast DDS (seen with 2.14,
#: packets captured) a process answers a newcomer before that hears it in every second try, and tells of itself again
#: after 3 s; which node has what comes by another message, which is repeated after 3 s, too.
LONGEST_DISCOVERY = 7.5


class GraphTypes(Protocol):
    """The message and service types that a transport knows; each method raises a `LinkError` for an unknown type."""

    def shape(self, message_type: str) -> Shape:
        """Return what a message type is made of."""

    def request(self, service_type: str) -> Shape:
        """Return what the request of a service type is made of."""

    def response(self, service_type: str) -> Shape:
        """Return what the response of a service type is made of."""

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by the types that it is made of."""


class Reception(Protocol):
    """One message as it arrived; it is decoded or encoded only where a subscriber asks for that form."""

    def message(self) -> Message:
        """Return the message as a mapping."""

    def raw(self) -> RawMessage:
        """Return the bytes of the message."""


@dataclass(frozen=True, slots=True)
class ReceivedBytes:
    """A message that arrived as bytes.

    Attributes:
        data: the message's bytes.
        received_ns: when it arrived, ns since the epoch.
        decode: turns the bytes into a mapping.
    """

    data: bytes
    received_ns: int
    decode: Callable[[bytes], Message]

    def message(self) -> Message:
        """Return the message as a mapping."""
        return self.decode(self.data)

    def raw(self) -> RawMessage:
        """Return the bytes as they arrived."""
        return RawMessage(self.data, self.received_ns)


class TopicPublisher(Protocol):
    """A publisher of one topic."""

    def publish(self, message: Message) -> None:
        """Publish a message that has every field of its type."""

    def reach(self) -> bool:
        """Return whether the subscribers that are there would receive what is published, once they do; False if late.

        A subscriber that asks for more than this publisher offers is not counted.
        """

    def flush(self, seconds: float) -> None:
        """Return once the reachable subscribers have what was published; raise a `LinkError` where one refuses it."""

    def close(self) -> None:
        """Leave the topic."""


class TopicSubscription(Protocol):
    """A subscription of one topic."""

    def explain(self) -> str:
        """Say what to do where no message came: one imperative, or nothing; raise a `LinkError` for a known cause."""

    def close(self) -> None:
        """Leave the topic."""


class ClosedBy(NamedTuple):
    """A subscription or an offer that ends by calling a function, and says `advice` where no message came."""

    leave: Callable[[], object]
    advice: str = ""

    def explain(self) -> str:
        """Return the advice."""
        return self.advice

    def close(self) -> None:
        """Call the function."""
        self.leave()


class Transport(Protocol):
    """The primitives that a client library gives to a `GraphLink`, which owns all else.

    Names are full, types are spelt without a generation, messages to be sent have every field of their type. Each
    method raises a `LinkError` where the graph does not allow it.

    Attributes:
        types: the types that can be sent and received.
        encoding: how the bytes of raw messages are laid out.
        has_threads: whether callbacks are called from a thread of the transport, where nobody sees what they raise.
        actions: how the graph speaks of actions.
    """

    @property
    def types(self) -> GraphTypes: ...  # noqa: D102 - see above

    @property
    def encoding(self) -> Encoding: ...  # noqa: D102 - see above

    @property
    def has_threads(self) -> bool: ...  # noqa: D102 - see above

    @property
    def actions(self) -> ActionDialect: ...  # noqa: D102 - see above

    def advertise(self, topic: str, message_type: str, qos: Qos) -> TopicPublisher:
        """Return a publisher, once the subscribers that are there already are reached."""

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, is_raw: bool
    ) -> TopicSubscription:
        """Have `receive` called with each message; `is_raw` says which form of it will be asked for."""

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service and return its response; `timeout` is in seconds."""

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service; a request at which `answer` raises is refused where the graph has a way to say so."""

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic by full name; an empty text where the graph does not tell."""

    def services(self) -> Mapping[str, str]:
        """Return the type of each service by full name."""

    def nodes(self) -> Iterable[str]:
        """Return the full names of the nodes."""

    def publishers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return who publishes a topic."""

    def subscribers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return who subscribes a topic."""

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait for an event that a callback sets, for so long at most; raise a `LinkError` if the graph is lost."""

    def close(self) -> None:
        """Leave the graph."""


def is_hidden(name: str) -> bool:
    """Whether a name is one that ROS 2 hides: its lists of nodes and topics leave it out, and so does rosapi.

    Example:
        >>> is_hidden("/navigate_to_pose/_action/status"), is_hidden("/odom")
        (True, False)
    """
    return "/_" in name


def receive_clock(clock: Clock) -> Callable[[], int]:
    """Return what stamps raw messages, in ns: this machine's time, or a simulation's where the run has one."""
    if not is_simulated_time(clock):
        return time.time_ns
    # What the simulation tells, as stamps do: a run's clock goes on where a simulator is reset.
    shown: Callable[[], float] = getattr(clock, "shown", clock.now)
    return lambda: int(shown() * 1e9)


def is_simulated_time(clock: Clock) -> bool:
    """Whether a clock is a simulation's; every other clock follows this machine's time, also where it is wrapped.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> is_simulated_time(SystemClock())
        False
    """
    return bool(getattr(clock, "is_simulated", False))


def check_type(topic: str, wanted: str, found: Iterable[str], *, owner: str = "") -> None:
    """Refuse a topic that already carries another type; `owner` is the node that has it, where that is known.

    Raises:
        LinkError: one of them is another.
    """
    for true in found:
        if plain_type(true) != plain_type(wanted):
            fix = f"Name the type {plain_type(true)!r}, or another topic."
            known = f"{plain_type(true)} (of {owner})" if owner else plain_type(true)
            problem = f"the topic carries {known}, not {plain_type(wanted)}"
            raise LinkError(problem, where=topic, fix=fix)


def silent_publishers(names: Iterable[str]) -> str:
    """Say what to do where these nodes publish a topic and nothing came."""
    return f"Look whether {', '.join(sorted(set(names)))}, which publishes it, is alive and reachable from here."


def nobody_publishes(topic: str, known: Iterable[str]) -> str:
    """Say what to do where nobody publishes a topic; `known` are the topics that are published."""
    near = nearest(topic, [name for name in known if name != topic])
    return f"Nobody publishes {topic!r}: " + (f"did you mean {near!r}?" if near else "start the node that does.")


def link_closed(where: str) -> LinkError:
    """Return the error that something is to be done over a link that was closed."""
    return LinkError("the link was closed", where=where, fix="Use it before the run ends.")


def wrong_service_type(service: str, true: str, wanted: str) -> LinkError:
    """Return the error that a service is of another type."""
    problem = f"the service is of the type {true}, not {wanted}"
    return LinkError(problem, where=service, fix=f"Name the type {true!r}.")


def already_offered(name: str, owner: str = "another node", *, what: str = "service") -> LinkError:
    """Return the error that a service or action of this name is there already."""
    fix = "End the other node, or give the robots namespaces of their own."
    return LinkError(f"{owner} offers the {what} {name!r} already", where=name, fix=fix)


def service_timeout(service: str, timeout: float) -> LinkError:
    """Return the error that a service did not answer in time."""
    fix = "Look whether its node is alive and did not fail, or give a longer timeout."
    return LinkError(f"the service does not answer within {timeout:g} s", where=service, fix=fix)
