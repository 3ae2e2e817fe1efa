"""What a graph link has opened: the topics that it publishes, and its subscriptions and offers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.link_faults import as_link_error
from robot_runner.ros.sent_commands import is_watched, note_sent
from robot_runner.ros.shapes import Shape, completed
from robot_runner.ros.watchdog import VELOCITY_COMMANDS, planar, velocity_of

if TYPE_CHECKING:
    from robot_runner.core.links.robot import Message
    from robot_runner.ros.graph_transport import TopicPublisher

#: How long the last command, to stand still, may take to reach the robot, s: a robot two hops of Wi-Fi away takes it
#: within tenths, and a run must not hang on one that is switched off.
_STOPPING_SECONDS = 2.0


@dataclass(frozen=True, slots=True)
class Advertised:
    """A topic that this link publishes with one QoS."""

    message_type: str
    shape: Shape
    publisher: TopicPublisher
    _sending: threading.RLock = field(default_factory=threading.RLock)

    @property
    def drives(self) -> bool:
        """Whether it commands a velocity, which a robot carries out until the next one."""
        return self.message_type in VELOCITY_COMMANDS

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

    def stop(self, topic: str) -> None:
        """Command zero on a topic on which a velocity was published, and see that it is taken.

        Raises:
            LinkError: nobody takes it, or the client library fails at it.
        """
        try:
            with self.sending():
                self.send(topic, completed(self.shape, {}, where=topic))
            self.publisher.flush(_STOPPING_SECONDS)
        except Exception as error:
            fault = as_link_error(error, where=topic)
            problem = f"the robot could not be told to stand still: {fault.problem}"
            raise LinkError(problem, where=topic, fix=f"See that its watchdog stopped it. {fault.fix}") from error


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
