"""Opens a link over DDS, and says what stands in its way; nothing of DDS is loaded before."""

from __future__ import annotations

import os
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Encoding, Qos
from robot_runner.ros.dds.services import OfferedService, ServiceClient
from robot_runner.ros.dds.session import Session
from robot_runner.ros.dds.topics import TopicSubscription, TopicWriter
from robot_runner.ros.graph_links import full_name, missing_of, not_installed
from robot_runner.ros.listening import first_message
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.type_store import ROS2_DISTROS
from robot_runner.ros.watchdog import VELOCITY_COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import Message, RawMessage, RobotLink, RobotName, Subscription
    from robot_runner.ros.dds.graph import Endpoint

__all__ = ["MAX_DOMAIN", "DdsRobotLink", "DdsSettings", "findings", "open_dds_link"]


# What `robot = "dds:option=value,..."` says: domain, distribution and further types.

_OPTIONS = ("domain", "distro", "types")
_WHERE = "robot"

#: Domains above this have UDP ports past 65535 (RTPS 2.2, 9.6.1.1: 7400 + 250 · domain + …).
MAX_DOMAIN = 232


@dataclass(frozen=True, slots=True)
class DdsSettings:
    """How the graph is reached.

    Attributes:
        domain: DDS domain id, 0 to 232.
        distro: distribution of ROS 2 on the robot; None to tell from the graph.
        types: files and folders with further message types.

    Example:
        >>> DdsSettings.of({"domain": "7", "distro": "humble"}, {}).domain
        7
    """

    domain: int
    distro: str | None
    types: tuple[Path, ...] = ()

    @classmethod
    def of(cls, options: Mapping[str, str], environment: Mapping[str, str] | None = None) -> DdsSettings:
        """Read options, and `ROS_DOMAIN_ID` and `ROS_DISTRO` where they are left out.

        Raises:
            LinkError: there is no such option, or it cannot have this value.
        """
        variables = os.environ if environment is None else environment
        for name in options:
            if name not in _OPTIONS:
                raise LinkError(f"dds has no option {name!r}", where=_WHERE, fix=did_you_mean(name, _OPTIONS))
        distro = options.get("distro")
        if distro is None and variables.get("ROS_DISTRO") in ROS2_DISTROS:
            distro = variables["ROS_DISTRO"]
        _check_distro(distro)
        types = tuple(Path(part).expanduser() for part in options.get("types", "").split(os.pathsep) if part)
        return cls(_domain(options, variables), distro, types)


def _domain(options: Mapping[str, str], variables: Mapping[str, str]) -> int:
    named = "domain" in options
    text = options["domain"] if named else variables.get("ROS_DOMAIN_ID") or "0"
    if text.isascii() and text.isdigit() and int(text) <= MAX_DOMAIN:
        return int(text)
    raise LinkError(
        f"the domain id is {text!r}",
        where=_WHERE if named else "ROS_DOMAIN_ID",
        fix=f"Give a whole number from 0 to {MAX_DOMAIN}, the ROS_DOMAIN_ID of the robot.",
    )


def _check_distro(distro: str | None) -> None:
    if distro is not None and distro not in ROS2_DISTROS:
        raise LinkError(
            f"{distro!r} is no distribution of ROS 2 that is known",
            where=_WHERE,
            fix=did_you_mean(distro, ROS2_DISTROS),
        )


# The link to a robot that runs ROS 2, over DDS, from a machine without ROS.

#: How long what was published is waited for to arrive before the link leaves.
_CLOSING_SECONDS = 0.5


