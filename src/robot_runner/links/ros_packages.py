"""Which ROS packages this machine has, told from the folders that a setup file puts on its paths."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.links.ros_environment import find_ros

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = ["describe_ros"]

_PATHS = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH")
_VERSION = re.compile(rb"<version[^>]*>\s*([^<\s]+)\s*</version>")


def describe_ros(environment: Mapping[str, str] | None = None) -> dict[str, Any] | None:
    """Return the ROS that is sourced: generation, distribution, middleware, packages by name; None where none is.

    Packages are those below `share/` of each prefix on AMENT_PREFIX_PATH (ROS 2) and CMAKE_PREFIX_PATH (ROS 1), with
    the version in their package.xml (REP 127, 140 and 149); an overlay hides what lies beneath it.
    """
    variables = os.environ if environment is None else environment
    ros = find_ros(variables)
    if ros is None:
        return None
    return {
        "version": ros.version,
        "distro": ros.distro,
        "middleware": variables.get("RMW_IMPLEMENTATION"),
        "packages": dict(sorted(_packages(variables).items())),
    }


def _packages(variables: Mapping[str, str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for prefix in _prefixes(variables):
        for path in prefix.glob("share/*/package.xml"):
            found.setdefault(path.parent.name, _version(path))
    return found


def _prefixes(variables: Mapping[str, str]) -> Iterator[Path]:
    for name in _PATHS:
        for entry in variables.get(name, "").split(os.pathsep):
            if entry:
                yield Path(entry)


def _version(path: Path) -> str:
    try:
        found = _VERSION.search(path.read_bytes())
    except OSError:
        return ""
    return found[1].decode("utf-8", "replace") if found else ""
