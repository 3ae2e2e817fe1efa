"""The services that every node of ROS 2 offers for its parameters and its life cycle, and the message of transforms.

Source: rcl_interfaces and lifecycle_msgs 1.2 (Humble) and later, which are the same in these; tf2_msgs of noetic.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["NODE_TYPES"]

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
_LIFE_CYCLE = {
    "ChangeState": "lifecycle_msgs/Transition transition\n---\nbool success\n",
    "GetState": "---\nlifecycle_msgs/State current_state\n",
    "GetAvailableStates": "---\nlifecycle_msgs/State[] available_states\n",
    "GetAvailableTransitions": "---\nlifecycle_msgs/TransitionDescription[] available_transitions\n",
}

#: The text of each definition by its file's name, for each generation of ROS; type stores lack them.
NODE_TYPES: Mapping[int, Mapping[str, str]] = MappingProxyType(
    {
        1: {"tf2_msgs/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n"},
        2: {
            **{f"rcl_interfaces/{name}.srv": text for name, text in _PARAMETERS.items()},
            **{f"lifecycle_msgs/{name}.srv": text for name, text in _LIFE_CYCLE.items()},
        },
    }
)