class DdsRobotLink:
    """A robot on a graph of ROS 2, reached as a participant of its DDS domain.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> from robot_runner.ros.dds.link import DdsSettings
        >>> link = DdsRobotLink(DdsSettings.of({"domain": "99"}), SystemClock())  # doctest: +SKIP
        >>> link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})  # doctest: +SKIP
        >>> link.close()  # doctest: +SKIP
    """

    def __init__(self, settings: DdsSettings, clock: Clock, *, namespace: str = "") -> None:
        """Join the graph.

        Raises:
            LinkError: the domain cannot be joined, or a type definition cannot be used.
        """
        # A clock that is not this machine's is a simulation's, whose time the messages are stamped by.
        self._now_ns = time.time_ns if isinstance(clock, SystemClock) else lambda: int(clock.now() * 1e9)
        self._namespace = namespace
        self._lock = threading.RLock()
        self._writers: dict[str, TopicWriter] = {}
        self._clients: dict[tuple[str, str], ServiceClient] = {}
        self._subscriptions: list[TopicSubscription] = []
        self._moved: set[str] = set()
        self._open_ends = ExitStack()
        self._is_closed = False
        self._session = Session(settings)
        self._session.graph.on_writer = self._adapt

    @property
    def is_simulated(self) -> bool:
        """Never: what is behind a graph cannot be told from it."""
        return False

    @property
    def encoding(self) -> Encoding:
        """CDR."""
        return Encoding.CDR

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message.

        Raises:
            LinkError: the topic carries another type, or the message does not follow its definition.
        """
        name = full_name(self._namespace, topic)
        self._session.check_open(name)
        with self._lock:
            writer = self._writer(name, message_type, qos)
        writer.publish(message)
        if writer.message_type in VELOCITY_COMMANDS:
            self._moved.add(name)

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic, in a thread of the link.

        Raises:
            LinkError: the topic carries another type, its publishers offer less than `qos`, or there is no such type.
        """
        return self.subscribe_raw(topic, message_type, self._decoded(message_type, callback), qos=qos)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic; as `subscribe` in all else."""
        return self._subscribe(full_name(self._namespace, topic), message_type, callback, qos)

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
            LinkError: none came in time, or as `subscribe`.
        """
        name = full_name(self._namespace, topic)
        opened: list[TopicSubscription] = []

        def subscribe(hear: Callable[[Message], None]) -> Subscription:
            opened.append(self._subscribe(name, message_type, self._decoded(message_type, hear), None))
            return opened[0]

        return first_message(
            subscribe,
            condition,
            timeout=timeout,
            where=name,
            explain=lambda: opened[0].explain(),  # noqa: PLW0108  # there is none before it is subscribed
            wait=lambda event, seconds: self._session.reception.wait_for(event.is_set, seconds),
        )

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds.

        Raises:
            LinkError: there is no such service, it has another type, it does not answer in time, or the request does
                not follow its definition.
        """
        name = full_name(self._namespace, service)
        self._session.check_open(name)
        with self._lock:
            if (name, service_type) not in self._clients:
                self._clients[name, service_type] = ServiceClient(self._session, name, service_type)
            client = self._clients[name, service_type]
        return client.call(request or {}, timeout)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; requests are answered in threads of their own.

        Raises:
            LinkError: there is no such type, or somebody offers a service of this name already.
        """
        offered = OfferedService(self._session, full_name(self._namespace, service), service_type, answer)
        self._open_ends.callback(offered.close)
        return offered

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that is published or heard on the graph, by its full name."""
        return self._settled().graph.topics()

    def services(self) -> Mapping[str, str]:
        """Return the type of each service on the graph, by its full name."""
        return self._settled().graph.services()

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted."""
        return self._settled().nodes.names()

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, with those that it is made of after it.

        Raises:
            LinkError: there is no such type.
        """
        return self._session.types.definition(message_type)

    def close(self) -> None:
        """Stop what was driven, end all subscriptions and offers, and leave; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        with ExitStack() as stack:
            stack.callback(self._session.close)
            stack.callback(self._open_ends.close)
            stack.callback(self._flush)
            for topic in self._moved:
                stack.callback(self._writers[topic].publish, {})

    def _flush(self) -> None:
        deadline = time.monotonic() + _CLOSING_SECONDS
        for writer in self._writers.values():
            writer.flush(max(0.0, deadline - time.monotonic()))

    def _settled(self) -> Session:
        self._session.check_open("the graph")
        self._session.settle(lambda: False)
        return self._session

    def _subscribe(
        self, name: str, message_type: str, callback: Callable[[RawMessage], None], qos: Qos | None
    ) -> TopicSubscription:
        subscription = TopicSubscription(self._session, name, message_type, callback, qos=qos, now_ns=self._now_ns)
        with self._lock:
            self._subscriptions = [each for each in self._subscriptions if each.is_open]
            self._subscriptions.append(subscription)
        return subscription

    def _writer(self, topic: str, message_type: str, qos: Qos) -> TopicWriter:
        writer = self._writers.get(topic)
        if writer is not None and (writer.message_type, writer.qos) == (plain_type(message_type), qos):
            return writer
        fresh = TopicWriter(self._session, topic, message_type, qos)
        if writer is not None:
            writer.close()
        self._writers[topic] = fresh
        return fresh

    def _adapt(self, writer: Endpoint) -> None:
        for subscription in self._subscriptions:
            subscription.adapt(writer)

    def _decoded(self, message_type: str, callback: Callable[[Message], None]) -> Callable[[RawMessage], None]:
        types = self._session.types
        return lambda raw: callback(types.deserialise(message_type, raw.data, Encoding.CDR))


_PACKAGES = ("cyclonedds", "rosbags")
_WAY = "over DDS"


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name over DDS; nothing is opened by asking."""
    missing = missing_of(_PACKAGES)
    if missing:
        return [not_installed(missing, way=_WAY, extra="dds").as_finding()]
    try:
        settings = DdsSettings.of(name.options, os.environ)
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

        TypeCatalogue.of(2, settings.distro, settings.types)
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_dds_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph and return the link to the robot of this namespace.

    Args:
        options: `domain`, `distro` and `types`.
        clock: the run's, by which messages are stamped where it is a simulation's.
        namespace: of the robot.

    Raises:
        LinkError: an option cannot have its value, a package is missing, or the domain cannot be joined.
    """
    settings = DdsSettings.of(options, os.environ)
    try:
        pass
    except ModuleNotFoundError as error:
        raise not_installed([error.name or "cyclonedds"], way=_WAY, extra="dds") from error
    return DdsRobotLink(settings, clock, namespace=namespace)
