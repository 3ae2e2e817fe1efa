"""Addresses of graphs, such as `robot = "dds:..."` or `robot = "rosbridge://..."`; no client library is loaded."""

from __future__ import annotations

import os
import socket
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from urllib.parse import parse_qsl, urlsplit

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Encoding
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.input_files import input_file
from robot_runner.ros.ros1_master import Master, master_address
from robot_runner.ros.rosbridge_security import SECURITY_OPTIONS, RosbridgeSecurity
from robot_runner.ros.type_store import ROS1_DISTROS, ROS2_DISTROS

_WHERE = "robot"
#: Addresses of this computer; Debian gives the second one to its name.
_LOCAL = ("127.0.0.1", "127.0.1.1", "::1")
_DDS_OPTIONS = ("domain", "distro", "types")
#: Domains above this have UDP ports past 65535 (RTPS 2.2, 9.6.1.1: 7400 + 250 · domain + …).
_MAX_DOMAIN = 232
#: How many participants of one computer are found without multicast; the same as in rmw_cyclonedds_cpp.
_MOST_PARTICIPANTS = 32

_SCHEME = "rosbridge"
#: Where a rosbridge server listens, if not started elsewhere.
_DEFAULT_PORT = 9090
#: The ports of a rosbridge behind TLS: by our own name of it, and by that of any WebSocket.
_TLS_PORTS = MappingProxyType({"rosbridge+tls": _DEFAULT_PORT, "wss": 443})
_OPEN = RosbridgeSecurity()
_ROSBRIDGE_OPTIONS = ("ros", "distro", "types", *SECURITY_OPTIONS)


def check_options(link: str, options: Iterable[str], known: Collection[str]) -> None:
    """Check that a link has these options; else raise a `LinkError` that names the nearest."""
    for name in options:
        if name not in known:
            raise LinkError(f"{link} has no option {name!r}", where=_WHERE, fix=did_you_mean(name, known))


def domain_id(options: Mapping[str, str], environment: Mapping[str, str]) -> int:
    """Return the DDS domain from the option `domain`, or else the environment; raise a `LinkError` if it is none.

    Example:
        >>> domain_id({"domain": "7"}, {}), domain_id({}, {"ROS_DOMAIN_ID": "3"}), domain_id({}, {})
        (7, 3, 0)
    """
    named = "domain" in options
    text = options["domain"] if named else environment.get("ROS_DOMAIN_ID") or "0"
    # Programs of ROS take 010 for 8 (rcl, domain_id.c: strtoul with base 0).
    if text.isascii() and text.isdigit() and text == str(int(text)) and int(text) <= _MAX_DOMAIN:
        return int(text)
    fix = f"Give a whole number from 0 to {_MAX_DOMAIN} without zeros before it, the ROS_DOMAIN_ID of the robot."
    raise LinkError(f"the domain id is {text!r}", where="robot" if named else "ROS_DOMAIN_ID", fix=fix)


def graph_of(robot: str) -> str:
    """Return what identifies a graph: its domain, its master, or its rosbridge.

    Example:
        >>> graph_of("dds:domain=7,distro=humble") == graph_of("ros2:domain=7,namespace=/alice")
        True
        >>> graph_of("ros1:master=http://127.0.0.1:11311") == graph_of("ros1:master=http://localhost:11311/")
        True
    """
    with suppress(LinkError):
        name = RobotName.parse(robot)
        if name.link in {"dds", "ros2"}:
            return f"domain {domain_id(name.options, os.environ)}"
        if name.link == "ros1":
            host, port = master_address(Master(name.options.get("master")).uri)
            return f"master {_known(host)}:{port}"
        if name.address is not None:
            address = RosbridgeAddress.parse(name.address)
            return f"rosbridge {_known(address.host)}:{address.port}{address.path}"
    return robot


def _known(host: str) -> str:
    """Return one name for all names of this computer, without using the network; other hosts stay as they are."""
    own = socket.gethostname().lower()
    return "localhost" if host in {*_LOCAL, own, own.partition(".")[0]} else host


