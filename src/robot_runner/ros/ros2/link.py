"""Opens a link over rclpy, and says what stands in its way; nothing of ROS is loaded before."""

from __future__ import annotations

import importlib.util
import os
import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Encoding, Qos
from robot_runner.ros.graph_links import full_name, namespace_prefix
from robot_runner.ros.listening import first_message
from robot_runner.ros.ros2.message_types import definition_of, message_class, shape_of
from robot_runner.ros.ros2.node import Graph, join_graph
from robot_runner.ros.ros2.services import OfferedService, ServiceClient
from robot_runner.ros.ros2.topics import TopicPublisher, TopicSubscription
from robot_runner.ros.ros_environment import find_ros
from robot_runner.ros.shapes import completed, plain_type
from robot_runner.ros.watchdog import VELOCITY_COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import Message, RawMessage, RobotLink, RobotName, Subscription

__all__ = ["Ros2RobotLink", "findings", "open_ros2_link"]


# The link to a robot on a graph of ROS 2, where a ROS 2 is sourced.

#: How long the last command, to stand still, may take to be received, s.
_STOPPING = 2.0


class Ros2RobotLink:
    """A link to one robot of a graph of ROS 2, over rclpy; the process is one node, whatever the number of robots.

    Args:
        domain: DDS domain id; None for what ROS_DOMAIN_ID says.
        clock: the run's; where it is not this machine's, the node lives by the time on `/clock`.
        namespace: the robot's.

    Raises:
        LinkError: the graph cannot be joined.

    Example:
        ```python
        link = Ros2RobotLink(None, SystemClock(), namespace="/alice")
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        link.close()  # the robot stands still
        ```
    """

    def __init__(self, domain: int | None, clock: Clock, *, namespace: str = "") -> None:
        self._namespace = namespace_prefix(namespace)
        self._is_simulated = not isinstance(clock, SystemClock)
        self._now_ns = (lambda: int(clock.now() * 1e9)) if self._is_simulated else time.time_ns
        self._lock = threading.RLock()
        self._publishers: dict[tuple[str, Qos], TopicPublisher] = {}
        self._clients: dict[tuple[str, str], ServiceClient] = {}
        self._closing = ExitStack()
        self._is_closed = False
        self._node = join_graph(domain, use_sim_time=self._is_simulated)
        self._graph = Graph(self._node)

    @property
    def is_simulated(self) -> bool:
        """Whether the run lives by the time of a simulation, on `/clock`."""
        return self._is_simulated

    @property
    def encoding(self) -> Encoding:
        """CDR."""
        return Encoding.CDR

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message; at first use of a topic, once those who hear it already are reached.

        Raises:
            LinkError: the message does not follow its definition, or the topic carries another type.
        """
        name = self._name(topic)
        with self._lock:
            publisher = self._publishers.get((name, qos))
            if publisher is None or publisher.message_type != plain_type(message_type):
                publisher = self._new_publisher(name, message_type, message, qos)
        publisher.publish(message)

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic, in a thread of the link.

        Raises:
            LinkError: there is no such type, the topic carries another, or its publishers offer less than `qos`.
        """
        return self.subscribe_raw(topic, message_type, TopicSubscription.of_messages(message_type, callback), qos=qos)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic; as `subscribe` in all else."""
        return self._subscribe(self._name(topic), message_type, callback, qos)

    def wait_for(
        self,
        topic: str,
        message_type: str,
        condition: Callable[[Message], bool] | None = None,
        *,
        timeout: float = 5.0,
    ) -> Message:
        """Return the first message from now on that satisfies the condition; `timeout` is in seconds of this machine.

        Raises:
            LinkError: none came in time, or as `subscribe`.
        """
        name = self._name(topic)
        opened: list[TopicSubscription] = []

        def subscribe(hear: Callable[[Message], None]) -> Subscription:
            opened.append(self._subscribe(name, message_type, TopicSubscription.of_messages(message_type, hear), None))
            return opened[0]

        return first_message(
            subscribe,
            condition,
            timeout=timeout,
            where=name,
            explain=lambda: opened[0].explain(),  # noqa: PLW0108  # there is none before it is subscribed
        )

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds of this machine.

        Raises:
            LinkError: there is no such service, it has another type, it does not answer in time, or the request does
                not follow its definition.
        """
        name = self._name(service)
        with self._lock:
            key = name, plain_type(service_type)
            if key not in self._clients:
                self._clients[key] = ServiceClient(self._node, self._graph, name, service_type)
            client = self._clients[key]
        return client.call(request or {}, timeout)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; `answer` is called in a thread of the link.

        Raises:
            LinkError: there is no such type, or somebody offers a service of this name already.
        """
        offered = OfferedService(self._node, self._graph, self._name(service), service_type, answer)
        self._closing.callback(offered.close)
        return offered

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that is published or heard on the graph, by its full name."""
        self._check_open("the graph")
        return self._graph.topics()

    def services(self) -> Mapping[str, str]:
        """Return the type of each service that a node offers, by its full name."""
        self._check_open("the graph")
        return self._graph.services()

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted."""
        self._check_open("the graph")
        return self._graph.nodes()

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, with those that it is made of after it.

        Raises:
            LinkError: there is no such type, or its package has no text of it.
        """
        return definition_of(message_type)

    def close(self) -> None:
        """Stop the robot if it was driven; end all subscriptions and offers and leave; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        with ExitStack() as closing:
            closing.callback(self._node.leave)
            closing.callback(self._closing.close)
            for publisher in self._publishers.values():
                closing.callback(publisher.close)
                if publisher.message_type in VELOCITY_COMMANDS:
                    closing.callback(publisher.flush, _STOPPING)
                    closing.callback(publisher.publish, {})

    def _subscribe(
        self, name: str, message_type: str, callback: Callable[[RawMessage], None], qos: Qos | None
    ) -> TopicSubscription:
        subscription = TopicSubscription(
            self._node, self._graph, name, message_type, callback, qos=qos, now_ns=self._now_ns
        )
        self._closing.callback(subscription.close)
        return subscription

    def _new_publisher(self, name: str, message_type: str, message: Message, qos: Qos) -> TopicPublisher:
        completed(shape_of(message_class(message_type)), message, where=name)  # before the graph hears of it
        publisher = TopicPublisher(self._node, self._graph, name, message_type, qos)
        self._publishers[name, qos] = publisher
        return publisher

    def _name(self, given: str) -> str:
        name = full_name(self._namespace, given)
        self._check_open(name)
        return name

    def _check_open(self, where: str) -> None:
        if self._is_closed:
            raise LinkError("the link was closed", where=where, fix="Use it before the run ends.")


_OPTIONS = ("domain",)
_WITHOUT_ROS = "or reach the robot without a ROS: robot = 'dds'"
#: Domains above this have UDP ports past 65535 (RTPS 2.2, 9.6.1.1: 7400 + 250 · domain + …).
_MAX_DOMAIN = 232


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name over ROS 2; nothing is opened by asking."""
    try:
        _domain(name.options)
        _check_installed()
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_ros2_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph and return the link to the robot of this namespace.

    Args:
        options: `domain`: DDS domain id; left out, what ROS_DOMAIN_ID says.
        clock: the run's; where it is not this machine's, the node lives by the time on `/clock`.
        namespace: the robot's, such as `/alice`.

    Raises:
        LinkError: an option cannot have its value, no ROS 2 is sourced, or the graph cannot be joined.
    """
    domain = _domain(options)
    _check_installed()

    return Ros2RobotLink(domain, clock, namespace=namespace)


def _domain(options: Mapping[str, str]) -> int | None:
    for name in options:
        if name not in _OPTIONS:
            raise LinkError(f"ros2 has no option {name!r}", where="robot", fix=did_you_mean(name, _OPTIONS))
    named = "domain" in options
    text = options["domain"] if named else os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= _MAX_DOMAIN):
        raise LinkError(
            f"the domain id is {text!r}",
            where="robot" if named else "ROS_DOMAIN_ID",
            fix=f"Give a whole number from 0 to {_MAX_DOMAIN}, the ROS_DOMAIN_ID of the robot.",
        )
    return int(text) if named else None


def _check_installed() -> None:
    ros = find_ros()
    if ros is not None and ros.version == 1:
        raise LinkError(
            f"robot is reached over ROS 2, but ROS 1 {ros.distro or ''} is sourced, whose messages hide those of ROS 2",
            where=ros.source,
            fix=f"Start anew in a shell where a ROS 2 is sourced, {_WITHOUT_ROS}.",
        )
    if importlib.util.find_spec("rclpy") is None:
        raise LinkError(
            "robot is reached over ROS 2, but rclpy cannot be imported",
            where="robot",
            fix=f"Source a ROS 2 whose Python is ours (source /opt/ros/humble/setup.bash), {_WITHOUT_ROS}.",
        )
