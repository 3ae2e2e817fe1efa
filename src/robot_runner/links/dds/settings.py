"""What `robot = "dds:option=value,..."` says: domain, distribution and further types."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError, did_you_mean
from robot_runner.links.type_store import ROS2_DISTROS

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["MAX_DOMAIN", "DdsSettings"]

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