def is_of_environment(robot: str, encoding: Encoding) -> bool:
    """Whether programs of ROS that are executed here join the graph of a robot, rather than that of another one.

    Example:
        >>> is_of_environment("rosbridge://robot:9090", Encoding.ROS1)
        False
    """
    return graph_of(robot) == graph_of("ros1" if encoding is Encoding.ROS1 else "ros2")


@dataclass(frozen=True, slots=True)
class DdsSettings:
    """How the graph is reached, by `robot = "dds:option=value,..."` and the environment.

    Attributes:
        domain: DDS domain id, 0 to 232.
        distro: distribution of ROS 2 on the robot; None to find it out from the graph.
        types: files and folders with further message types.
        is_local: whether discovery is limited to this machine: `ROS_LOCALHOST_ONLY=1`, or the range LOCALHOST.
        peers: other computers to discover, from `ROS_STATIC_PEERS`; none with ROS_LOCALHOST_ONLY.

    Example:
        >>> DdsSettings.of({"domain": "7", "distro": "humble"}, {}).domain
        7
    """

    domain: int
    distro: str | None
    types: tuple[Path, ...] = ()
    is_local: bool = False
    peers: tuple[str, ...] = ()

    @classmethod
    def of(cls, options: Mapping[str, str], environment: Mapping[str, str] | None = None) -> DdsSettings:
        """Read options, `ROS_DOMAIN_ID` and `ROS_DISTRO` where they are left out, and the range of discovery.

        An option or a value that there is not raises a `LinkError`.
        """
        variables = os.environ if environment is None else environment
        check_options("dds", options, _DDS_OPTIONS)
        distro = options.get("distro")
        if distro is None and variables.get("ROS_DISTRO") in ROS2_DISTROS:
            distro = variables["ROS_DISTRO"]
        _check_distro(distro, ROS2_DISTROS, "ROS 2")
        is_local, takes_peers = _discovery(variables)
        named = variables.get("ROS_STATIC_PEERS", "") if takes_peers else ""
        peers = tuple(filter(None, map(str.strip, named.split(";"))))
        return cls(domain_id(options, variables), distro, _paths(options), is_local, peers)

    def cyclone_configuration(self) -> str | None:
        """Return the configuration for Cyclone DDS, as XML; None where its defaults will do.

        Without multicast, as on most loopback interfaces, participants find each other by trying port after port.

        Example:
            >>> DdsSettings(0, None).cyclone_configuration() is None
            True
        """
        if not self.is_local and not self.peers:
            return None
        peers = "".join(f"<Peer address='{escape(address)}'/>" for address in ("localhost", *self.peers))
        general = ""
        if self.is_local and self.peers:  # as in rmw_cyclonedds_cpp: discovery on these computers only
            general = "<General><AllowMulticast>false</AllowMulticast></General>"
        elif self.is_local:
            interface = '<NetworkInterface address="127.0.0.1" multicast="true"/>'
            general = f"<General><Interfaces>{interface}</Interfaces></General>"
        index = f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}"
        discovery = f"<Discovery>{index}</MaxAutoParticipantIndex><Peers>{peers}</Peers></Discovery>"
        return f"<CycloneDDS><Domain>{general}{discovery}</Domain></CycloneDDS>"


#: The values of ROS_AUTOMATIC_DISCOVERY_RANGE, since Iron (rmw: rmw_automatic_discovery_range_t).
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


def _discovery(variables: Mapping[str, str]) -> tuple[bool, bool]:
    """Return whether discovery is limited to this machine, and whether the named peers are discovered, too."""
    if variables.get("ROS_LOCALHOST_ONLY", "").strip() == "1":  # Humble's, which takes precedence over the range
        return True, False
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    told = variables.get(name, "").strip().upper()
    if told == "OFF":
        fix = f"Set it to SUBNET, or to LOCALHOST with the robot in ROS_STATIC_PEERS; or unset {name}."
        raise LinkError("discovery is off, so that no robot can be found", where=name, fix=fix)
    if told and told not in _RANGES:
        raise LinkError(f"the range of discovery is {told!r}", where=name, fix=did_you_mean(told, _RANGES))
    return told == "LOCALHOST", told != "SYSTEM_DEFAULT"  # which leaves peers to the middleware


