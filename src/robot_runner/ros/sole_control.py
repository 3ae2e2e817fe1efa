"""Checks that no other node commands a robot, and that only one publishes its pose, before and while it moves."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from textwrap import shorten

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.commanded_topics import TWISTS
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import GraphEndpoint, GraphListing, Message, RobotLink
from robot_runner.core.words import enumerated
from robot_runner.ros.sent_commands import is_from_here, watched
from robot_runner.ros.turtlebot3.odometry import ODOMETRY
from robot_runner.ros.watchdog import TWIST, planar, velocity_of

#: How often the publishers of the pose are looked up, s: a look is a question to the ROS master or to rosapi, which
#: costs the robot's computer some milliseconds.
_PERIOD = 1.0
#: How long our thread may take to end, s: a graph that is lost answers no sooner than its own deadline.
_PATIENCE = 5.0
#: How much of a rival's message is reported, characters.
_SHOWN = 120
#: The node of our own watchdog commands the robot to stand still when a run has fallen silent.
_WATCHDOG = "robot_runner_watchdog"


class SoleControl:
    """Watches the topics of one robot; the first finding is reported, once.

    `where` is the plugin, for errors; commands may have these types; without a `pose_topic`, the pose does not matter.
    """

    def __init__(
        self,
        link: RobotLink,
        *,
        namespace: str,
        command_topic: str,
        where: str,
        pose_topic: str | None = None,
        types: Collection[str] = TWISTS,
    ) -> None:
        self._link = link
        self._pose_topic = None if pose_topic is None else full_name(namespace, pose_topic)
        self._types = types
        self._command_topic = full_name(namespace, command_topic)
        self._where = where
        self._is_over = threading.Event()
        self._closing = ExitStack()
        self._has_told = False

    def take(self, context: RobotRunnerContext, *, sole: bool) -> None:
        """Check that no other node commands the robot or publishes its pose, now and until `end`.

        If one does later, the run fails if it is to be the `sole` one; if not, its values are doubtful then.

        Raises:
            LinkError: another node does now.
        """
        if self._link.is_simulated:  # the embedded robot is alone in its world
            return
        findings = self.check()
        if sole:
            LinkError.refuse(finding for finding in findings if finding.is_error)
        for finding in findings:
            tell = context.doubt if finding.is_error else context.warn
            tell(finding.problem, fix=finding.fix)
        fix = "End what else commands or is this robot, and execute the run again."
        self.begin(context.fail if sole else partial(context.doubt, fix=fix))

    def check(self) -> Sequence[Finding]:
        """Return findings, errors and warnings, against moving this robot and no other."""
        where, commands = self._where, self._command_topic
        return [
            *self._second_robots(),
            *subscriber_type_findings(self._link, commands, self._types, where),
            *rival_findings(self._link, commands, where),
        ]

    def begin(self, tell: Callable[[str], object]) -> None:
        """Watch until `end`, in threads; call `tell` with the first problem."""
        told = {each.message_type for each in self._link.subscribers(self._command_topic)}.intersection(self._types)
        # Where the graph does not know the type, the topic carries the one that we publish.
        for message_type in sorted(told) or [TWIST if TWIST in self._types else next(iter(self._types))]:
            take = partial(self._take, message_type, tell)
            self._closing.enter_context(watched(self._command_topic))
            self._closing.callback(self._link.subscribe(self._command_topic, message_type, take, is_prompt=True).close)
        if self._pose_topic is None:
            self._closing.callback(self._is_over.set)
            return
        watching = threading.Thread(target=self._watch, args=(tell,), name="sole control", daemon=True)
        watching.start()
        self._closing.callback(watching.join, _PATIENCE)
        self._closing.callback(self._is_over.set)

    def end(self) -> None:
        """End the watch; ending twice does nothing."""
        self._closing.close()

    def _take(self, message_type: str, tell: Callable[[str], object], message: Message) -> None:
        is_velocity = message_type in TWISTS
        command = velocity_of(message_type, message) if is_velocity else message
        if not is_from_here(self._command_topic, command) and not self._is_over.is_set():
            rivals = _others(self._link.publishers(self._command_topic))
            who = named(rivals) if rivals else "another node"
            shown = _velocity(command) if is_velocity else shorten(str(command), _SHOWN)
            self._tell(tell, f"{who} commands the robot on {self._command_topic!r}: {shown}")

    def _watch(self, tell: Callable[[str], object]) -> None:
        while not self._is_over.wait(_PERIOD):
            try:
                findings = list(self._second_robots())
            except LinkError:  # a graph that is lost falls silent: the odometry says so within its own time
                continue
            for finding in findings:
                self._tell(tell, finding.problem)

    def _second_robots(self) -> Iterator[Finding]:
        if self._pose_topic is not None:
            yield from sole_publisher_findings(self._link, self._pose_topic, self._where)

    def _tell(self, tell: Callable[[str], object], problem: str) -> None:
        if not self._has_told and not self._is_over.is_set():
            self._has_told = True
            tell(problem)


# What one topic's endpoints say against moving a robot; `robot-runner check` asks the same before any run.


def sole_publisher_findings(link: GraphListing, topic: str, where: str) -> Iterator[Finding]:
    """Yield the error that several nodes publish a topic of which one may."""
    others = _others(link.publishers(topic))
    if len(others) > 1:
        problem = f"{named(others)} publish {topic!r}, so that it is not known where the robot is"
        yield Finding.error(where, problem, "End all but one of them, or give each robot a namespace.")


def subscriber_type_findings(link: GraphListing, topic: str, types: Collection[str], where: str) -> Iterator[Finding]:
    """Yield the error that no node subscribes a topic as one of these types, and some node does as another."""
    listening = _others(link.subscribers(topic))
    if listening and not any(each.message_type in types or not is_told(each.message_type) for each in listening):
        found = enumerated(sorted({each.message_type for each in listening}))
        wanted = " or ".join(sorted(types))
        problem = f"{named(listening)} subscribes {topic!r} as {found}, not {wanted}"
        yield Finding.error(where, problem, f"Have the robot subscribe {wanted}, or correct its namespace.")


def rival_findings(link: GraphListing, topic: str, where: str) -> Iterator[Finding]:
    """Yield warnings that others could command the robot on a topic, or that it commands several robots.

    Our own watchdog only stops it. Many nodes subscribe commands without being a robot, such as recorders: robots are
    those that publish an odometry, and subscribe none as a filter does; where there are none, those that have the same
    name in several namespaces.
    """
    rivals = [each for each in _others(link.publishers(topic)) if each.node.rpartition("/")[2] != _WATCHDOG]
    if rivals:
        problem = f"{named(rivals)} could command the robot, too, on {topic!r}"
        yield Finding.warning(where, problem, "End it: once it commands anything, the run fails.")
    listening = {each.node for each in _others(link.subscribers(topic)) if each.node}
    if len(listening) < 2:  # noqa: PLR2004 - one robot and one more
        return
    poses = [name for name, message_type in link.topics().items() if message_type == ODOMETRY]
    filters = {each.node for name in poses for each in link.subscribers(name)}
    moving = {each.node for name in poses for each in link.publishers(name)} - filters
    names = Counter(node.rpartition("/")[2] for node in listening)
    several = listening & moving or {node for node in listening if names[node.rpartition("/")[2]] > 1}
    if len(several) > 1:
        problem = f"{enumerated(sorted(several))} subscribe {topic!r} as two robots would, and all of them would move"
        yield Finding.warning(where, problem, "Give each robot a namespace, or remap the commands of the others.")


def named(endpoints: Iterable[GraphEndpoint]) -> str:
    """Return the nodes of endpoints, as a sentence names them."""
    return enumerated(sorted(str(each) for each in endpoints))


def is_told(type_name: str) -> bool:
    """Whether a graph knows a type: a link reports `*`, or nothing, for one that it does not know."""
    return type_name not in {"", "*"}


def _velocity(twist: Message) -> str:
    speed, rate = planar(twist)
    moves = {(part, axis) for part, values in twist.items() for axis, value in values.items() if value}
    if moves <= {("linear", "x"), ("angular", "z")}:  # else sideways, or in the air
        return f"{speed:g} m/s, {rate:g} rad/s"
    return shorten(str(twist), _SHOWN)


def _others(endpoints: Sequence[GraphEndpoint]) -> list[GraphEndpoint]:
    return [each for each in endpoints if not each.is_own]
