"""The kinds of robot link that are installed: each is announced by an entry point, as anybody's is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from robot_runner.core.entry_points import entry_points, named_entry_point
from robot_runner.core.errors import Finding
from robot_runner.core.events.context import Clock
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.input_files import InputFile

_GROUP = "links"


@runtime_checkable
class RobotLinkKind(Protocol):
    """One way to reach a robot, as the group `robot_runner.links` names it: an object, imported once it is asked for.

    Importing it must be cheap: it is asked what stands in its way before anything is executed, and never opened then.
    """

    @property
    def description(self) -> str:
        """What it is, in one line."""

    @property
    def takes_address(self) -> bool:
        """Whether a robot is named by an address (`rosbridge://robot:9090`), and not by the link and its options."""

    @property
    def is_simulated(self) -> bool:
        """Whether each robot behind it is a simulation, so that it needs nothing of the real world."""

    def findings(self, name: RobotName) -> list[Finding]:
        """Return what stands in the way of reaching a robot of this name; nothing is opened by asking.

        Raises:
            LinkError: the name cannot be one; becomes a finding.
        """

    def open_robot(
        self, name: RobotName, *, resources: Resources, clock: Clock, seed: int, namespace: str
    ) -> RobotLink:
        """Open a link to the robot of this namespace; the caller closes it with the run.

        Args:
            name: of the robot, with its options.
            resources: the run's, for what several links of it share.
            clock: the run's.
            seed: the run's, for what is simulated.
            namespace: the robot's, such as `/alice`.

        Raises:
            LinkError: the robot cannot be reached.
        """

    def open_clock(self, name: RobotName, *, resources: Resources, seed: int) -> Clock:
        """Return the clock that a run with this robot lives by; it is closed with `resources`.

        Raises:
            LinkError: the robot cannot be reached, or does not tell the time.
        """


@runtime_checkable
class Preloads(Protocol):
    """A kind of link whose client library takes long to import."""

    def preload(self, name: RobotName) -> None:
        """Import it; nothing is opened."""


@runtime_checkable
class JoinsGraph(Protocol):
    """A kind of link that joins a graph."""

    @property
    def is_slow_to_join(self) -> bool:
        """Whether a new participant is not heard at once, so that the standby joins beforehand."""


@runtime_checkable
class TellsGraphs(Protocol):
    """A kind of link that can tell whether two names mean one graph."""

    def graph_of(self, name: RobotName) -> str:
        """Return what tells the graph of a robot from any other, however it is reached: `domain 7`.

        Raises:
            LinkError: the name cannot be one.
        """


@runtime_checkable
class PutsOnGraph(Protocol):
    """A kind of link whose graph other programs join, which find it by their environment."""

    def program_variables(self, name: RobotName, *, is_here: bool) -> Mapping[str, str]:
        """Return the variables by which a program joins the graph of a robot: those that the name says.

        Args:
            name: of the robot.
            is_here: whether the program is executed on this machine.
        """


@runtime_checkable
class LooksAtGraph(Protocol):
    """A kind of link that can look, before anything is executed, whether its graph has what plugins need."""

    def begin_look(self, name: RobotName, needs: Mapping[str, Sequence[GraphNeed]]) -> Callable[[], Sequence[Finding]]:
        """Begin to look, in a process of its own, and return what waits for the findings, within a deadline.

        Nothing is moved, changed or started by looking.

        Args:
            name: of the robot.
            needs: what is needed, with full names, by the place that findings are to name (`plugin Arm`).
        """


@runtime_checkable
class ReadsFiles(Protocol):
    """A kind of link whose options name files, such as definitions of messages."""

    def input_files(self, name: RobotName) -> Iterable[InputFile]:
        """Return those that a robot of this name reads."""


@dataclass(frozen=True, slots=True)
class FoundRobot:
    """How a robot can be reached from here.

    Attributes:
        name: what to write for `robot`.
        reason: why it was chosen.
    """

    name: str
    reason: str


@runtime_checkable
class FindsRobot(Protocol):
    """A kind of link that stands for another one, which it looks for."""

    @property
    def description(self) -> str:
        """What it is, in one line."""

    def found_robot(self) -> FoundRobot:
        """Return the robot that is there.

        Raises:
            LinkError: none is found; it says what was looked for.
        """


def installed_links() -> list[str]:
    """Return the names of the links that are installed, our own first."""
    return list(dict.fromkeys(point.name for point in entry_points(_GROUP)))


def link_kind(link: str) -> RobotLinkKind | FindsRobot | None:
    """Return the kind of link of this name, or None where none is installed.

    Raises:
        PluginError: it cannot be imported, or is no kind of link.

    Example:
        >>> link_kind("gazebo") is None
        True
    """
    point = named_entry_point(_GROUP, link)
    if point is None:
        return None
    kind = point.load()
    if not isinstance(kind, RobotLinkKind | FindsRobot):
        raise point.refusal("does not keep to the protocol RobotLinkKind")
    return kind


def link_key(what: str, namespace: str) -> str:
    """Return the key under which a run keeps its link to the robot of a namespace: `what` is robot, serial or host.

    The fakes of `robot_runner.testing` are put in place under the same keys.

    Example:
        >>> link_key("robot", "/alice"), link_key("serial", "")
        ('robot alice', 'serial /')
    """
    return f"{what} {namespace.strip('/') or '/'}"
