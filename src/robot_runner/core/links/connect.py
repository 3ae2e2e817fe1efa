"""Connecting to robots by name: links are opened once in a run, and their kinds are found by entry points."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial

from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean, nearest
from robot_runner.core.events.context import Clock, ExperimentContext, RobotRunnerContext, SystemClock
from robot_runner.core.events.resources import R, Resources, opened_here
from robot_runner.core.links import kinds
from robot_runner.core.links.graph_names import GraphNeed, full_name, namespace_prefix
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_claims import claiming_if_commanded
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.input_files import InputFile

#: The name of the embedded robot, for messages that suggest it.
SIMULATED = "simulated"

#: A robot that is not reached after so long, s, does not answer.
_SILENCE = 1.0


def link_findings(robot: str | None) -> list[Finding]:
    """Return findings on why this robot cannot be reached, without opening anything.

    Example:
        >>> [finding.problem for finding in link_findings("simulatd")]
        ["robot is 'simulatd', which is not a link of this version"]
    """
    if robot is None:
        return []
    try:
        kind, name = resolved_robot(robot)
        return kinds.findings_of(kind, name)
    except (LinkError, PluginError) as error:
        return [error.as_finding()]


def begin_graph_look(robot: str, needs: Mapping[str, Sequence[GraphNeed]]) -> Callable[[], Sequence[Finding]] | None:
    """Begin to check that the graph of a robot has what plugins need; None where its link cannot look at a graph.

    `needs` are by the place for findings, with names relative to the robot's namespace.

    Raises:
        LinkError: there is no such robot, or a name cannot be one.
    """
    kind, name = resolved_robot(robot)
    if kind.is_simulated or not isinstance(kind, kinds.LooksAtGraph):
        return None
    full = {
        where: [replace(need, name=full_name(name.namespace, need.name)) for need in wanted]
        for where, wanted in needs.items()
    }
    return kind.begin_look(name, full)


def robot_input_files(robot: str) -> Iterable[InputFile]:
    """Return the files that the options of a robot name; raise a `LinkError` if there is no such robot."""
    kind, name = resolved_robot(robot)
    return kind.input_files(name) if isinstance(kind, kinds.ReadsFiles) else ()


def meant_robot(robot: str) -> str | None:
    """Return the robot that a name stands for: itself, or the nearest if there is no such link; None if none is near.

    Example:
        >>> meant_robot("simulatd:initial_charge=40")
        'simulated:initial_charge=40'
    """
    link, colon, options = robot.partition(":")
    known = kinds.installed_links()
    near = link if link.strip() in known else nearest(link, known)
    return None if near is None else f"{near}{colon}{options}"


def looks_for_robot(robot: str | None) -> bool:
    """Return whether a name stands for any robot that is found (`auto`)."""
    return isinstance(_kind_or_none(robot), kinds.FindsRobot)


def found_robot(robot: str | None) -> kinds.FoundRobot | None:
    """Return the robot that `auto` finds, None for any other name; raise a `LinkError` if there is none."""
    kind = _kind_or_none(robot)
    return _found(kind, str(robot)) if isinstance(kind, kinds.FindsRobot) else None


def _found(kind: kinds.FindsRobot, robot: str) -> kinds.FoundRobot:
    """Return the robot that is found; options beside `auto` are refused, as they would be lost."""
    name = RobotName.parse(robot)
    if name != RobotName(name.link):
        fix = f"Say {name.link!r} alone, or name the link: ros2://alice, dds:domain=7."
        raise LinkError(f"robot is {robot!r}, and what is looked for takes no options", where="robot", fix=fix)
    return kind.found_robot()


def is_simulated(robot: str | None) -> bool:
    """Whether a robot of this name is the embedded one, whatever its options.

    Example:
        >>> is_simulated("simulated:task_power_factor=1.1")
        True
    """
    kind = _kind_or_none(robot)
    return isinstance(kind, kinds.RobotLinkKind) and kind.is_simulated


def lives_by_simulation(context: RobotRunnerContext) -> bool:
    """Whether the run's clock is that of a simulation: of the embedded robot, or of one on a graph."""
    return is_simulated(context.robot) or getattr(context.clock, "is_simulated", False)


def open_clock(robot: str | None, resources: Resources, seed: int) -> Clock:
    """Return the clock of a run: the simulation's, the graph's where that lives by one of its own, else this machine's.

    An option such as `simulated:initial_charge=40` sets a figure of the simulated robot.

    Raises:
        LinkError: there is no link of this name, the simulator is not installed, or the graph does not tell the time.
    """
    if robot is None:
        return SystemClock()
    kind, name = resolved_robot(robot)
    return kind.open_clock(name, resources=resources, seed=seed)


