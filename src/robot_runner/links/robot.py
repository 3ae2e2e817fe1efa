"""What a link to a robot can do, whatever stands behind it: ROS 1, ROS 2, rosbridge or the embedded simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

__all__ = ["Message", "RobotLink", "Subscription"]

#: A ROS message as a plain mapping that follows its definition: `{"linear": {"x": 0.2, ...}, "angular": {...}}`.
Message = Mapping[str, Any]


@runtime_checkable
class Subscription(Protocol):
    """A subscription that can be ended."""

    def close(self) -> None:
        """Hear no more messages; closing twice does nothing."""
        ...


@runtime_checkable
class RobotLink(Protocol):
    """A link to one robot. Names are relative to the robot's namespace unless they begin with `/`.

    Message types are ROS names without a generation, such as `geometry_msgs/Twist`. Callbacks may be
    called from another thread; on the simulated link they are called while the clock is slept on.
    """

    @property
    def is_simulated(self) -> bool:
        """Whether there is a simulation behind it, so that what it yields is labelled so."""
        ...

    def publish(self, topic: str, message_type: str, message: Message) -> None:
        """Publish one message; fields that are left out take their ROS default.

        Raises:
            LinkError: the robot cannot be reached, or the message does not follow its definition.
        """
        ...

    def subscribe(self, topic: str, message_type: str, callback: Callable[[Message], None]) -> Subscription:
        """Have `callback` called with each message of the topic.

        Raises:
            LinkError: there is no such topic, or it carries another type.
        """
        ...

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds.

        Raises:
            LinkError: there is no such service, or it does not answer in time.
        """
        ...

    def close(self) -> None:
        """End all subscriptions and leave; closing twice does nothing."""
        ...
