"""Opens a link through a rosbridge, and says what stands in its way; nothing is connected before."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlsplit

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Qos
from robot_runner.ros.graph_links import full_name, missing_of, not_installed
from robot_runner.ros.listening import first_message
from robot_runner.ros.rosbridge.rosapi import RobotTypes, Rosapi
from robot_runner.ros.rosbridge.services import Services
from robot_runner.ros.rosbridge.session import Session
from robot_runner.ros.rosbridge.topics import Publishers, Subscriptions
from robot_runner.ros.type_store import ROS1_DISTROS, ROS2_DISTROS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from urllib.parse import SplitResult

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import Encoding, Message, RawMessage, RobotLink, RobotName, Subscription

__all__ = ["DEFAULT_PORT", "SCHEME", "RosbridgeAddress", "RosbridgeRobotLink", "findings", "open_rosbridge_link"]


# Where a rosbridge is, as `robot = "rosbridge://host:9090?option=value"` says it.

SCHEME = "rosbridge"
#: Where a rosbridge server listens, if not started elsewhere.
DEFAULT_PORT = 9090
_OPTIONS = ("ros", "distro", "types")
_WHERE = "robot"


@dataclass(frozen=True, slots=True)
class RosbridgeAddress:
    """Where a rosbridge is, and what it need not be asked.

    Attributes:
        host: name or number of the robot's computer.
        port: of the server.
        path: of the server's WebSocket.
        generation: of the robot's ROS, 1 or 2; None to ask the robot.
        distro: the robot's distribution; None to ask the robot.
        types: files and folders with further message types.

    Example:
        >>> RosbridgeAddress.parse("rosbridge://robot?distro=humble").uri
        'ws://robot:9090/'
    """

    host: str
    port: int = DEFAULT_PORT
    path: str = "/"
    generation: int | None = None
    distro: str | None = None
    types: tuple[Path, ...] = ()

    @classmethod
    def parse(cls, text: str) -> RosbridgeAddress:
        """Take an address apart.

        Raises:
            LinkError: it is none, or an option is none of a rosbridge's or cannot have its value.
        """
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise _malformed(text) from error
        if parts.scheme != SCHEME or not host or parts.fragment:
            raise _malformed(text)
        options = _options(parts)
        distro = options.get("distro")
        types = tuple(Path(part).expanduser() for part in options.get("types", "").split(os.pathsep) if part)
        return cls(
            host, port or DEFAULT_PORT, parts.path or "/", _generation(options.get("ros"), distro), distro, types
        )

    @property
    def uri(self) -> str:
        """The address of its WebSocket."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"ws://{host}:{self.port}{self.path}"


def _options(parts: SplitResult) -> dict[str, str]:
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    for name in options:
        if name not in _OPTIONS:
            raise LinkError(f"rosbridge has no option {name!r}", where=_WHERE, fix=did_you_mean(name, _OPTIONS))
    return options


def _generation(text: str | None, distro: str | None) -> int | None:
    known = (*ROS1_DISTROS, *ROS2_DISTROS)
    if distro is not None and distro not in known:
        raise LinkError(
            f"{distro!r} is no distribution of ROS that is known", where=_WHERE, fix=did_you_mean(distro, known)
        )
    if text not in {None, "1", "2"}:
        raise LinkError(f"the generation of ROS is {text!r}", where=_WHERE, fix="Write ros=1 or ros=2.")
    told = None if distro is None else 1 if distro in ROS1_DISTROS else 2
    if text is not None and told not in {None, int(text)}:
        raise LinkError(f"{distro!r} is no distribution of ROS {text}", where=_WHERE, fix="Leave ros= out.")
    return told if text is None else int(text)


def _malformed(text: str) -> LinkError:
    fix = f"Write it as in {SCHEME}://robot:{DEFAULT_PORT}."
    return LinkError(f"{text!r} cannot be the address of a rosbridge", where=_WHERE, fix=fix)


# The link to a robot behind a rosbridge.

_logger = logging.getLogger(__name__)


class RosbridgeRobotLink:
    """A robot on a graph of ROS 1 or ROS 2, reached through the rosbridge server that runs there.

    A rosbridge fits its own subscriptions to what a topic's publishers offer; of `qos` it takes `TRANSIENT_LOCAL`, for
    what is published.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> from robot_runner.ros.rosbridge.link import RosbridgeAddress
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


_PACKAGES = ("cbor2", "rosbags", "websockets")
_WAY = "through a rosbridge"


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot at this address; nothing is opened by asking.

    Example:
        >>> from robot_runner.core.links.robot import RobotName
        >>> [finding.problem for finding in findings(RobotName.parse("rosbridge://robot:port"))]
        ["'rosbridge://robot:port' cannot be the address of a rosbridge"]
    """
    missing = missing_of(_PACKAGES)
    if missing:
        return [not_installed(missing, way=_WAY, extra="rosbridge").as_finding()]
    try:
        address = RosbridgeAddress.parse(name.address or name.link)
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

        TypeCatalogue.of(address.generation or 2, None, address.types)
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_rosbridge_link(url: str, clock: Clock, namespace: str = "") -> RobotLink:
    """Connect to a rosbridge and return the link to the robot of this namespace.

    Args:
        url: `rosbridge://host:port`, with `?ros=`, `distro=` and `types=` for what the robot does not tell.
        clock: the run's, by which messages are stamped where it is a simulation's.
        namespace: of the robot.

    Raises:
        LinkError: the address is none, a package is missing, or the rosbridge cannot be reached.
    """
    address = RosbridgeAddress.parse(url)
    missing = missing_of(_PACKAGES)
    if missing:
        raise not_installed(missing, way=_WAY, extra="rosbridge")

    return RosbridgeRobotLink(address, clock, namespace=namespace)
