"""A topic that the robot publishes: its messages are made only while somebody hears them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.simulator.clock import SimulatedClock, Ticker

    Listener = Callable[[dict[str, Any]], None]

__all__ = ["Listening", "PublishedTopic"]


class PublishedTopic:
    """A topic with its type, its rate and who hears it.

    Args:
        clock: the simulation's clock.
        message_type: ROS name, such as `nav_msgs/Odometry`.
        rate: messages a second.
        make: makes the message of this moment.
    """

    def __init__(self, clock: SimulatedClock, message_type: str, rate: int, make: Callable[[], dict[str, Any]]) -> None:
        self.message_type = message_type
        self._clock = clock
        self._rate = rate
        self._make = make
        self._listeners: dict[Listening, Listener] = {}
        self._ticker: Ticker | None = None

    def listen(self, listener: Listener) -> Listening:
        """Have `listener` called with each message while the clock is slept on, until the listening is closed."""
        listening = Listening(self)
        self._listeners[listening] = listener
        if self._ticker is None:
            self._ticker = self._clock.every(self._rate, self._publish)
        return listening

    def forget(self, listening: Listening) -> None:
        """Call this listener no more; a topic that nobody hears is no longer computed."""
        self._listeners.pop(listening, None)
        if not self._listeners and self._ticker is not None:
            self._ticker.close()
            self._ticker = None

    def _publish(self) -> None:
        message = self._make()
        for listening, listener in tuple(self._listeners.items()):
            if listening in self._listeners:  # a listener before it may have ended it
                listener(message)


class Listening:
    """Somebody who hears a topic."""

    def __init__(self, topic: PublishedTopic) -> None:
        self._topic = topic

    def close(self) -> None:
        """Hear no more messages; closing twice does nothing."""
        self._topic.forget(self)
