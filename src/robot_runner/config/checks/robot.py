"""The robot link, and the ROS that the experiment requires."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import Finding
from robot_runner.links.connect import is_simulated, link_findings
from robot_runner.links.ros_environment import RosEnvironment, find_ros

if TYPE_CHECKING:
    from robot_runner.config.loader import LoadedConfig
    from robot_runner.config.parameters import Parameters

__all__ = ["check_robot"]

_ON_SIMULATED = "or execute it on the embedded robot: --set robot=simulated"


def check_robot(loaded: LoadedConfig, parameters: Parameters) -> list[Finding]:
    """Return what stands between the experiment and its robot."""
    findings = list(link_findings(parameters.robot))
    if is_simulated(parameters.robot) or parameters.required_ros_version is None:
        return findings  # the embedded robot needs no ROS
    return [*findings, *_check_ros(loaded, parameters, find_ros())]


def _check_ros(loaded: LoadedConfig, parameters: Parameters, found: RosEnvironment | None) -> list[Finding]:
    wanted = _wanted(parameters)
    where = f"{loaded.where}.required_ros_version"
    if found is None:
        problem = f"the experiment requires {wanted}, and no ROS is found on this machine"
        return [Finding.error(where, problem, f"Source the setup file of {wanted}, {_ON_SIMULATED}.")]
    if parameters.required_ros_version not in {"any", found.version}:
        problem = f"the experiment requires {wanted}, and ROS {found.version} is found ({found.source})"
        return [Finding.error(where, problem, f"Source the setup file of {wanted}, {_ON_SIMULATED}.")]
    distro = parameters.required_ros_distro
    if distro in {None, "any"} or found.distro == distro:
        return []
    where = f"{loaded.where}.required_ros_distro"
    problem = f"the experiment requires {distro!r}, and {found.distro!r} is found ({found.source})"
    return [Finding.error(where, problem, f"Source the setup file of {distro}, {_ON_SIMULATED}.")]


def _wanted(parameters: Parameters) -> str:
    distro = parameters.required_ros_distro
    generation = "ROS" if parameters.required_ros_version == "any" else f"ROS {parameters.required_ros_version}"
    return generation if distro in {None, "any"} else f"{generation} {distro}"
