"""Conditions of a robot's graph: a node, a topic or a service is there, or a managed node is in a state."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass

from robot_runner.core.errors import ConditionError, Finding, LinkError, did_you_mean, nearest
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import SIMULATED, connect_robot, robot_namespace
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import AsksNodes, RobotLink


def node_present(node: str, *, namespace: str = "") -> Condition:
    """Return the condition that a node is on the robot's graph, and answers where that lists killed ones (ROS 1).

    Args:
        node: its name, relative to the robot's namespace unless it begins with `/`.
        namespace: which robot, where there are several.

    Raises:
        LinkError: it cannot be a name.

    Example:
        >>> print(node_present("move_base"))
        the node /move_base is there
    """
    return _Present("node", checked_name(node, namespace), namespace)


def topic_present(topic: str, message_type: str | None = None, *, namespace: str = "") -> Condition:
    """Return the condition that a topic is on the robot's graph: a node publishes or subscribes it.

    A subscription of the run's own counts, too; await a message (`message_on`) where a node must publish.

    Args:
        topic: its name, relative to the robot's namespace unless it begins with `/`.
        message_type: its type; by default any.
        namespace: which robot, where there are several.

    Raises:
        ConditionError: it cannot be a type.
        LinkError: it cannot be a name.

    Example:
        >>> print(topic_present("scan", "sensor_msgs/LaserScan"))
        the topic /scan (sensor_msgs/LaserScan) is there
    """
    if message_type is not None:
        check_type_named(message_type, where=topic)
    return _Present("topic", checked_name(topic, namespace), namespace, message_type)


def service_present(service: str, *, namespace: str = "") -> Condition:
    """Return the condition that a service is on the robot's graph; as `node_present`."""
    return _Present("service", checked_name(service, namespace), namespace)


def lifecycle_state(node: str, state: str = "active", *, namespace: str = "") -> Condition:
    """Return the condition that a managed node of ROS 2 is in a state of its life cycle.

    Args:
        node: its name, relative to the robot's namespace unless it begins with `/`.
        state: `unconfigured`, `inactive`, `active` or `finalized`.
        namespace: which robot, where there are several.

    Raises:
        ConditionError: there is no such state.
        LinkError: it cannot be a name.

    Example:
        >>> print(lifecycle_state("slam_toolbox"))
        the node /slam_toolbox is active
    """
    if state not in _STATES:
        raise ConditionError(f"{state!r} is not a state of a node", where=node, fix=did_you_mean(str(state), _STATES))
    return _InState(checked_name(node, namespace), state, namespace)


def checked_name(name: str, namespace: str) -> str:
    """Return a name; a `ConditionError` says that it or its namespace is no text, a `LinkError` that it is no name."""
    for each in (name, namespace):
        if not isinstance(each, str):
            raise ConditionError(f"{each!r} is not a name", where="condition", fix="Give a text.")
    full_name(namespace, name)
    return name


def check_type_named(message_type: object, *, where: str) -> None:
    """Check that a message type has a package and a name; a `ConditionError` says that it has not."""
    if not isinstance(message_type, str) or not re.fullmatch(r"\w+(/msg)?/\w+", message_type):
        fix = "Give it with its package: 'sensor_msgs/LaserScan'."
        raise ConditionError(f"{message_type!r} is not the type of a message", where=where, fix=fix)


def check_robot_named(what: str, robot: str | None) -> Iterable[Finding]:
    """Yield an error where a condition needs a robot and the experiment has none."""
    if robot is None:
        fix = f"Name one in the config: robot = {SIMULATED!r}. Or: --set robot={SIMULATED}."
        yield Finding.error(f"condition {what!r}", "the condition is about a robot, and the experiment names none", fix)


#: The primary states of lifecycle_msgs/State.
_STATES = ("unconfigured", "inactive", "active", "finalized")
#: How long a node may take to answer, s; a busy one may answer at the next look.
_ANSWER = 1.0


class _OnGraph(Condition):
    """A condition of the robot's graph."""

    namespace: str

    #: Seldom, as each look is a question to the graph or to a node.
    every_s = 0.25

    def check(self, robot: str | None) -> Iterable[Finding]:
        return check_robot_named(str(self), robot)

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        del opened
        if context.robot is None:
            raise ConditionError("the experiment names no robot", where=str(self), fix="Name one in the config: robot.")

        def look() -> Look:
            try:
                link = connect_robot(context, namespace=self.namespace)
                return self.judged(link, robot_namespace(context, self.namespace))
            except LinkError as error:
                return Look(holds=False, seen=error.problem, is_known=False)

        return look

    @abstractmethod
    def judged(self, link: RobotLink, namespace: str) -> Look:
        """Return the look at the graph; names are relative to `namespace`. A `LinkError`: nothing was seen."""


@dataclass(frozen=True)
class _InState(_OnGraph):
    node: str
    state: str
    namespace: str

    def __str__(self) -> str:
        return f"the node {full_name(self.namespace, self.node)} is {self.state}"

    def judged(self, link: RobotLink, namespace: str) -> Look:
        node = full_name(namespace, self.node)
        told = link.call(f"{node}/get_state", "lifecycle_msgs/GetState", timeout=_ANSWER)
        state = str(told["current_state"]["label"])
        return Look(holds=state == self.state, seen=f"{node} is {state}", value=state)


@dataclass(frozen=True)
class _Present(_OnGraph):
    kind: str
    name: str
    namespace: str
    message_type: str | None = None

    def __str__(self) -> str:
        of_type = f" ({self.message_type})" if self.message_type else ""
        return f"the {self.kind} {full_name(self.namespace, self.name)}{of_type} is there"

    def judged(self, link: RobotLink, namespace: str) -> Look:
        name = full_name(namespace, self.name)
        there = {"node": link.nodes, "topic": link.topics, "service": link.services}[self.kind]()
        if name not in there:
            near = nearest(name, there)
            if self.kind == "service" and not there:
                return Look(holds=False, seen="the graph does not list its services", is_known=False)
            seen = f"{len(there)} {self.kind}s are there{f', among them {near}' if near else ''}"
            return Look(holds=False, seen=f"{name} is not: {seen}")
        if self.kind == "node" and isinstance(link, AsksNodes) and not link.answers(name):
            return Look(holds=False, seen=f"{name} is listed by the graph and does not answer")
        found = link.topics().get(name) if self.message_type else None
        if self.message_type and found != self.message_type.replace("/msg/", "/"):  # the spelling of ROS 2
            is_known = found != "*"  # the type of a topic whose type is not known
            said = f"carries {found}" if is_known else "nothing tells what it carries"
            return Look(holds=False, seen=f"{name} is there and {said}", is_known=is_known)
        return Look(holds=True, seen=f"{name} is there")