@dataclass(frozen=True, slots=True)
class RosbridgeAddress:
    """The address of a rosbridge, `robot = "rosbridge://host:9090?option=value"`, with facts about its robot.

    Attributes:
        host: name or number of the robot's computer.
        port: of the server.
        path: of the server's WebSocket.
        generation: of the robot's ROS, 1 or 2; None to ask the robot.
        distro: the robot's distribution; None to ask the robot.
        types: files and folders with further message types.
        security: how the connection is secured; `rosbridge+tls://` and `wss://` use TLS.

    Example:
        >>> RosbridgeAddress.parse("rosbridge://robot?distro=humble").uri
        'ws://robot:9090/'
        >>> RosbridgeAddress.parse("rosbridge+tls://robot:443").uri
        'wss://robot:443/'
        >>> RosbridgeAddress.parse("rosbridge://[fd00::7]").place
        '[fd00::7]:9090'
    """

    host: str
    port: int = _DEFAULT_PORT
    path: str = "/"
    generation: int | None = None
    distro: str | None = None
    types: tuple[Path, ...] = ()
    security: RosbridgeSecurity = _OPEN

    @classmethod
    def parse(cls, text: str) -> RosbridgeAddress:
        """Parse an address; raise a `LinkError` if it, an option or its value is not valid."""
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise _malformed(text) from error
        if parts.username is not None or parts.password is not None:
            problem = f"the address of the rosbridge at {host} has a user or a password in it, which would be recorded"
            fix = "Name the variable that holds it: rosbridge+tls://host?user=NAME&password_env=VARIABLE."
            raise LinkError(problem, where=_WHERE, fix=fix)
        if parts.scheme not in {_SCHEME, *_TLS_PORTS} or not host or port == 0 or parts.fragment:
            raise _malformed(text)
        options = dict(parse_qsl(parts.query, keep_blank_values=True))
        check_options("rosbridge", options, _ROSBRIDGE_OPTIONS)
        distro = options.get("distro")
        generation = _generation(options.get("ros"), distro)
        security = RosbridgeSecurity.of(options, is_tls=parts.scheme in _TLS_PORTS)
        port = port or _TLS_PORTS.get(parts.scheme, _DEFAULT_PORT)
        return cls(host, port, parts.path or "/", generation, distro, _paths(options), security)

    @property
    def place(self) -> str:
        """Host and port, as in the address."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def uri(self) -> str:
        """The address of its WebSocket."""
        return f"{'wss' if self.security.is_tls else 'ws'}://{self.place}{self.path}"


def _generation(text: str | None, distro: str | None) -> int | None:
    _check_distro(distro, (*ROS1_DISTROS, *ROS2_DISTROS), "ROS")
    if text not in {None, "1", "2"}:
        raise LinkError(f"the generation of ROS is {text!r}", where=_WHERE, fix="Write ros=1 or ros=2.")
    told = None if distro is None else 1 if distro in ROS1_DISTROS else 2
    if text is not None and told not in {None, int(text)}:
        raise LinkError(f"{distro!r} is not a distribution of ROS {text}", where=_WHERE, fix="Leave ros= out.")
    return told if text is None else int(text)


def _malformed(text: str) -> LinkError:
    fix = f"Write it as in {_SCHEME}://robot:{_DEFAULT_PORT}, or {_SCHEME}://[fd00::7]:{_DEFAULT_PORT} (IPv6)."
    return LinkError(f"{text!r} cannot be the address of a rosbridge", where=_WHERE, fix=fix)


def _check_distro(distro: str | None, known: Collection[str], of: str) -> None:
    if distro is not None and distro not in known:
        problem = f"{distro!r} is not a distribution of {of} that is known"
        raise LinkError(problem, where=_WHERE, fix=did_you_mean(distro, known))


def _paths(options: Mapping[str, str]) -> tuple[Path, ...]:
    return tuple(input_file(part) for part in named_definitions(options))


def named_definitions(options: Mapping[str, str]) -> tuple[Path, ...]:
    """Return the files and folders with further message types, as the option `types` names them."""
    return tuple(Path(part) for part in options.get("types", "").split(os.pathsep) if part)