def preload_robot(robot: str | None) -> None:
    """Import the client library of a robot's link, so that a process that needs nothing else connects quickly.

    Raises:
        LinkError: there is no such link.
    """
    if robot is not None:
        kind, name = resolved_robot(robot)
        if isinstance(kind, kinds.Preloads):
            kind.preload(name)


def preload_before_forks(robot: str | None) -> None:
    """Import what reaches a robot into the orchestrator, so that no forked process has to.

    Importing a simulator starts no thread; importing the client library of a real robot may, and threads do not survive
    a fork. A failing import is reported by the run.
    """
    kind = _kind_or_none(robot)
    if is_simulated(robot) or (isinstance(kind, kinds.CanBeForked) and kind.can_be_forked):
        with suppress(LinkError, ImportError):
            preload_robot(robot)


def connect_robot(context: RobotRunnerContext, *, namespace: str = "") -> RobotLink:
    """Return the link to the run's robot of this namespace; it is opened once and closed with the run.

    Raises:
        LinkError: the run has no robot, or it cannot be reached.
    """
    kind, name = run_robot(context)
    opener = partial(
        kind.open_robot,
        name,
        resources=context.resources,
        clock=context.clock,
        seed=context.run_seed,
        namespace=robot_namespace(context, namespace),
    )
    return context.resources.open(kinds.link_key("robot", namespace), opener)


class RobotTriedOnce(Resources):
    """Resources that do not wait for a robot again, under whichever namespace, that has not answered."""

    _fault: LinkError | None = None

    def open(self, key: str, opener: Callable[[], R]) -> R:
        """Open as all resources do."""
        is_robot, began = key.startswith("robot "), time.monotonic()
        if is_robot and self._fault is not None:
            raise self._fault
        try:
            return super().open(key, opener)
        except LinkError as error:
            if is_robot and time.monotonic() - began > _SILENCE:
                self._fault = error
            raise


def join_beforehand(context: RobotRunnerContext, *, namespace: str = "") -> None:
    """Connect to the run's robot if commands over a new connection would arrive late; for `System.stand_by`.

    Raises:
        LinkError: the run has no robot, or it cannot be reached.
    """
    kind, _ = run_robot(context)
    if _is_slow(kind):
        connect_robot(context, namespace=namespace)


def is_slow_to_join(robot: str) -> bool:
    """Return whether a process that joins the graph of a robot can communicate only some seconds later.

    Raises:
        LinkError: there is no such link, or no robot was found.
    """
    return _is_slow(resolved_robot(robot)[0])


def _is_slow(kind: kinds.RobotLinkKind) -> bool:
    return isinstance(kind, kinds.JoinsGraph) and kind.is_slow_to_join


def robot_on_graph(robot: str) -> str:
    """Return an identifier of a robot, however it is reached: its graph, and its namespace there.

    For `auto`, whose robot is not known yet, it is the name.

    Raises:
        LinkError: there is no such link.

    Example:
        >>> robot_on_graph("dds:namespace=alice,domain=7"), robot_on_graph("rosbridge://10.0.0.7")
        ('domain 7/alice', 'rosbridge 10.0.0.7:9090')
    """
    if looks_for_robot(robot):
        return robot
    return f"{graph_of_robot(robot)}{namespace_prefix(resolved_robot(robot)[1].namespace)}"


def graph_of_robot(robot: str) -> str:
    """Return an identifier of a robot's graph, the same for all robots there.

    Raises:
        LinkError: there is no such link, or no robot was found.

    Example:
        >>> graph_of_robot("dds:namespace=alice,domain=7") == graph_of_robot("ros2:domain=7")
        True
    """
    return _graph_of(*resolved_robot(robot))


def _graph_of(kind: kinds.RobotLinkKind, name: RobotName) -> str:
    graph = kind.graph_of(name) if isinstance(kind, kinds.TellsGraphs) else name.graph
    return graph.rstrip("/")


def graph_variables(robot: str | None, *, is_here: bool = True) -> Mapping[str, str]:
    """Return the environment variables by which a program joins the graph of a robot, as far as its name has them.

    Args:
        robot: how it is reached; None where there is none.
        is_here: whether the program is executed on this machine.

    Raises:
        LinkError: there is no such link.

    Example:
        >>> graph_variables("ros2:domain=7,namespace=alice"), graph_variables("ros2://alice")
        ({'ROS_DOMAIN_ID': '7'}, {})
    """
    if robot is None:
        return {}
    kind, name = resolved_robot(robot)
    return kind.program_variables(name, is_here=is_here) if isinstance(kind, kinds.PutsOnGraph) else {}


