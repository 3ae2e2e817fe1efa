"""The interface between a graph link and the client library below it, and the errors that all transports share."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from robot_runner.core.errors import LinkError, nearest
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, Qos, RawMessage, Subscription
from robot_runner.ros.shapes import Shape, plain_type

if TYPE_CHECKING:
    import threading

    from robot_runner.ros.action_calls import ActionDialect

#: The longest time that a new participant of ROS 2 takes to discover the graph, s. On Fast DDS (seen with 2.14, packets
#: captured) a process answers a new participant before that listens in every second try, and announces itself again
#: after 3 s; which endpoints a node has comes by another message, which is repeated after 3 s, too.
LONGEST_DISCOVERY = 7.5


class GraphTypes(Protocol):
    """The message and service types that a transport knows; each method raises a `LinkError` for an unknown type."""

    def shape(self, message_type: str) -> Shape:
        """Return the fields of a message type."""

    def request(self, service_type: str) -> Shape:
        """Return the fields of a service type's request."""

    def response(self, service_type: str) -> Shape:
        """Return the fields of a service type's response."""

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by those of the types of its fields."""


class Lane(Enum):
    """Who is called for what was received; no lane waits for another one, and each keeps the order of messages."""

    CALLBACKS = "callbacks"
    PROMPT = "prompt callbacks"
    BYTES = "bytes"
    GOALS = "goals"


class Reception(Protocol):
    """A received message; it is decoded or encoded only where a subscriber asks for that form."""

    def message(self) -> Message:
        """Return the message as a mapping."""

    def raw(self) -> RawMessage:
        """Return the bytes of the message."""


@dataclass(frozen=True, slots=True)
class ReceivedBytes:
    """A message that arrived as bytes, when it did in ns since the epoch, and what turns the bytes into a mapping."""

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
        """Wait until the existing subscribers are connected; return False if they are not in time.

        A subscriber whose QoS requests more than this publisher offers is not counted where others are connected.

        Raises:
            LinkError: no subscriber is connected, as one requests more.
        """

    def is_heard(self) -> bool:
        """Whether a subscriber is connected; True where that is not known."""

    def flush(self, seconds: float) -> None:
        """Return once the connected subscribers have the messages; raise a `LinkError` where one does not take them."""

    def close(self) -> None:
        """Leave the topic."""


class TopicSubscription(Protocol):
    """A subscription of one topic."""

    def explain(self) -> str:
        """Return advice where no message came: one imperative, or nothing; raise a `LinkError` for a known cause."""

    def close(self) -> None:
        """Leave the topic."""


class ClosedBy(NamedTuple):
    """A subscription or an offer that is closed by calling a function; `advice` is for where no message came."""

    leave: Callable[[], object]
    advice: str = ""

    def explain(self) -> str:
        """Return the advice."""
        return self.advice

    def close(self) -> None:
        """Call the function."""
        self.leave()


class Transport(Protocol):
    """The primitives of a client library, on which a `GraphLink` builds everything else.

    Names are full, types are spelt for both generations alike (`std_msgs/String`), messages to be sent have every field
    of their type. Each method raises a `LinkError` where the graph does not allow the operation.

    Attributes:
        types: the types that can be sent and received.
        encoding: of raw messages.
        has_threads: whether callbacks are called from a thread of the transport, where no caller sees their exceptions.
        actions: the graph's protocol of actions.
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
        """Return a publisher, once the existing subscribers are connected."""

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, lane: Lane
    ) -> TopicSubscription:
        """Call `receive` with each message, which is asked for its bytes in the lane for these, and else decoded."""

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service and return its response; `timeout` is in seconds."""

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service; where `answer` raises, the request fails if the graph's protocol has a way to say so."""

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic by full name; an empty text where it is not known."""

    def services(self) -> Mapping[str, str]:
        """Return the type of each service by full name."""

    def nodes(self) -> Iterable[str]:
        """Return the full names of the nodes."""

    def publishers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the publishers of a topic."""

    def subscribers(self, topic: str) -> Iterable[GraphEndpoint]:
        """Return the subscribers of a topic."""

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait at most `seconds` for an event that a callback sets; raise a `LinkError` if the graph is lost."""

    def close(self) -> None:
        """Leave the graph."""


def until(claim: Callable[[], object], seconds: float, *, every: float = 0.02) -> bool:
    """Wait until something holds, for `seconds` at most, looking `every` so many; return whether it does."""
    deadline = time.monotonic() + seconds
    while not claim():
        if time.monotonic() >= deadline:
            return False
        time.sleep(every)
    return True


def is_hidden(name: str) -> bool:
    """Whether ROS 2 hides a name: its lists of nodes and topics leave it out, and so does rosapi.

    Example:
        >>> is_hidden("/navigate_to_pose/_action/status"), is_hidden("/odom")
        (True, False)
    """
    return "/_" in name


def receive_clock(clock: Clock) -> Callable[[], int]:
    """Return a function that gives the stamps of raw messages, ns: this machine's time, or the run's simulated one."""
    if not is_simulated_time(clock):
        return time.time_ns
    # The time that the simulation publishes, as stamps are: a run's clock goes on where a simulator is reset.
    shown: Callable[[], float] = getattr(clock, "shown", clock.now)
    return lambda: int(shown() * 1e9)


def is_simulated_time(clock: Clock) -> bool:
    """Whether a clock is a simulation's; every other clock follows this machine's time, also a wrapped one.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> is_simulated_time(SystemClock())
        False
    """
    return bool(getattr(clock, "is_simulated", False))


def check_type(topic: str, wanted: str, found: Iterable[str], *, owner: str = "") -> None:
    """Refuse, by a `LinkError`, a topic that has another type; `owner` is the node that uses it, where it is known."""
    for true in map(plain_type, found):
        if true != plain_type(wanted):
            problem = f"the topic carries {true}{f' (of {owner})' if owner else ''}, not {plain_type(wanted)}"
            raise LinkError(problem, where=topic, fix=f"Name the type {true!r}, or another topic.")


def silent_publishers(names: Iterable[str]) -> str:
    """Return the advice where these nodes publish a topic and no message came."""
    return f"Check whether {', '.join(sorted(set(names)))}, which publishes it, is alive and reachable from here."


def nobody_publishes(topic: str, known: Iterable[str]) -> str:
    """Return the advice where no node publishes a topic; `known` are the published topics."""
    near = nearest(topic, [name for name in known if name != topic])
    return f"No node publishes {topic!r}: " + (f"did you mean {near!r}?" if near else "start the node that does.")


def link_closed(where: str) -> LinkError:
    """Return the error for an operation on a closed link."""
    return LinkError("the link was closed", where=where, fix="Use it before the run ends.")


def wrong_service_type(service: str, true: str, wanted: str) -> LinkError:
    """Return the error that a service is of another type."""
    problem = f"the service is of the type {true}, not {wanted}"
    return LinkError(problem, where=service, fix=f"Name the type {true!r}.")


def already_offered(name: str, owner: str = "another node", *, what: str = "service") -> LinkError:
    """Return the error that a service or action of this name exists already."""
    fix = "End the other node, or give the robots namespaces of their own."
    return LinkError(f"{owner} offers the {what} {name!r} already", where=name, fix=fix)


def service_timeout(service: str, timeout: float) -> LinkError:
    """Return the error that a service did not answer in time."""
    fix = "Check whether its node is alive and did not fail, or give a longer timeout."
    return LinkError(f"the service does not answer within {timeout:g} s", where=service, fix=fix)
