"""What a graph link has opened: the topics that it publishes, and its subscriptions and offers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.commanded_topics import VELOCITIES, tell_commanded
from robot_runner.ros.link_faults import as_link_error, do_all
from robot_runner.ros.sent_commands import is_watched, note_sent
from robot_runner.ros.shapes import Shape, completed
from robot_runner.ros.watchdog import planar, velocity_of

if TYPE_CHECKING:
    from robot_runner.core.links.robot import Message, Qos
    from robot_runner.ros.graph_transport import TopicPublisher

#: How long the last command, to stand still, may take to reach the robot, s: a robot two hops of Wi-Fi away takes it
#: within tenths, and a run must not hang on one that is switched off.
_STOPPING_SECONDS = 2.0


@dataclass(slots=True)
class Advertised:
    """A topic that this link publishes with one QoS.

    Attributes:
        is_commanded: whether velocities are commanded there, as far as is known.
    """

    message_type: str
    shape: Shape
    publisher: TopicPublisher
    is_commanded: bool = False
    _sending: threading.RLock = field(default_factory=threading.RLock)

    @property
    def drives(self) -> bool:
        """Whether it commands a velocity, which a robot carries out until the next one."""
        return self.message_type in VELOCITIES

    def command(self, topic: str) -> None:
        """Take down that velocities are commanded there, if it has these, and tell who stands by for this process."""
        if self.drives and not self.is_commanded:
            self.is_commanded = True
            tell_commanded(topic, self.message_type)

    @contextmanager
    def sending(self) -> Iterator[None]:
        """While it lasts, no other thread sends on the topic; one that is stuck is not waited for for long."""
        is_ours = self._sending.acquire(timeout=_STOPPING_SECONDS)
        try:
            yield
        finally:
            if is_ours:
                self._sending.release()

    def send(self, topic: str, message: Message) -> None:
        """Publish a message that has every field, and note a command, so that it is told from those of others."""
        if self.drives:
            note_sent(topic, planar(velocity_of(self.message_type, message)))
        elif is_watched(topic):
            note_sent(topic, message)
        self.publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self.publisher.close()

    def command_zero(self, topic: str) -> None:
        """Command zero on a topic on which a velocity was published.

        Raises:
            LinkError: it cannot be published.
        """
        with _telling(topic), self.sending():
            self.send(topic, completed(self.shape, {}, where=topic))

    def see_taken(self, topic: str) -> None:
        """See that the last command was taken.

        Raises:
            LinkError: nobody takes it, or the client library fails at it.
        """
        with _telling(topic):
            self.publisher.flush(_STOPPING_SECONDS)


@contextmanager
def _telling(topic: str) -> Iterator[None]:
    """While this lasts, whatever fails is an error that a robot could not be told to stand still."""
    try:
        yield
    except Exception as error:
        fault = as_link_error(error, where=topic)
        problem = f"the robot could not be told to stand still: {fault.problem}"
        raise LinkError(problem, where=topic, fix=f"See that its watchdog stopped it. {fault.fix}") from error


def driven_of(advertised: Mapping[tuple[str, Qos], Advertised]) -> list[tuple[str, Advertised]]:
    """Return the topics on which velocities are commanded, or may have been, the last one first."""
    return [(topic, each) for (topic, _), each in reversed(list(advertised.items())) if each.drives]


def halt_all(driven: Iterable[tuple[str, Advertised]]) -> None:
    """Command zero on each of these topics, whatever fails at another, and wait for nothing.

    Closing a link may wait for a robot that is out of reach, and no other one is to drive on meanwhile.
    """
    for topic, advertised in driven:
        with suppress(Exception):  # it is commanded once more as the link is closed, and told then
            advertised.command_zero(topic)


def stop_all(driven: Sequence[tuple[str, Advertised]]) -> None:
    """Command zero on each of these topics, and then see that it is taken: no robot drives on while another is awaited.

    Where nobody is known to have commanded, it is not awaited: who subscribes there may be gone, and that is no fault.

    Raises:
        LinkError: nobody takes one of the others, or the client library fails at it.
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
        """Receive no more; closing twice does nothing."""
        with self._closing:
            was_open, self.is_open = self.is_open, False
        if was_open:
            self._forget(self)
            self.inner.close()
