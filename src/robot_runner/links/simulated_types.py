"""The types that the embedded robot takes and answers with: known without any ROS package."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.links.shapes import Field, Shape, plain_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.links.type_catalogue import TypeCatalogue

__all__ = ["message_shape", "request_shape", "response_shape", "standard_types"]

_VECTOR = Shape("geometry_msgs/Vector3", tuple(Field(axis, "float64") for axis in "xyz"))
_MESSAGES: Mapping[str, Shape] = MappingProxyType(
    {
        "geometry_msgs/Twist": Shape("geometry_msgs/Twist", (Field("linear", _VECTOR), Field("angular", _VECTOR))),
        "std_msgs/Empty": Shape("std_msgs/Empty"),
    }
)
_TRIGGERED = (Field("success", "bool"), Field("message", "string"))
_REQUESTS: Mapping[str, Shape] = MappingProxyType({"std_srvs/Trigger": Shape("std_srvs/Trigger")})
_RESPONSES: Mapping[str, Shape] = MappingProxyType({"std_srvs/Trigger": Shape("std_srvs/Trigger", _TRIGGERED)})


def message_shape(message_type: str) -> Shape:
    """Return what a message type is made of.

    Raises:
        LinkError: there is no such type, or it takes `rosbags` to know it.

    Example:
        >>> message_shape("geometry_msgs/Twist").names
        ('linear', 'angular')
    """
    return _MESSAGES.get(plain_type(message_type)) or standard_types().shape(message_type)


def request_shape(service_type: str) -> Shape:
    """Return what the request of a service type is made of.

    Raises:
        LinkError: as `message_shape`.
    """
    return _REQUESTS.get(plain_type(service_type)) or standard_types().request(service_type)


def response_shape(service_type: str) -> Shape:
    """Return what the response of a service type is made of.

    Raises:
        LinkError: as `message_shape`.
    """
    return _RESPONSES.get(plain_type(service_type)) or standard_types().response(service_type)


def standard_types() -> TypeCatalogue:
    """Return the types of ROS 2, as which the embedded robot's messages are laid out.

    Raises:
        LinkError: `rosbags`, which knows them, is not installed.
    """
    from robot_runner.links.type_catalogue import TypeCatalogue  # noqa: PLC0415  # only for types that are not above

    return TypeCatalogue.of(2)
