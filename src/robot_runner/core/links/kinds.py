"""The protocols of kinds of robot links, and finding installed ones by entry points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from robot_runner.core.entry_points import entry_points, instances_of, named_entry_point
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
    """One way to reach a robot: an object in the entry point group `robot_runner.links`, imported when it is used.

    Importing it must be cheap: its findings are asked for before anything is executed.
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
        """Return findings on why a robot of this name cannot be reached, without opening anything.

        Raises:
            LinkError: the name is invalid; becomes a finding.
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
        """Return the clock of a run with this robot; it is closed with `resources`.

        Raises:
            LinkError: the robot cannot be reached, or does not tell the time.
        """


@runtime_checkable
class Preloads(Protocol):
    """A kind of link whose client library takes long to import."""

    def preload(self, name: RobotName) -> None:
        """Import it; nothing is opened."""


@runtime_checkable
class CanBeForked(Protocol):
    """A kind of link to real robots that tells whether processes can be forked once its library is imported."""

    @property
    def can_be_forked(self) -> bool:
        """Whether the import starts no thread."""


@runtime_checkable
class JoinsGraph(Protocol):
    """A kind of link that joins a graph."""

    @property
    def is_slow_to_join(self) -> bool:
        """Whether a new participant can communicate only some seconds later, so that the standby joins beforehand."""


@runtime_checkable
class TellsGraphs(Protocol):
    """A kind of link that can tell whether two names mean one graph."""

    def graph_of(self, name: RobotName) -> str:
        """Return an identifier of a robot's graph, however it is reached: `domain 7`.

        Raises:
            LinkError: the name is invalid.
        """


@runtime_checkable
class PutsOnGraph(Protocol):
    """A kind of link whose graph other programs can join by environment variables."""

    def program_variables(self, name: RobotName, *, is_here: bool) -> Mapping[str, str]:
        """Return the variables by which a program joins the graph of a robot, as far as its name has them.

        Args:
            name: of the robot.
            is_here: whether the program is executed on this machine.
        """


@runtime_checkable
class LooksAtGraph(Protocol):
    """A kind of link that can check, before anything is executed, that its graph has what plugins need."""

    def begin_look(self, name: RobotName, needs: Mapping[str, Sequence[GraphNeed]]) -> Callable[[], Sequence[Finding]]:
        """Begin to look, in a process of its own, and return a function that waits for the findings, with a deadline.

        Nothing is moved, changed or started by looking.

        Args:
            name: of the robot.
            needs: with full names, by the place for findings (`plugin Arm`).
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
            LinkError: none is found; the problem says what was looked for.
        """


def installed_links() -> list[str]:
    """Return the names of the links that are installed, our own first."""
    return list(dict.fromkeys(point.name for point in entry_points(_GROUP)))


def link_kind(link: str) -> RobotLinkKind | FindsRobot | None:
    """Return the kind of link of this name, or None where none is installed.

    Raises:
        PluginError: it cannot be imported, or does not have the protocol.

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


def findings_of(kind: RobotLinkKind, name: RobotName) -> list[Finding]:
    """Return the findings of a kind of link on a robot.

    Raises:
        LinkError: the name is invalid.
        PluginError: it is of another package, and failed.
    """
    point = named_entry_point(_GROUP, name.link)
    if point is None:
        return kind.findings(name)
    return point.called(lambda: instances_of(Finding, kind.findings(name)))


def link_key(what: str, namespace: str) -> str:
    """Return the key under which a run keeps its link to the robot of a namespace: `what` is robot, serial or host.

    The fakes of `robot_runner.testing` are put in place under the same keys.

    Example:
        >>> link_key("robot", "/alice"), link_key("serial", "")
        ('robot alice', 'serial /')
    """
    return f"{what} {namespace.strip('/') or '/'}"
