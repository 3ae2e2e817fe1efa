"""The robot link, and the ROS that the experiment requires."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.config.checks.required_ros import check_required_ros
from robot_runner.errors import Finding, LinkError
from robot_runner.links.automatic import AUTO, found_robot
from robot_runner.links.connect import is_simulated, link_findings
from robot_runner.links.host import LOCAL
from robot_runner.links.robot_name import RobotName
from robot_runner.links.ros_environment import find_ros

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from robot_runner.config.loader import LoadedConfig
    from robot_runner.config.parameters import Parameters
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["check_robot", "choose_robot"]

_CLIENTS = {"ros1": 1, "ros2": 2}


def choose_robot(loaded: LoadedConfig) -> list[Finding]:
    """Put what is found in the place of `robot = "auto"`, so that every run and the manifest name the same.

    Returns:
        what was chosen and why, or that nothing is there to choose.
    """
    if getattr(loaded.config, "robot", None) != AUTO:
        return []
    try:
        found = found_robot()
    except LinkError as error:
        return [Finding.error(f"{loaded.where}.robot", error.problem, error.fix)]
    loaded.config.robot = found.name
    problem = f"robot is 'auto', and {found.name!r} was chosen: {found.reason}"
    return [Finding.warning(f"{loaded.where}.robot", problem, f"Write robot = {found.name!r} to be sure of it.")]


def check_robot(loaded: LoadedConfig, parameters: Parameters, plugins: Sequence[Plugin] = ()) -> list[Finding]:
    """Return what stands between the experiment and its robot."""
    if parameters.robot == AUTO:
        return []  # nothing was found, which is a finding already
    findings = list(link_findings(parameters.robot))
    if is_simulated(parameters.robot):
        return findings  # the embedded robot needs no ROS
    try:
        name = None if parameters.robot is None else RobotName.parse(parameters.robot)
    except LinkError:
        return findings
    findings += _other_generation(name)
    return [*findings, *check_required_ros(loaded.where, parameters, name, sorted(set(_hosts(plugins)), key=str))]


def _other_generation(name: RobotName | None) -> list[Finding]:
    """Return that the other generation's packages stand in the way: both call their message packages the same."""
    sourced, needed = find_ros(), None if name is None else _CLIENTS.get(name.link)
    if sourced is None or needed is None or sourced.version == needed:
        return []
    problem = f"robot is {name.link!r}, and ROS {sourced.version} is sourced in this shell" if name else ""
    fix = f"Start robot-runner from a shell in which ROS {needed} is sourced, and no other."
    return [Finding.error("robot", problem, fix)]


def _hosts(plugins: Sequence[Plugin]) -> Iterator[tuple[str, Path | None]]:
    """Yield the robot's computers that plugins name, each with its ssh config."""
    for plugin in plugins:
        host = getattr(plugin, "host", None)
        if isinstance(host, str) and host != LOCAL:
            yield host, getattr(plugin, "ssh_config", None)
