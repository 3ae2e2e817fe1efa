"""What is published over a rosbridge."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.links.robot import Qos
from robot_runner.links.rosbridge.conversion import to_protocol
from robot_runner.links.rosbridge.subscriptions import check_type
from robot_runner.links.shapes import completed, plain_type
from robot_runner.links.velocity_commands import VELOCITY_COMMANDS

if TYPE_CHECKING:
    from robot_runner.links.robot import Message
    from robot_runner.links.rosbridge.robot_types import RobotTypes
    from robot_runner.links.rosbridge.rosapi import Rosapi
    from robot_runner.links.rosbridge.session import Session
    from robot_runner.links.shapes import Shape

__all__ = ["Publishers"]


@dataclass(frozen=True, slots=True)
class _Publisher:
    message_type: str
    shape: Shape
    is_latched: bool
    request_id: str


class Publishers:
    """All that is published over one session.

    Args:
        session: over which messages go.
        types: of the robot.
        rosapi: of the robot.
    """

    def __init__(self, session: Session, types: RobotTypes, rosapi: Rosapi) -> None:
        self._session = session
        self._types = types
        self._rosapi = rosapi
        self._lock = threading.Lock()
        self._publishers: dict[str, _Publisher] = {}
        self._driven: dict[str, str] = {}

    def publish(self, name: str, message_type: str, message: Message, qos: Qos) -> None:
        """Publish a message on a topic, by its full name.

        Raises:
            LinkError: the topic carries another type, or the message does not follow its definition.
        """
        self._session.check_open(name)
        with self._lock:
            publisher = self._publisher(name, message_type, message, is_latched=qos is Qos.TRANSIENT_LOCAL)
            if publisher.message_type in VELOCITY_COMMANDS:
                self._driven[name] = message_type
        complete = completed(publisher.shape, message, where=name)
        self._session.send({"op": "publish", "topic": name, "msg": to_protocol(publisher.shape, complete)})

    def stop_what_was_driven(self) -> None:
        """Command zero on each topic on which a velocity was, and see that the server has taken it.

        Raises:
            LinkError: the connection is lost.
        """
        for name, message_type in self._driven.items():
            self.publish(name, message_type, {}, Qos.DEFAULT)
        for name in self._driven:
            publisher = self._publishers[name]
            self._session.request({"op": "unadvertise", "id": publisher.request_id, "topic": name}, where=name)

    def _publisher(self, name: str, message_type: str, message: Message, *, is_latched: bool) -> _Publisher:
        known = self._publishers.get(name)
        if known is not None:
            check_type(name, message_type, known.message_type)
            if known.is_latched or not is_latched:
                return known
        shape = self._types.shape(message_type)
        completed(shape, message, where=name)  # refused before the graph hears of it
        check_type(name, message_type, self._rosapi.topic_type(name))
        if known is not None:
            self._session.send({"op": "unadvertise", "id": known.request_id, "topic": name})
        fresh = _Publisher(plain_type(message_type), shape, is_latched, self._session.fresh_id("advertise"))
        self._session.request(
            {
                "op": "advertise",
                "id": fresh.request_id,
                "topic": name,
                "type": self._types.wire_name(message_type),
                "latch": is_latched,
            },
            where=name,
        )
        self._rosapi.confirm_publisher(name, message_type)
        self._publishers[name] = fresh
        return fresh
