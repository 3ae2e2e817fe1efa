"""Opens a link over DDS, and says what stands in its way; nothing of DDS is loaded before."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError
from robot_runner.ros.graph_addresses import DdsSettings
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_links import missing_of, not_installed
from robot_runner.ros.graph_transport import receive_clock

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import RobotLink
    from robot_runner.core.links.robot_name import RobotName

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
    missing = missing_of(_PACKAGES)
    if missing:
        raise not_installed(missing, way=_WAY, extra="dds")
    from robot_runner.ros.dds_transport import DdsTransport  # noqa: PLC0415  # cyclonedds, an extra

    connect = partial(DdsTransport, settings, receive_clock(clock))
    return GraphLink(connect, namespace)
