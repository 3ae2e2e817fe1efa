"""Opens a link over DDS, and finds what prevents it; DDS is not loaded before."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import partial

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_addresses import DdsSettings
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_links import check_installed
from robot_runner.ros.graph_transport import receive_clock

_check_installed = partial(check_installed, ("cyclonedds", "rosbags"), way="over DDS", extra="dds")


def findings(name: RobotName) -> list[Finding]:
    """Return what prevents reaching a robot of this name over DDS; nothing is opened for that."""
    try:
        _check_installed()
        settings = DdsSettings.of(name.options, os.environ)
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

        TypeCatalogue.of(2, settings.distro, settings.types)
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_dds_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph that the options name, as `DdsSettings` reads them, and return the link to the robot there.

    Raises:
        LinkError: an option is invalid, a package is missing, or the domain cannot be joined.
    """
    settings = DdsSettings.of(options, os.environ)
    _check_installed()
    from robot_runner.ros.dds_transport import DdsTransport  # noqa: PLC0415  # cyclonedds, an extra

    connect = partial(DdsTransport, settings, receive_clock(clock))
    return GraphLink(connect, namespace)
