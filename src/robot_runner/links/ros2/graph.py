"""Questions about a graph of ROS 2: who is there, what is published and of what type."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError
from robot_runner.links.shapes import plain_type

if TYPE_CHECKING:
    from robot_runner.links.ros2.node import GraphNode

__all__ = ["Graph", "check_type"]


class Graph:
    """What rclpy knows of a graph.

    Args:
        node: on it.
    """

    def __init__(self, node: GraphNode) -> None:
        self._node = node

    def topics(self) -> dict[str, str]:
        """Return the type of each topic by its full name."""
        self._node.settle()
        found = self._node.node.get_topic_names_and_types()
        return {name: plain_type(types[0]) for name, types in sorted(found) if types}

    def nodes(self) -> list[str]:
        """Return the full names of the nodes, sorted."""
        self._node.settle()
        return sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in self._names())

    def services(self) -> dict[str, str]:
        """Return the type of each service that a node offers, by its full name."""
        self._node.settle()
        return self._offered()

    def service_type(self, name: str) -> str | None:
        """Return the type of a service, or None where nobody offers it; it does not wait."""
        return self._offered().get(name)

    def publishers(self, topic: str) -> list[Any]:
        """Return what there is to know about the publishers of a topic: `topic_type`, `qos_profile`, node's name."""
        return list(self._node.node.get_publishers_info_by_topic(topic))

    def listeners(self, topic: str) -> list[Any]:
        """Return the same of those who hear a topic."""
        return list(self._node.node.get_subscriptions_info_by_topic(topic))

    def _offered(self) -> dict[str, str]:
        # Asked node by node: the list of all services has those that are merely called, too.
        found: dict[str, str] = {}
        for name, namespace in self._names():
            try:
                offered = self._node.node.get_service_names_and_types_by_node(name, namespace)
            except RuntimeError:  # it left the graph just now
                continue
            found |= {service: plain_type(types[0]) for service, types in offered if types}
        return dict(sorted(found.items()))

    def _names(self) -> list[tuple[str, str]]:
        return list(self._node.node.get_node_names_and_namespaces())


def check_type(name: str, wanted: str, endpoints: list[Any]) -> None:
    """Refuse if somebody on a topic has another type.

    Raises:
        LinkError: somebody has.
    """
    for endpoint in endpoints:
        true = plain_type(endpoint.topic_type)
        if true != plain_type(wanted):
            who = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
            fix = f"Name the type {true!r}, or another topic."
            raise LinkError(f"the topic carries {true} (of {who}), not {plain_type(wanted)}", where=name, fix=fix)
