"""Has running nodes of ROS 1 take parameters, where they let themselves be changed: by dynamic_reconfigure.

Source: wiki.ros.org/dynamic_reconfigure. Such a node offers a service below the name of its parameters, takes what it
can, and writes what it has then into the parameter server.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.ros.parameter_values import ParameterKind, kind_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.core.links.robot import RobotLink
    from robot_runner.ros.parameter_values import ParameterValue

_TYPE = "dynamic_reconfigure/Reconfigure"
_SERVICE = "set_parameters"
#: The field of a dynamic_reconfigure/Config for each kind; there are no arrays.
_FIELDS = {
    ParameterKind.BOOL: "bools",
    ParameterKind.INTEGER: "ints",
    ParameterKind.DOUBLE: "doubles",
    ParameterKind.STRING: "strs",
}


def reconfigurable(link: RobotLink, keys: Iterable[str]) -> set[str]:
    """Return those of the parameters, by full names, whose node takes them while it runs."""
    services = link.services()
    return {key for key in keys if services.get(_service_of(key)) == _TYPE}


def reconfigure(link: RobotLink, values: Mapping[str, ParameterValue], *, timeout: float) -> None:
    """Have running nodes take values; those of nodes that take none while they run are passed over.

    Args:
        link: to the robot, on ROS 1.
        values: by the full names of parameters.
        timeout: how long each node may take, s.

    Raises:
        LinkError: a node does not answer in time, or `dynamic_reconfigure` is not installed where rospy needs it.
    """
    configs: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for key in sorted(reconfigurable(link, values)):
        field = _FIELDS.get(kind_of(values[key]))
        if field is not None:
            entry = {"name": key.rpartition("/")[2], "value": values[key]}
            configs.setdefault(_service_of(key), {}).setdefault(field, []).append(entry)
    for service, config in configs.items():
        link.call(service, _TYPE, {"config": config}, timeout=timeout)


def _service_of(key: str) -> str:
    return f"{key.rpartition('/')[0]}/{_SERVICE}"
