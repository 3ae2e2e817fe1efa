"""Compare the ROS that an experiment requires with those that are found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_addresses import RosbridgeAddress
from robot_runner.ros.ros1_master import Master
from robot_runner.ros.ros_environment import RosEnvironment, find_ros, installed_ros, ros_of_host, ros_of_master

if TYPE_CHECKING:
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.plugin import Plugin

_ON_SIMULATED = "or execute it on the embedded robot: --set robot=simulated"
_ANY = (None, "any")
#: The generation of ROS of each link; a rosbridge may be of either.
_GENERATIONS = {"ros1": 1, "ros2": 2, "dds": 2}
#: The generation whose client library each link imports.
_CLIENTS = {"ros1": 1, "ros2": 2}
#: The links that need no ROS on this machine.
_WITHOUT_ROS = ("dds", "rosbridge", "rosbridge+tls", "wss")
#: How long the check waits for a master, s.
_MASTER_SECONDS = 2.0


def ros_findings(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield findings on the ROS that an experiment needs, here and on robot's computers that its plugins name."""
    try:
        name = None if parameters.robot is None else RobotName.parse(parameters.robot)
    except LinkError:  # the link's own checks report it
        return
    yield from _other_generation(name)
    yield from check_required_ros(where, parameters, name, sorted(set(_hosts(plugins)), key=str))


def _other_generation(name: RobotName | None) -> Iterator[Finding]:
    """Yield an error where packages of the other generation are imported instead: both name message packages alike."""
    sourced, needed = find_ros(), None if name is None else _CLIENTS.get(name.link)
    if name is not None and sourced is not None and needed not in {None, sourced.version}:
        problem = f"robot is {name.link!r}, and ROS {sourced.version} is sourced in this shell"
        fix = f"Start robot-runner from a shell in which ROS {needed} is sourced, and no other."
        yield Finding.error("robot", problem, fix)


def _hosts(plugins: Sequence[Plugin]) -> Iterator[tuple[str, Path | None]]:
    for plugin in plugins:
        host = getattr(plugin, "host", None)
        if isinstance(host, str) and host != LOCAL:
            yield host, getattr(plugin, "ssh_config", None)


def check_required_ros(
    where: str, parameters: Parameters, robot: RobotName | None, hosts: Sequence[tuple[str, Path | None]]
) -> Iterator[Finding]:
    """Yield findings where the required ROS is not found, here or on the robot's computers, given with ssh configs."""
    if parameters.required_ros_version is None:
        return
    yield from _Check(where, parameters, robot).findings(hosts)


class _Check:
    def __init__(self, where: str, parameters: Parameters, robot: RobotName | None) -> None:
        self._where = where
        self._version = parameters.required_ros_version
        self._distro = parameters.required_ros_distro
        self._robot = robot
        self._link = None if robot is None else robot.link

    def findings(self, hosts: Sequence[tuple[str, Path | None]]) -> Iterator[Finding]:
        speaks = _GENERATIONS.get(self._link or "")
        if speaks is not None and self._version not in {"any", speaks}:
            problem = f"the experiment requires {self._wanted}, and robot = {self._link!r} speaks ROS {speaks}"
            links = " or ".join(name for name, generation in _GENERATIONS.items() if generation == self._version)
            yield self._error("version", problem, f"Reach the robot by {links} or rosbridge, {_ON_SIMULATED}.")
            return
        found: list[RosEnvironment] = []
        if self._link not in _WITHOUT_ROS:
            local = find_ros() or installed_ros()  # sourced, or as Debian ships it
            if local is None:
                problem = f"the experiment requires {self._wanted}, and no ROS is found on this machine"
                yield self._error("version", problem, f"Source the setup file of {self._wanted}, {_ON_SIMULATED}.")
                return
            yield from self._mismatch([local], f"Source the setup file of {self._wanted}, {_ON_SIMULATED}.")
            found.append(local)
        yield from self._of_robot(found, hosts)

    def _of_robot(self, found: list[RosEnvironment], hosts: Sequence[tuple[str, Path | None]]) -> Iterator[Finding]:
        fix = f"Reach a robot that has {self._wanted}, {_ON_SIMULATED}."
        told: list[RosEnvironment] = []
        try:
            told = _told(self._robot)
            if self._link == "ros1" and self._robot is not None:
                told = [ros_of_master(Master(self._robot.options.get("master"), timeout=_MASTER_SECONDS))]
        except LinkError:
            pass  # the link's own checks report a wrong name or a missing master
        yield from self._mismatch(told, fix)
        found += told
        if self._distro in _ANY:
            return
        for host, config in hosts:
            try:
                there = ros_of_host(host, config=config)
            except LinkError as error:
                yield Finding.warning(self._name("distro"), error.problem, error.fix)
                continue
            yield from self._mismatch(there, fix)
            found += there
        if all(each.distro is None for each in found):
            yield self._untold(found)

    def _mismatch(self, there: Sequence[RosEnvironment], fix: str) -> Iterator[Finding]:
        """Yield a finding where a place has no ROS of the required kind."""
        right = [each for each in there if self._version in {"any", each.version}]
        if there and not right:
            problem = f"the experiment requires {self._wanted}, and ROS {there[0].version} is found ({there[0].source})"
            yield self._error("version", problem, fix)
        elif right and self._distro not in _ANY and all(each.distro not in {None, self._distro} for each in right):
            names = " and ".join(repr(each.distro) for each in right)
            problem = f"the experiment requires {self._distro!r}, and {names} is found ({right[0].source})"
            yield self._error("distro", problem, fix)

    def _untold(self, found: Sequence[RosEnvironment]) -> Finding:
        looked = "; ".join(each.source for each in found) or f"robot = {self._link!r}"
        problem = f"the experiment requires {self._distro!r}, and nothing tells the robot's distribution ({looked})"
        fix = "Look for yourself, or let it be found out: name the robot's computer, as in PsUtil(host='pi@robot')."
        if self._link == "dds":
            fix = f"Say it: robot = 'dds:distro={self._distro}'."
        elif self._robot is not None and self._robot.address is not None:
            address = self._robot.address
            fix = f"Say it: robot = '{address}{'&' if '?' in address else '?'}distro={self._distro}'."
        return Finding.warning(self._name("distro"), problem, fix)

    def _name(self, part: str) -> str:
        return f"{self._where}.required_ros_{part}"

    def _error(self, part: str, problem: str, fix: str) -> Finding:
        return Finding.error(self._name(part), problem, fix)

    @property
    def _wanted(self) -> str:
        generation = "ROS" if self._version == "any" else f"ROS {self._version}"
        return generation if self._distro in _ANY else f"{generation} {self._distro}"


def _told(robot: RobotName | None) -> list[RosEnvironment]:
    if robot is None:
        return []
    if robot.address is not None:
        address = RosbridgeAddress.parse(robot.address)
        generation = address.generation
        return [] if generation is None else [RosEnvironment(generation, address.distro, f"robot = {robot.address!r}")]
    distro = robot.options.get("distro")
    return [] if distro is None else [RosEnvironment(2, distro, f"robot = '{robot.link}:distro={distro}'")]
