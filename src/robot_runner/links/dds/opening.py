"""Opens a link over DDS, and says what stands in its way; nothing of DDS is loaded before."""

from __future__ import annotations

import importlib.util
import os
from typing import TYPE_CHECKING

from robot_runner.errors import Finding, LinkError
from robot_runner.links.dds.settings import DdsSettings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.links.robot_name import RobotName

__all__ = ["findings", "open_dds_link"]

_PACKAGES = ("cyclonedds", "rosbags")


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name over DDS; nothing is opened by asking."""
    missing = [package for package in _PACKAGES if importlib.util.find_spec(package) is None]
    if missing:
        return [_not_installed(missing).as_finding()]
    try:
        settings = DdsSettings.of(name.options, os.environ)
        from robot_runner.links.type_catalogue import TypeCatalogue  # noqa: PLC0415  # an extra, only where asked for

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
        from robot_runner.links.dds.link import DdsRobotLink  # noqa: PLC0415  # it loads Cyclone DDS
    except ModuleNotFoundError as error:
        raise _not_installed([error.name or "cyclonedds"]) from error
    return DdsRobotLink(settings, clock, namespace=namespace)


def _not_installed(missing: list[str]) -> LinkError:
    return LinkError(
        f"robot is reached over DDS, but {' and '.join(missing)} cannot be imported",
        where="robot",
        fix="Install it: pip install 'robot-runner[dds]'.",
    )
