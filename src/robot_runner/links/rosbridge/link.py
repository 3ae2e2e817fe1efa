"""The link to a robot behind a rosbridge."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.events.clock import SystemClock
from robot_runner.links.graph_names import full_name
from robot_runner.links.listening import first_message
from robot_runner.links.robot import Qos
from robot_runner.links.rosbridge.publishers import Publishers
from robot_runner.links.rosbridge.robot_types import RobotTypes
from robot_runner.links.rosbridge.rosapi import Rosapi
from robot_runner.links.rosbridge.services import Services
from robot_runner.links.rosbridge.session import Session
from robot_runner.links.rosbridge.subscriptions import Subscriptions

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import Encoding, Message, RawMessage, Subscription
    from robot_runner.links.rosbridge.address import RosbridgeAddress

__all__ = ["RosbridgeRobotLink"]

_logger = logging.getLogger(__name__)


class RosbridgeRobotLink:
    """A robot on a graph of ROS 1 or ROS 2, reached through the rosbridge server that runs there.

    A rosbridge fits its own subscriptions to what a topic's publishers offer; of `qos` it takes `TRANSIENT_LOCAL`, for
    what is published.

    Example:
        >>> from robot_runner.events.clock import SystemClock
        >>> from robot_runner.links.rosbridge.address import RosbridgeAddress
        >>> address = RosbridgeAddress.parse("rosbridge://robot:9090")
        >>> link = RosbridgeRobotLink(address, SystemClock())  # doctest: +SKIP
        >>> link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})  # doctest: +SKIP
        >>> link.close()  # doctest: +SKIP
    """

    def __init__(self, address: RosbridgeAddress, clock: Clock, *, namespace: str = "") -> None:
        """Connect.

        Raises:
            LinkError: it cannot be reached, is no rosbridge, or does not tell its generation of ROS.
        """
        full_name(namespace, "topic")  # refused before anything is opened
        self._namespace = namespace
        # A clock that is not this machine's is a simulation's, whose time the messages are stamped by.
        now_ns = time.time_ns if isinstance(clock, SystemClock) else lambda: int(clock.now() * 1e9)
        self._is_closed = False
        self._session = Session(address)
        try:
            self._rosapi = Rosapi(self._session)
            self._types = RobotTypes(self._rosapi, address)
        except LinkError:
            self._session.close()
            raise
        self._subscriptions = Subscriptions(self._session, self._types, self._rosapi, now_ns)
        self._publishers = Publishers(self._session, self._types, self._rosapi)
        self._services = Services(self._session, self._types, self._rosapi)

    @property
    def is_simulated(self) -> bool:
        """Never: what is behind a graph cannot be told from it."""
        return False

    @property
    def encoding(self) -> Encoding:
        """That of the robot's generation of ROS."""
        return self._types.encoding

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message.

        Raises:
            LinkError: the topic carries another type, the message does not follow its definition, or the connection is
                lost.
        """
        self._publishers.publish(full_name(self._namespace, topic), message_type, message, qos)

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic, in a thread of the link.

        Raises:
            LinkError: the topic carries another type, there is no such type, or the connection is lost.
        """
        return self._listen(topic, message_type, callback, qos)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic; as `subscribe` in all else."""
        name = full_name(self._namespace, topic)
        self._session.check_open(name)
        return self._subscriptions.listen(name, message_type, callback, qos=qos, is_raw=True)

    def wait_for(
        self,
        topic: str,
        message_type: str,
        condition: Callable[[Message], bool] | None = None,
        *,
        timeout: float = 5.0,
    ) -> Message:
        """Return the first message from now on that satisfies the condition; `timeout` is in seconds.

        Raises:
            LinkError: none came in time, the connection is lost, or as `subscribe`.
        """
        return first_message(
            lambda hear: self._listen(topic, message_type, hear, None),
            condition,
            timeout=timeout,
            where=full_name(self._namespace, topic),
            wait=self._session.wait,
        )

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds.

        Raises:
            LinkError: there is no such service, it has another type, it does not answer in time, or the request does
                not follow its definition.
        """
        return self._services.call(full_name(self._namespace, service), service_type, request or {}, timeout)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; requests are answered in threads of their own.

        Raises:
            LinkError: there is no such type, or somebody offers a service of this name already.
        """
        return self._services.offer(full_name(self._namespace, service), service_type, answer)

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic on the graph, by its full name; `*` where the graph does not tell.

        Raises:
            LinkError: rosapi does not run beside the server.
        """
        heard = self._subscriptions.types()
        return {name: told or heard.get(name, "*") for name, told in self._rosapi.topics().items()}

    def services(self) -> Mapping[str, str]:
        """Return the type of each service on the graph, by its full name; raises as `topics`."""
        return self._rosapi.services()

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted; raises as `topics`."""
        return sorted(self._rosapi.nodes())

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, with those that it is made of after it.

        Raises:
            LinkError: neither the catalogue nor the robot knows the type.
        """
        return self._types.definition(message_type)

    def close(self) -> None:
        """Stop what was driven, end all subscriptions and offers, and leave; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            if self._session.is_usable:
                self._publishers.stop_what_was_driven()
                self._services.close()
        except LinkError as error:
            _logger.warning("the robot could not be told to stop, its watchdog must do so: %s", error)
        finally:
            self._session.close()

    def _listen(
        self, topic: str, message_type: str, callback: Callable[[Message], None], qos: Qos | None
    ) -> Subscription:
        name = full_name(self._namespace, topic)
        self._session.check_open(name)
        return self._subscriptions.listen(name, message_type, callback, qos=qos, is_raw=False)
