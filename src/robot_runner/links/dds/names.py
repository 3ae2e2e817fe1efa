"""The names that ROS 2 gives to topics, services and types on DDS, and back."""

from __future__ import annotations

__all__ = [
    "reply_topic",
    "request_topic",
    "ros_service",
    "ros_service_type",
    "ros_topic",
    "ros_type",
    "wire_topic",
    "wire_type_name",
]

# https://design.ros2.org/articles/topic_and_service_names.html: the prefixes of what ROS 2 puts on DDS.
_TOPIC, _REQUEST, _REPLY = "rt", "rq", "rr"
_REQUEST_END, _REPLY_END = "Request", "Reply"
_TYPE_PARTS = 4


def wire_topic(name: str) -> str:
    """Return the DDS topic of a ROS topic, given by its full name."""
    return _TOPIC + name


def request_topic(service: str) -> str:
    """Return the DDS topic that requests of a service are sent on."""
    return f"{_REQUEST}{service}{_REQUEST_END}"


def reply_topic(service: str) -> str:
    """Return the DDS topic that responses of a service are sent on."""
    return f"{_REPLY}{service}{_REPLY_END}"


def ros_topic(wire_name: str) -> str | None:
    """Return the ROS topic of a DDS topic, or None if it is none.

    Example:
        >>> ros_topic("rt/odom"), ros_topic("ros_discovery_info")
        ('/odom', None)
    """
    return wire_name.removeprefix(_TOPIC) if wire_name.startswith(f"{_TOPIC}/") else None


def ros_service(wire_name: str) -> str | None:
    """Return the service whose requests a DDS topic carries, or None if it carries none.

    Example:
        >>> ros_service("rq/task/stopRequest"), ros_service("rr/task/stopReply")
        ('/task/stop', None)
    """
    if wire_name.startswith(f"{_REQUEST}/") and wire_name.endswith(_REQUEST_END):
        return wire_name.removeprefix(_REQUEST).removesuffix(_REQUEST_END)
    return None


def wire_type_name(message_type: str, kind: str = "msg") -> str:
    """Return the DDS type of a ROS type.

    Example:
        >>> wire_type_name("geometry_msgs/Twist"), wire_type_name("std_srvs/Trigger_Request", "srv")
        ('geometry_msgs::msg::dds_::Twist_', 'std_srvs::srv::dds_::Trigger_Request_')
    """
    package, _, name = message_type.partition("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(wire_name: str) -> str:
    """Return the ROS type of a DDS type; one that is none of ROS stays as it is.

    Example:
        >>> ros_type("geometry_msgs::msg::dds_::Twist_"), ros_type("HelloWorld")
        ('geometry_msgs/Twist', 'HelloWorld')
    """
    parts = wire_name.split("::")
    if len(parts) == _TYPE_PARTS and parts[2] == "dds_":
        return f"{parts[0]}/{parts[3].removesuffix('_')}"
    return wire_name


def ros_service_type(wire_name: str) -> str:
    """Return the service type of the DDS type of its requests.

    Example:
        >>> ros_service_type("std_srvs::srv::dds_::Trigger_Request_")
        'std_srvs/Trigger'
    """
    return ros_type(wire_name).removesuffix("_Request")
