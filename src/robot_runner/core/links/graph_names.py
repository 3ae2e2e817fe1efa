"""Names of topics and services: relative to a robot's namespace unless they begin with a slash."""

from __future__ import annotations

import re
from collections.abc import Iterable

from robot_runner.core.errors import LinkError, did_you_mean

#: A name that ROS 1 and ROS 2 both take (ROS 1: wiki.ros.org/Names; ROS 2: design.ros2.org, topic and service names).
_LEGAL = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


def namespace_prefix(namespace: str) -> str:
    """Return what stands before a relative name: nothing, or `/alice`.

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
    """Return the name on the graph of what a robot of this namespace calls `name`.

    Raises:
        LinkError: it cannot be a name.

    Example:
        >>> full_name("/alice", "odom"), full_name("/alice", "/map"), full_name("", "odom")
        ('/alice/odom', '/map', '/odom')
    """
    if _LEGAL.fullmatch(name) is None:
        raise _illegal("topic or service", name)
    return name if name.startswith("/") else f"{namespace_prefix(namespace)}/{name}"


def missing(kind: str, name: str, known: Iterable[str], *, where: str, fix: str) -> LinkError:
    """Return the error that there is no topic or service of this name; it names the nearest that there is.

    Example:
        >>> missing("service", "/task/stpo", ["/task/stop"], where="ros1", fix="Start its node.").fix
        "Did you mean '/task/stop'?"
    """
    return LinkError(f"there is no {kind} {name!r}", where=where, fix=did_you_mean(name, known, fix))


def _illegal(kind: str, name: str) -> LinkError:
    fix = "Use letters, digits and _ between slashes; none may begin with a digit."
    return LinkError(f"{name!r} cannot be the name of a {kind}", where="robot", fix=fix)
