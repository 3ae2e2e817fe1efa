"""Calls of the services that nodes of ROS 2 offer for their parameters and their life cycle."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Message, RobotLink
from robot_runner.core.words import enumerated


class NodeNotReadyError(LinkError):
    """A node is not there, or is between two states: a node that was just started may need a moment."""


def full_node(link: RobotLink, node: str) -> str:
    """Return the full name of a node whose name may be relative to the link's namespace; `/` stays `/`.

    A `LinkError` says that the name is not valid.
    """
    return node if node == "/" else full_name(getattr(link, "namespace", ""), node)


def call_node(link: RobotLink, node: str, service_type: str, request: Message, *, what: str, timeout: float) -> Any:
    """Call a service that nodes of a kind offer, and return its response; `what` names the kind in errors.

    The name of the service follows from its type: `get_parameters` for `rcl_interfaces/GetParameters`.

    Raises:
        NodeNotReadyError: no node of this name offers it; the nearest is named.
        LinkError: the node does not answer in time.
    """
    full = full_node(link, node)
    service = "".join(f"_{each.lower()}" if each.isupper() else each for each in service_type.partition("/")[2])[1:]
    try:
        return link.call(f"{full}/{service}", service_type, request, timeout=timeout)
    except LinkError as error:
        known = _nodes_with(link, service)
        if known is None or full in known:
            raise
        others = f"here there is {enumerated(sorted(known))}" if known else "here there is none"
        fix = did_you_mean(full, known, f"Start it, or correct its name: {others}.")
        raise NodeNotReadyError(f"there is no {what} {full!r}", where=full, fix=fix) from error


def _nodes_with(link: RobotLink, service: str) -> set[str] | None:
    """Return the nodes that offer a service of this name; None where the graph does not answer."""
    with suppress(LinkError):
        return {name.rpartition("/")[0] for name in link.services() if name.endswith(f"/{service}")}
    return None
