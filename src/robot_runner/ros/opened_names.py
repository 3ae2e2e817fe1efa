"""The topics that a graph link publishes, and its subscriptions and offers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.commanded_topics import TWISTS, VELOCITIES
from robot_runner.ros.link_faults import as_link_error, do_all
from robot_runner.ros.sent_commands import is_watched, note_sent
from robot_runner.ros.shapes import Shape, completed
from robot_runner.ros.watchdog import velocity_of

if TYPE_CHECKING:
    from robot_runner.core.links.robot import Message, Qos
    from robot_runner.ros.graph_transport import TopicPublisher

#: The timeout for the stop command to reach the robot, s: over two hops of Wi-Fi it takes tenths of a second, and a run
#: must not hang on a robot that is switched off.
_STOPPING_SECONDS = 2.0


@dataclass(slots=True)
class Advertised:
    """A topic that this link publishes with one QoS, and whether velocities are known to have been commanded on it."""

    message_type: str
    shape: Shape
    publisher: TopicPublisher
    is_commanded: bool = False
    _sending: threading.RLock = field(default_factory=threading.RLock)

    @property
    def drives(self) -> bool:
        """Whether it commands velocities, each of which a robot executes until the next one."""
        return self.message_type in VELOCITIES

    @contextmanager
    def sending(self) -> Iterator[None]:
        """Keep other threads from sending on the topic for a while; wait only briefly for one that hangs."""
        is_ours = self._sending.acquire(timeout=_STOPPING_SECONDS)
        try:
            yield
        finally:
            if is_ours:
                self._sending.release()

    def send(self, topic: str, message: Message) -> None:
        """Publish a complete message, and record a command, to distinguish it from those of other nodes."""
        if self.message_type in TWISTS:
            note_sent(topic, velocity_of(self.message_type, message))
        elif is_watched(topic):
            note_sent(topic, message)
        self.publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self.publisher.close()

    def command_zero(self, topic: str) -> None:
        """Command zero on a topic on which a velocity was published; raise a `LinkError` if it cannot be published."""
        with _telling(topic), self.sending():
            self.send(topic, completed(self.shape, {}, where=topic))

    def see_taken(self, topic: str) -> None:
        """Check that the subscribers received the last command; a `LinkError` says they did not, or it failed."""
        with _telling(topic):
            self.publisher.flush(_STOPPING_SECONDS)


@contextmanager
def _telling(topic: str) -> Iterator[None]:
    """Turn exceptions into the error that a robot could not be commanded to stand still."""
    try:
        yield
    except Exception as error:
        fault = as_link_error(error, where=topic)
        problem = f"the robot could not be told to stand still: {fault.problem}"
        raise LinkError(problem, where=topic, fix=f"See that its watchdog stopped it. {fault.fix}") from error


def driven_of(advertised: Mapping[tuple[str, Qos], Advertised]) -> list[tuple[str, Advertised]]:
    """Return the topics on which velocities are, or may have been, commanded, the last one first."""
    return [(topic, each) for (topic, _), each in reversed(list(advertised.items())) if each.drives]


def halt_all(driven: Iterable[tuple[str, Advertised]]) -> None:
    """Command zero on each of these topics, even if another one fails, without waiting.

    Closing a link may wait for a robot that is out of reach, and no other robot may drive on meanwhile.
    """
    for topic, advertised in driven:
        with suppress(Exception):  # closing the link repeats the command, and reports the error
            advertised.command_zero(topic)


def stop_all(driven: Sequence[tuple[str, Advertised]]) -> None:
    """Command zero on all of these topics, then check that it was received, so that no robot drives on meanwhile.

    A topic without a known command is not checked: its subscriber may be gone, which is not a fault.

    Raises:
        LinkError: a command was not received on one of the others, or the client library fails.
    """
    told: list[tuple[str, Advertised]] = []

    def tell(topic: str, advertised: Advertised) -> None:
        advertised.command_zero(topic)
        told.append((topic, advertised))

    halt_all((topic, each) for topic, each in driven if not each.is_commanded)
    telling = (partial(tell, topic, each) for topic, each in driven if each.is_commanded)
    do_all(chain(telling, (partial(each.see_taken, topic) for topic, each in told)))


class Opened:
    """A subscription or an offer of the link, until it is closed."""

    def __init__(self, name: str, type_name: str, forget: Callable[[Opened], None]) -> None:
        self.name = name
        self.type_name = type_name
        self.is_open = True
        self.inner: Any = None
        self.fault_count = 0
        self.has_failed_run = False
        self._forget = forget
        self._closing = threading.Lock()

    def close(self) -> None:
        """End the subscription or offer; closing twice does nothing."""
        with self._closing:
            was_open, self.is_open = self.is_open, False
        if was_open:
            self._forget(self)
            self.inner.close()