def run_robot(context: RobotRunnerContext) -> tuple[kinds.RobotLinkKind, RobotName]:
    """Return the kind of link of the run's robot, and its name.

    Raises:
        LinkError: the run has no robot, there is no such link, or no robot was found.
    """
    if context.robot is None:
        fix = f"Name one in the config: robot = {SIMULATED!r}. Or: --set robot={SIMULATED}."
        raise LinkError("the experiment names no robot", where="robot", fix=fix)
    return resolved_robot(context.robot)


def resolved_robot(robot: str) -> tuple[kinds.RobotLinkKind, RobotName]:
    """Return the kind of link of a robot's name, and the name; for `auto` those of the robot that is found.

    Raises:
        LinkError: there is no such link, or no robot was found.
    """
    name = RobotName.parse(robot)
    kind = kinds.link_kind(name.link)
    if isinstance(kind, kinds.FindsRobot):
        return resolved_robot(_found(kind, robot).name)
    if kind is not None:
        return kind, _with_namespace(robot, name if name.address is None or kind.takes_address else name.on_graph)
    links = kinds.installed_links()
    fix = did_you_mean(robot.partition(":")[0], links, f"Choose one of {', '.join(links)}: --set robot={SIMULATED}.")
    raise LinkError(f"robot is {robot!r}, which is not a link of this version", where="robot", fix=fix)


def _with_namespace(robot: str, name: RobotName) -> RobotName:
    try:
        namespace_prefix(name.namespace)
    except LinkError as error:
        problem = f"robot is {robot!r}, which names a robot of a graph by its namespace: {error.problem}"
        fix = f"Say {name.link}://alice, or {name.link} for all of it."
        raise LinkError(problem, where="robot", fix=fix) from error
    return name


def robot_namespace(context: ExperimentContext, namespace: str = "") -> str:
    """Return the full namespace for a plugin's `namespace`: below that of the run's robot, if it has one.

    Raises:
        LinkError: there is no such robot.
    """
    return _below("" if context.robot is None else resolved_robot(context.robot)[1].namespace, namespace)


def _below(own: str, namespace: str) -> str:
    """Return a namespace below that of a robot, which may be none."""
    return f"{namespace_prefix(own)}{namespace_prefix(namespace)}" if own else namespace


@contextmanager
def open_robot(robot: str, *, namespace: str = "", seed: int = 1) -> Iterator[tuple[RobotLink, Clock]]:
    """Reach a robot outside of a run, as a node of your own does, and leave it when the block ends.

    What a callback leaves open is closed as its run ends, or the experiment: the robot stands still. In an experiment,
    a real robot is claimed before its first velocity or goal, until the run ends, or in a callback of the orchestrator
    until the link is closed. Where another run, experiment or user has claimed it, commanding it raises a `LinkError`.

    Args:
        robot: as in a config, such as `dds:domain=7,clock=graph`.
        namespace: which robot, where there are several.
        seed: of a simulated one.

    Yields:
        the link, and the clock that the robot lives by.

    Raises:
        LinkError: it cannot be reached.

    Example:
        >>> with open_robot("simulated") as (link, clock):
        ...     link.wait_for("odom", "nav_msgs/Odometry")["child_frame_id"]
        'base_footprint'
    """
    kind, name = resolved_robot(robot)
    within = _below(name.namespace, namespace)
    with claiming_if_commanded(robot, name.graph, _graph_of(kind, name), within), opened_here() as resources:
        clock = kind.open_clock(name, resources=resources, seed=seed)
        link = kind.open_robot(name, resources=resources, clock=clock, seed=seed, namespace=within)
        resources.open("robot", lambda: link)
        yield link, clock


def _kind_or_none(robot: str | None) -> kinds.RobotLinkKind | kinds.FindsRobot | None:
    """Return the kind of link of a robot's name; one that cannot be imported is left to `link_findings`."""
    try:
        return None if robot is None else kinds.link_kind(robot.partition(":")[0].strip())
    except PluginError:
        return None


#: The topic, in the robot's namespace, that marks a simulated robot on a graph.
SIMULATION_TOPIC = "robot_runner/simulation"
_CLOCK = "/clock"


def is_simulation(link: RobotLink, namespace: str = "") -> bool:
    """Whether there is a simulated robot behind a link: the embedded one, or one on a graph that shows a sign of it.

    The signs are the mark of `robot-runner simulate`, and a `/clock`: a graph with real robots needs none, unless this
    link alone tells the time, as of a bag that it plays. They are looked for after the mission: a graph may be known
    only seconds after it was joined, and to look takes time, which is not to be measured.

    Raises:
        LinkError: the graph cannot be reached.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> is_simulation(FakeRobotLink(FakeClock(), is_simulated=True))
        True
    """
    if link.is_simulated:
        return True
    topics = link.topics()
    is_own = {each.is_own for each in link.publishers(_CLOCK)} if _CLOCK in topics else {True}
    return is_own != {True} or full_name(namespace, SIMULATION_TOPIC) in topics
