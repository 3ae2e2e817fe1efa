"""What a graph link has opened: the topics that it publishes, and its subscriptions and offers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.sent_commands import note_sent
from robot_runner.ros.shapes import Shape, completed

if TYPE_CHECKING:
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

    @contextmanager
    def sending(self) -> Iterator[None]:
        """While it lasts, no other thread sends on the topic; one that is stuck is not waited for for long."""
        is_ours = self._sending.acquire(timeout=_STOPPING_SECONDS)
        try:
            yield
        finally:
            if is_ours:
                self._sending.release()

    def stop(self, topic: str) -> None:
        """Command zero on a topic on which a velocity was published, and see that it is taken.

        Raises:
            LinkError: nobody takes it.
        """
        try:
            note_sent(topic, (0.0, 0.0))
            with self.sending():
                self.publisher.publish(completed(self.shape, {}, where=topic))
            self.publisher.flush(_STOPPING_SECONDS)
        except LinkError as error:
            problem = f"the robot could not be told to stand still: {error.problem}"
            raise LinkError(problem, where=topic, fix=f"See that its watchdog stopped it. {error.fix}") from error


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

    def close(self) -> None:
        """Receive no more; closing twice does nothing."""
        if self.is_open:
            self.is_open = False
            self._forget(self)
            self.inner.close()
