"""Names on a robot's graph, relative to its namespace unless they begin with a slash, and what a plugin needs there.

Fields of messages have names with dots: `pose.pose.position.x`, `ranges.0`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Message
from robot_runner.core.storage.outliving import program_name

#: A name that ROS 1 and ROS 2 both take (ROS 1: wiki.ros.org/Names; ROS 2: design.ros2.org, topic and service names).
_LEGAL = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

#: The name of a node of ours over ROS 2 and DDS, with the id of its process.
_OURS = re.compile(r"/robot_runner_(\d+)(?:_[0-9a-f]+)?")


def namespace_prefix(namespace: str) -> str:
    """Return the prefix of relative names: empty, or `/alice`.

    Raises:
        LinkError: it cannot be the name of a namespace.

    Example:
        >>> namespace_prefix("alice"), namespace_prefix("/"), namespace_prefix("")
        ('/alice', '', '')
    """
    name = namespace.strip("/")
    if name and _LEGAL.fullmatch(name) is None:
        raise _illegal("namespace", namespace)
    return f"/{name}" if name else ""


def full_name(namespace: str, name: str) -> str:
    """Return the full name on the graph for `name` in a namespace.

    Raises:
        LinkError: it cannot be a name.

    Example:
        >>> full_name("/alice", "odom"), full_name("/alice", "/map"), full_name("", "odom")
        ('/alice/odom', '/map', '/odom')
    """
    if _LEGAL.fullmatch(name) is None:
        raise _illegal("topic or service", name)
    return name if name.startswith("/") else f"{namespace_prefix(namespace)}/{name}"


def is_left_by_the_dead(node: str) -> bool:
    """Return whether a node has the name of one of ours, and its process on this machine is dead.

    Another computer's may have the same name.

    Example:
        >>> is_left_by_the_dead("/robot"), is_left_by_the_dead("/robot_runner_4194304_3fc1")
        (False, True)
    """
    of_ours = _OURS.fullmatch(node)
    return of_ours is not None and program_name(int(of_ours[1])) is None


def missing(kind: str, name: str, known: Iterable[str], *, where: str, fix: str) -> LinkError:
    """Return the error for a missing topic or service, with the nearest name that exists.

    Example:
        >>> missing("service", "/task/stpo", ["/task/stop"], where="ros1", fix="Start its node.").fix
        "Did you mean '/task/stop'?"
    """
    return LinkError(f"there is no {kind} {name!r}", where=where, fix=did_you_mean(name, known, fix))


def _illegal(kind: str, name: str) -> LinkError:
    fix = "Use letters, digits and _ between slashes; none may begin with a digit."
    return LinkError(f"{name!r} cannot be the name of a {kind}", where="robot", fix=fix)


class GraphPart(StrEnum):
    """The kinds of needs."""

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
        types: accepted ROS types; none for any type.
        is_sole: whether it must have no other publisher: a second publisher of a published topic is an error, any other
            publisher of a topic that the plugin commands a warning.
        fix: what to do where it is missing.
        values: values of parameters to be set, by name, as JSON; `name` is the node then.
        sent: goals of the action or messages of the topic, as JSON: each is compared with the definition of its type,
            the first of `types`.

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
    """Return a value for JSON: arrays become lists; an object that no message can have becomes a mapping."""
    if isinstance(value, Mapping):
        return dict(value)
    tolist = getattr(value, "tolist", None)  # of arrays and numbers: numpy's and the standard library's
    if callable(tolist):
        return tolist()
    return list(value) if isinstance(value, bytes | bytearray | memoryview) else {type(value).__name__: repr(value)}


def field_of(message: Message, field: str, *, where: str) -> Any:
    """Return the field of a message, whatever it is.

    `field` is the way to it; a number names an element of an array, and a negative one counts from its end.

    Raises:
        LinkError: there is no such field.

    Example:
        >>> field_of({"poses": [{"x": 1.0}, {"x": 2.0}]}, "poses.-1.x", where="goal")
        2.0
    """
    found: Any = message
    for name in field.split("."):
        if isinstance(found, Mapping):
            if name not in found:
                fix = did_you_mean(name, map(str, found))
                raise LinkError(f"the message has no field {field!r}", where=where, fix=fix)
            found = found[name]
        else:
            found = _element(found, name, field, where)
    return found


def _element(found: Any, name: str, field: str, where: str) -> Any:
    if isinstance(found, Sequence) and re.fullmatch(r"-?\d{1,9}", name) and -len(found) <= int(name) < len(found):
        return found[int(name)]
    fix = "Name a field with its numbers, as in 'ranges.0'."
    raise LinkError(f"the message has no field {field!r}", where=where, fix=fix)


def is_time(value: object) -> bool:
    """Return whether a field is a time or a duration of ROS.

    Example:
        >>> is_time({"sec": 1, "nanosec": 500_000_000})
        True
    """
    return isinstance(value, Mapping) and value.keys() == {"sec", "nanosec"}
