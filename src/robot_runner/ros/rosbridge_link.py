"""Opens a link through a rosbridge, and says what stands in its way; nothing is connected before."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlsplit

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_links import missing_of, not_installed
from robot_runner.ros.graph_transport import receive_clock
from robot_runner.ros.type_store import ROS1_DISTROS, ROS2_DISTROS

if TYPE_CHECKING:
    from urllib.parse import SplitResult

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import RobotLink, RobotName

__all__ = ["DEFAULT_PORT", "SCHEME", "RosbridgeAddress", "findings", "open_rosbridge_link"]

SCHEME = "rosbridge"
#: Where a rosbridge server listens, if not started elsewhere.
DEFAULT_PORT = 9090
_OPTIONS = ("ros", "distro", "types")
_WHERE = "robot"
_PACKAGES = ("cbor2", "rosbags", "websockets")
_WAY = "through a rosbridge"


@dataclass(frozen=True, slots=True)
class RosbridgeAddress:
    """Where a rosbridge is, as `robot = "rosbridge://host:9090?option=value"` says it, and what it need not be asked.

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
            LinkError: it cannot be an address, or there is no such option, or it cannot have this value.
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
        LinkError: it cannot be an address, a package is missing, or the rosbridge cannot be reached.
    """
    address = RosbridgeAddress.parse(url)
    missing = missing_of(_PACKAGES)
    if missing:
        raise not_installed(missing, way=_WAY, extra="rosbridge")
    from robot_runner.ros.rosbridge_transport import RosbridgeTransport  # noqa: PLC0415  # cbor2 and rosbags, extras

    connect = partial(RosbridgeTransport, address, receive_clock(clock))
    return GraphLink(connect, namespace)
