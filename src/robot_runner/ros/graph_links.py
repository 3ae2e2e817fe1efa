"""The kinds of links to robots on a ROS graph, for entry points: each is imported only when it is used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import parse_qsl

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock, SystemClock
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.kinds import FoundRobot, link_key
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.input_files import InputFile, input_file
from robot_runner.ros.definition_files import SUFFIXES, naming_files
from robot_runner.ros.graph_clock import GraphClock

if TYPE_CHECKING:
    from robot_runner.ros.graph_link import GraphLink
    from robot_runner.ros.ros1_master import Master


_DOMAIN = "ROS_DOMAIN_ID"
#: For each kind, the option that names the graph, and the variable by which programs of ROS join it.
_JOINED_BY = MappingProxyType(
    {"ros1": ("master", "ROS_MASTER_URI"), "ros2": ("domain", _DOMAIN), "dds": ("domain", _DOMAIN)}
)
_OPENING = "robot_runner.ros.link_opening"
_CLOCK = "clock"
_SYSTEM = "system"
_GRAPH = "graph"


@dataclass(frozen=True, slots=True)
class GraphLinkKind:
    """A kind of robot link to a ROS graph, named by an entry point.

    Each method raises a `LinkError` where the name of the robot is not valid; those that open something, also where the
    graph cannot be reached.

    Attributes:
        description: in one line.
        transport: names the functions of `link_opening` that check and open it; imported at first use.
        takes_address: whether it has an address, and no options.
        client: modules that take long to import, which opening imports only where they are needed.
        is_slow_to_join: whether messages of a new participant are lost at first, because DDS has to discover it.
        can_be_forked: whether importing `client` starts no thread, so that processes can be forked afterwards.
    """

    #: A graph does not tell whether its robot is; `is_simulation` looks for signs.
    is_simulated: ClassVar[bool] = False

    description: str
    transport: str
    takes_address: bool = False
    client: tuple[str, ...] = ()
    is_slow_to_join: bool = False
    can_be_forked: bool = True

    def findings(self, name: RobotName) -> list[Finding]:
        """Return findings that prevent a link to a robot of this name; nothing is opened."""
        _clock_of(name)
        check: Callable[[RobotName], list[Finding]] = self._opening("check_{}", name)
        try:
            return check(_without_clock(name))
        except LinkError as error:
            return [error.as_finding()]

    def begin_look(self, name: RobotName, needs: Mapping[str, Sequence[GraphNeed]]) -> Callable[[], Sequence[Finding]]:
        """Begin to check whether the graph has what plugins need; return a function that waits for the findings."""
        begin: Callable[..., Callable[[], Sequence[Finding]]]
        begin = import_module("robot_runner.ros.graph_look").begin_look
        return begin(name, needs)

    def graph_of(self, name: RobotName) -> str:
        """Return what identifies the robot's graph: its domain, its master, or its rosbridge."""
        graph: str = import_module("robot_runner.ros.graph_addresses").graph_of(name.graph)
        return graph

    def program_variables(self, name: RobotName, *, is_here: bool) -> Mapping[str, str]:
        """Return the variable of the domain or master; no master for another computer, as addresses may differ."""
        option, variable = _JOINED_BY.get(name.link, ("", ""))
        is_known = option in name.options and (is_here or variable == _DOMAIN)
        return {variable: name.options[option]} if is_known else {}

    def input_files(self, name: RobotName) -> Iterable[InputFile]:
        """Return the files with message definitions that the options name."""
        query = (name.address or "").partition("?")[2]
        for path in _definitions(dict(parse_qsl(query)) if query else name.options):
            there = input_file(path)
            inside = [each for each in there.rglob("*.*") if each.suffix in SUFFIXES]
            with suppress(LinkError):  # missing files are reported where they are read
                inside += naming_files(there)
            yield InputFile(path, tuple(inside))

    def preload(self, name: RobotName) -> None:
        """Import the client library; nothing is opened."""
        self._opening("open_{}_link", name)
        for module in self.client:
            import_module(module)

    def open_robot(
        self, name: RobotName, *, resources: Resources, clock: Clock, seed: int, namespace: str
    ) -> RobotLink:
        """Open a link to the robot of this namespace."""
        del resources, seed
        return self.open(name, clock, namespace)

    def open(self, name: RobotName, clock: Clock, namespace: str = "") -> RobotLink:
        """Open a link outside a run, too; the caller closes it."""
        bare = _without_clock(name)
        place = bare.options if bare.address is None else bare.address
        link: GraphLink = self._opening("open_{}_link", name)(place, clock, namespace)
        link.graph = name.graph
        return link

    def open_clock(self, name: RobotName, *, resources: Resources, seed: int) -> Clock:
        """Return the graph's clock where the run follows it, else this machine's.

        Raises:
            LinkError: the option `clock` is not valid, or the graph cannot be reached or publishes no time.
        """
        del seed
        if not self.follows_graph_clock(name):
            return SystemClock()
        link = resources.open(link_key("robot", ""), partial(self.open, name, SystemClock(), name.namespace))
        return resources.open("graph clock", partial(_started, link, clock_fix(name)))

    def follows_graph_clock(self, name: RobotName) -> bool:
        """Whether a run follows the time on `/clock`: as the option `clock` says, else as the graph of ROS 1 does.

        Raises:
            LinkError: the option is not valid, or no master answers.
        """
        chosen = _clock_of(name)
        if chosen is not None or name.link != "ros1":
            return chosen == _GRAPH
        master: Master = import_module(_OPENING).master_of(name.options)
        return bool(master.parameter("/use_sim_time"))

    def _opening(self, form: str, name: RobotName) -> Any:
        if self.takes_address and name.address is None:
            fix = "Write it as in rosbridge://robot:9090."
            raise LinkError("a rosbridge has an address, and none is named", where="robot", fix=fix)
        return getattr(import_module(_OPENING), form.format(self.transport))


