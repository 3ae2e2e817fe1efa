"""The base of systems that operate a robot on a graph: their claims, and the checks that they share."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import ClassVar, Protocol, TypeVar, runtime_checkable

from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import MeasureValue, Origin
from robot_runner.core.links.commanded_topics import await_subscribers
from robot_runner.core.links.connect import is_simulated, join_beforehand, resolved_robot
from robot_runner.core.links.graph_names import GraphNeed, GraphPart, full_name, namespace_prefix
from robot_runner.core.links.robot import Message, Qos, RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.plugin import Circumstances, System
from robot_runner.measuring.parameter_checks import no_robot
from robot_runner.ros.shapes import completed, plain_type

_Kept = TypeVar("_Kept")

_LOOK_AT_SUBSCRIBER = (
    "Look at the log of its node: it may have another version of the type, or cannot reach this machine."
)


def check_standard_message(name: str, type_name: str, message: Message, *, is_goal: bool = False) -> None:
    """Check a message or a goal against the definitions of ROS 2 that are built in, as the embedded robot uses them.

    Raises:
        LinkError: it does not follow its definition, or there is no such type.
    """
    from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # it takes the extra `ros`

    shape = TypeCatalogue.of(2).shape(f"{plain_type(type_name)}{'_Goal' if is_goal else ''}")
    completed(shape, message, where=name)


def misfits(check_message: Callable[..., None], need: GraphNeed, where: str) -> Iterator[Finding]:
    """Yield an error for each goal or message of a need that does not follow its definition.

    Each has a place of its own below `where`, as nothing that the experiment starts later can mend it. `check_message`
    is `check_standard_message`, or the method of a link to a graph.
    """
    is_goal = need.part is GraphPart.ACTION
    for sent in need.sent:
        try:
            check_message(need.name, need.types[0], json.loads(sent), is_goal=is_goal)
        except LinkError as error:
            place = f"{where}, {'goal' if is_goal else 'message'} of {error.where}"
            yield Finding.error(place, error.problem, error.fix)


@runtime_checkable
class TakesCommands(Protocol):
    """A kind of link whose robots all subscribe the same topics."""

    command_topics: Mapping[str, str]


class OfTheRobot:
    """A plugin that claims nothing but the robot, which the experiment itself claims."""

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return the claims beside the robot: none."""
        del robot
        return ()


class RobotSystem(OfTheRobot, System):
    """A system that operates the experiment's robot, of any kind."""

    #: What the system does, for the finding that no robot is named.
    does: ClassVar[str] = "operates a robot"
    #: A robot that the system can operate, for the same finding.
    for_example: ClassVar[str] = "simulated"
    #: The namespace of the robot on the graph, where there are several.
    namespace: str = ""

    def stand_by(self, context: RobotRunnerContext) -> None:
        """Join the graph, so that the command of `make_safe` arrives at once."""
        join_beforehand(context, namespace=self.namespace)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return findings: no robot; for the embedded one, topics and messages that it does not accept.

        On a graph, the check of that graph compares messages with the definitions there.
        """
        if circumstances.robot is not None and is_simulated(circumstances.robot):
            for need in self.required_graph(circumstances):
                yield from self._not_subscribed(need, *resolved_robot(circumstances.robot))
                if importlib.util.find_spec("rosbags") is not None:
                    yield from misfits(check_standard_message, need, f"plugin {self.name}")
        if circumstances.robot is None:
            yield no_robot(self.name, self.does, for_example=self.for_example)

    def doubt_unreached(
        self, context: RobotRunnerContext, link: RobotLink, topics: Iterable[tuple[str, str, Qos]]
    ) -> None:
        """Doubt the mission where a subscriber is not connected, as one of ROS 1 with another version of the type.

        Topics are given by name, type and QoS; the first one with such a subscriber is reported.
        """
        for topic, message_type, qos in topics:
            try:
                await_subscribers(link, topic, message_type, qos=qos)
            except LinkError as error:
                problem = f"a subscriber of {topic!r} may have missed messages of the mission: {error.problem}"
                context.doubt(problem, fix=_LOOK_AT_SUBSCRIBER)
                return

    def started(self, kept: _Kept | None) -> _Kept:
        """Return the object that `start_run` has kept for the mission.

        Raises:
            PluginError: the run was not started.
        """
        if kept is None:
            fix = "Emit start_run before launch_mission."
            raise PluginError("the mission was launched before the run was started", where=self.name, fix=fix)
        return kept

    def publish_values(
        self, context: RobotRunnerContext, values: Sequence[MeasureValue] | None, *, is_simulated: bool
    ) -> None:
        """Publish a value for each measure; nothing where `values` is None: it did not come to its end."""
        origin = Origin.SIMULATED if is_simulated else Origin.MEASURED
        if values is None:
            context.doubt("the mission was not executed to its end", fix="Look at the run's log.")
        for measure, value in zip(self.measures, values or [None] * len(self.measures), strict=True):
            context.publish(measure.name, value, origin=None if values is None else origin)

    def _not_subscribed(self, need: GraphNeed, kind: object, robot: RobotName) -> Iterator[Finding]:
        if need.part is not GraphPart.SUBSCRIBED or not isinstance(kind, TakesCommands):
            return
        namespace = f"{namespace_prefix(robot.namespace)}{namespace_prefix(self.namespace)}"
        given, where = full_name(namespace, need.name), f"plugin {self.name}"
        topics = {full_name(namespace, name): true for name, true in kind.command_topics.items()}
        if given not in topics:
            yield Finding.error(where, f"the simulated robot does not subscribe {given!r}", did_you_mean(given, topics))
        elif need.types and topics[given] not in map(plain_type, need.types):
            problem = f"the simulated robot subscribes {given!r} as {topics[given]}, not {' or '.join(need.types)}"
            yield Finding.error(where, problem, f"Name the type {topics[given]!r}.")
