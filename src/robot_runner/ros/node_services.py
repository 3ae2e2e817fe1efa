"""The services that nodes of ROS 2 offer for their parameters and their life cycle: their types, and calls of them.

Source: rcl_interfaces and lifecycle_msgs 1.2 (Humble) and later, which are the same in these; tf2_msgs of noetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Any

from robot_runner.core.errors import LinkError, nearest
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Message, RobotLink
from robot_runner.core.words import enumerated

_PARAMETERS = {
    "GetParameters": "string[] names\n---\nrcl_interfaces/ParameterValue[] values\n",
    "SetParameters": "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult[] results\n",
    "SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult result\n"
    ),
    "ListParameters": "string[] prefixes\nuint64 depth\n---\nrcl_interfaces/ListParametersResult result\n",
    "DescribeParameters": "string[] names\n---\nrcl_interfaces/ParameterDescriptor[] descriptors\n",
    "GetParameterTypes": "string[] names\n---\nuint8[] types\n",
}
#: Of ROS 1, dynamic_reconfigure 1.7.
_RECONFIGURE = {
    "BoolParameter.msg": "string name\nbool value\n",
    "IntParameter.msg": "string name\nint32 value\n",
    "StrParameter.msg": "string name\nstring value\n",
    "DoubleParameter.msg": "string name\nfloat64 value\n",
    "GroupState.msg": "string name\nbool state\nint32 id\nint32 parent\n",
    "Config.msg": (
        "BoolParameter[] bools\nIntParameter[] ints\nStrParameter[] strs\nDoubleParameter[] doubles\n"
        "GroupState[] groups\n"
    ),
    "Reconfigure.srv": "Config config\n---\nConfig config\n",
}
_LIFE_CYCLE = {
    "ChangeState": "lifecycle_msgs/Transition transition\n---\nbool success\n",
    "GetState": "---\nlifecycle_msgs/State current_state\n",
    "GetAvailableStates": "---\nlifecycle_msgs/State[] available_states\n",
    "GetAvailableTransitions": "---\nlifecycle_msgs/TransitionDescription[] available_transitions\n",
}

#: The text of each definition by its file's name, for each generation of ROS; type stores lack them.
NODE_TYPES: Mapping[int, Mapping[str, str]] = MappingProxyType(
    {
        1: {
            "tf2_msgs/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n",
            **{f"dynamic_reconfigure/{name}": text for name, text in _RECONFIGURE.items()},
        },
        2: {
            **{f"rcl_interfaces/{name}.srv": text for name, text in _PARAMETERS.items()},
            **{f"lifecycle_msgs/{name}.srv": text for name, text in _LIFE_CYCLE.items()},
        },
    }
)


class NodeNotReadyError(LinkError):
    """A node is not there, or is on its way to another state: one that was just started may need a moment."""


def full_node(link: RobotLink, node: str) -> str:
    """Return the full name of a node that is named relative to a link's namespace; `/` stays what it is.

    Raises:
        LinkError: it cannot be a name.
    """
    return node if node == "/" else full_name(getattr(link, "namespace", ""), node)


def call_node(link: RobotLink, node: str, service_type: str, request: Message, *, what: str, timeout: float) -> Any:
    """Call one of the services that nodes of a kind offer, and return its response; for errors, `what` says which kind.

    The service of the type `rcl_interfaces/GetParameters` is called `get_parameters`.

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
        near = nearest(full, known)
        others = f"here there is {enumerated(sorted(known))}" if known else "here there is none"
        fix = f"Did you mean {near!r}?" if near else f"Start it, or correct its name: {others}."
        raise NodeNotReadyError(f"there is no {what} {full!r}", where=full, fix=fix) from error


def _nodes_with(link: RobotLink, service: str) -> set[str] | None:
    """Return the nodes that offer a service of this name; None where the graph cannot be asked."""
    with suppress(LinkError):
        return {name.rpartition("/")[0] for name in link.services() if name.endswith(f"/{service}")}
    return None