class _FoundRobot:
    """The name `auto`: the first robot that is found from this machine, but never the simulation."""

    description = (
        "what is found: a ROS that is sourced, a ROS 1 master, a rosbridge, ROS 2 over DDS; never the simulation"
    )

    def found_robot(self) -> FoundRobot:
        """Return the robot that was found; raise a `LinkError` if none is found."""
        return import_module("robot_runner.ros.ros_environment").found_robot()  # type: ignore[no-any-return]


# The objects that entry points name.
ROS1 = GraphLinkKind("ROS 1 with rospy", "ros1", client=("rospy",))
ROS2 = GraphLinkKind("ROS 2 with rclpy", "ros2", client=("rclpy",), is_slow_to_join=True, can_be_forked=False)
DDS = GraphLinkKind(
    "ROS 2 over DDS, with no ROS installed", "dds", client=("robot_runner.ros.dds_transport",), is_slow_to_join=True
)
ROSBRIDGE = GraphLinkKind(
    "ROS 1 or 2 through a rosbridge, with no ROS installed",
    "rosbridge",
    takes_address=True,
    client=("robot_runner.ros.rosbridge_transport",),
)
ROSBRIDGE_TLS = replace(ROSBRIDGE, description="ROS 1 or 2 through a rosbridge behind TLS, with no ROS installed")
AUTO = _FoundRobot()

_ROSBRIDGES = {"rosbridge": ROSBRIDGE, "rosbridge+tls": ROSBRIDGE_TLS, "wss": ROSBRIDGE_TLS}
GRAPH_LINKS: Mapping[str, GraphLinkKind] = MappingProxyType({"ros1": ROS1, "ros2": ROS2, "dds": DDS, **_ROSBRIDGES})


def clock_fix(name: RobotName) -> str:
    """Return the advice for a run that follows `/clock` where no node publishes it.

    Example:
        >>> clock_fix(RobotName.parse("ros2:clock=graph"))
        "Start the simulation; or, for a real robot, leave clock=graph out of robot = 'ros2:…'."
    """
    if _CLOCK in name.options:
        return f"Start the simulation; or, for a real robot, leave clock=graph out of robot = '{name.link}:…'."
    return "Start the simulation; or, for a real robot, set the parameter /use_sim_time to false (rosparam set)."


def follows_graph_clock(robot: str | None) -> bool:
    """Whether a run with this robot follows its graph's time; a `LinkError` as of `GraphLinkKind`'s method."""
    name = None if robot is None else RobotName.parse(robot)
    kind = None if name is None else GRAPH_LINKS.get(name.link)
    return name is not None and kind is not None and kind.follows_graph_clock(name)


def _definitions(options: Mapping[str, str]) -> Sequence[Path]:
    if "types" not in options:  # the usual case: the parser of the option imports much
        return ()
    named: Sequence[Path] = import_module("robot_runner.ros.graph_addresses").named_definitions(options)
    return named


def _started(link: RobotLink, fix: str) -> GraphClock:
    clock = GraphClock(link, fix=fix)
    clock.start()
    return clock


def _clock_of(name: RobotName) -> str | None:
    chosen = name.options.get(_CLOCK)
    if chosen not in {None, _SYSTEM, _GRAPH}:
        fix = f"Write {_CLOCK}={_SYSTEM} for this machine's, or {_CLOCK}={_GRAPH} for that on /clock."
        raise LinkError(f"the clock of a run is {chosen!r}", where="robot", fix=fix)
    return chosen


def _without_clock(name: RobotName) -> RobotName:
    return replace(name, options={option: value for option, value in name.options.items() if option != _CLOCK})
