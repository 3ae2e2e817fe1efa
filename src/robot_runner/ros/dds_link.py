"""Opens a link over DDS, and says what stands in its way; nothing of DDS is loaded before."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_links import missing_of, not_installed
from robot_runner.ros.graph_transport import domain_id, receive_clock
from robot_runner.ros.type_store import ROS2_DISTROS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import RobotLink, RobotName

__all__ = ["DdsSettings", "findings", "open_dds_link"]

_OPTIONS = ("domain", "distro", "types")
_WHERE = "robot"
_PACKAGES = ("cyclonedds", "rosbags")
_WAY = "over DDS"


@dataclass(frozen=True, slots=True)
class DdsSettings:
    """How the graph is reached: what `robot = "dds:option=value,..."` and the environment say.

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
        return cls(domain_id(options, variables), distro, types)


def _check_distro(distro: str | None) -> None:
    if distro is not None and distro not in ROS2_DISTROS:
        raise LinkError(
            f"{distro!r} is no distribution of ROS 2 that is known",
            where=_WHERE,
            fix=did_you_mean(distro, ROS2_DISTROS),
        )


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
