"""Which ROS this machine has, told from what its setup file sets."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["RosEnvironment", "find_ros"]


@dataclass(frozen=True, slots=True)
class RosEnvironment:
    """A ROS that was sourced in the shell from which we were started.

    Attributes:
        version: the generation: 1 or 2.
        distro: the distribution, such as `noetic`, or None where it is not told.
        source: where this was read.
    """

    version: int
    distro: str | None
    source: str


def find_ros(environment: Mapping[str, str] | None = None) -> RosEnvironment | None:
    """Return the ROS that is sourced, or None. Every setup file of ROS sets ROS_VERSION and ROS_DISTRO."""
    variables = os.environ if environment is None else environment
    version = variables.get("ROS_VERSION", "")
    if version not in {"1", "2"}:
        return None
    return RosEnvironment(int(version), variables.get("ROS_DISTRO") or None, "ROS_VERSION and ROS_DISTRO")
