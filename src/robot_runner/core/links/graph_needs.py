"""What a plugin needs of the robot's graph, as it declares it: topics, services, actions and parameters of nodes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum


class GraphPart(StrEnum):
    """What of a graph is needed."""

    #: A topic that somebody publishes: the plugin subscribes it.
    PUBLISHED = "published"
    #: A topic that somebody subscribes: the plugin publishes it, as commands are.
    SUBSCRIBED = "subscribed"
    SERVICE = "service"
    ACTION = "action"
    #: A node whose parameters can be set to these values.
    PARAMETERS = "parameters"


@dataclass(frozen=True, slots=True)
class GraphNeed:
    """One thing that must be on the robot's graph before a run, as `Plugin.required_graph` declares it.

    Attributes:
        part: what it is.
        name: relative to the namespace of the plugin's robot, unless it begins with `/`.
        types: ROS names; one of them is enough; none for any type.
        is_sole: whether nobody else may publish the topic: of a topic that is published, a second publisher is an
            error; of one that the plugin commands, any other publisher is a warning.
        fix: what to do where it is not there.
        values: of parameters that are to be set, by their names, as JSON; the name is the node's then.
        sent: what is sent there, the goals of an action or the messages of a topic, as JSON: each of them is compared
            with the definition of its type, the first of `types`.

    Example:
        >>> GraphNeed.published("odom", "nav_msgs/Odometry", is_sole=True).types
        ('nav_msgs/Odometry',)
    """

    part: GraphPart
    name: str
    types: tuple[str, ...] = ()
    is_sole: bool = False
    fix: str = ""
    values: str = ""
    sent: tuple[str, ...] = ()

    @classmethod
    def published(cls, topic: str, *types: str, is_sole: bool = False, fix: str = "") -> GraphNeed:
        """Need a topic that somebody publishes."""
        return cls(GraphPart.PUBLISHED, topic, types, is_sole, fix)

    @classmethod
    def subscribed(
        cls,
        topic: str,
        *types: str,
        is_sole: bool = False,
        fix: str = "",
        messages: Iterable[Mapping[str, object]] = (),
    ) -> GraphNeed:
        """Need a topic that somebody subscribes, and on which `messages` are published."""
        return cls(GraphPart.SUBSCRIBED, topic, types, is_sole, fix, sent=tuple(map(_as_json, messages)))

    @classmethod
    def service(cls, name: str, *types: str, fix: str = "") -> GraphNeed:
        """Need a service."""
        return cls(GraphPart.SERVICE, name, types, fix=fix)

    @classmethod
    def action(cls, name: str, *types: str, fix: str = "", goals: Iterable[Mapping[str, object]] = ()) -> GraphNeed:
        """Need an action server, to which `goals` are sent."""
        return cls(GraphPart.ACTION, name, types, fix=fix, sent=tuple(map(_as_json, goals)))

    @classmethod
    def parameters(cls, node: str, values: Mapping[str, object], *, fix: str = "") -> GraphNeed:
        """Need a node whose parameters can be set to these values, as JSON holds them; nothing is set by looking."""
        return cls(GraphPart.PARAMETERS, node, fix=fix, values=json.dumps(values))


def _as_json(message: Mapping[str, object]) -> str:
    return json.dumps(message, default=_plain)


def _plain(value: object) -> object:
    """Return what JSON can hold of a value: arrays are lists; what no message can hold fits no field then, either."""
    if isinstance(value, Mapping):
        return dict(value)
    tolist = getattr(value, "tolist", None)  # of arrays and numbers: numpy's and the standard library's
    if callable(tolist):
        return tolist()
    return list(value) if isinstance(value, bytes | bytearray | memoryview) else {type(value).__name__: repr(value)}
