"""Opens a link through a rosbridge, and checks whether it can be opened; nothing is connected before."""

from __future__ import annotations

from functools import partial
from ipaddress import ip_address

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_addresses import RosbridgeAddress
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_links import check_installed
from robot_runner.ros.graph_transport import receive_clock

_PACKAGES = ("cbor2", "rosbags", "websockets")
_check_installed = partial(check_installed, _PACKAGES, way="through a rosbridge", extra="rosbridge")


def findings(name: RobotName) -> list[Finding]:
    """Return findings that prevent a link to a robot at this address; nothing is opened.

    Example:
        >>> from robot_runner.core.links.robot_name import RobotName
        >>> [finding.problem for finding in findings(RobotName.parse("rosbridge://robot:port"))]
        ["'rosbridge://robot:port' cannot be the address of a rosbridge"]
    """
    try:
        _check_installed()
        address = RosbridgeAddress.parse(name.address or name.link)
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

        TypeCatalogue.of(address.generation or 2, None, address.types)
        address.security.check()
    except LinkError as error:
        return [error.as_finding()]
    return [] if address.security.is_tls or _is_this_machine(address.host) else [_readable_by_others(address)]


def _is_this_machine(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name; it is not looked up, as asking takes time and tells others
        return host == "localhost" or host.endswith(".localhost")


def _readable_by_others(address: RosbridgeAddress) -> Finding:
    if address.security.sends_secrets:
        problem = f"the password or token for {address.uri} would go over the network for everybody to read"
        return Finding.error("robot", problem, "Reach it by TLS: rosbridge+tls://….")
    problem = (
        f"{address.uri} is neither encrypted nor signed: whoever is in the network can read it, and move the robot"
    )
    fix = "Keep the robot in a network of its own, start its server with TLS (rosbridge+tls://…), or go through SSH: "
    fix += f"ssh -L {address.port}:localhost:{address.port}"
    return Finding.warning("robot", problem, f"{fix} {address.host}, then robot=rosbridge://localhost:{address.port}.")


def open_rosbridge_link(url: str, clock: Clock, namespace: str = "") -> RobotLink:
    """Connect to a rosbridge, whose address `RosbridgeAddress` reads, and return the link to the robot there.

    Raises:
        LinkError: the address is not valid, a package is missing, or the rosbridge cannot be reached.
    """
    address = RosbridgeAddress.parse(url)
    _check_installed()
    from robot_runner.ros.rosbridge_transport import RosbridgeTransport  # noqa: PLC0415  # cbor2 and rosbags, extras

    connect = partial(RosbridgeTransport, address, receive_clock(clock))
    return GraphLink(connect, namespace)
