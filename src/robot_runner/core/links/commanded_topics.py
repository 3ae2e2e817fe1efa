"""The topics on which this process commands a robot's velocity: who stands by stops it there should the process die."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_listeners: list[Callable[[str, str], object]] = []


def hear_commanded(listener: Callable[[str, str], object]) -> None:
    """Have the full name and the type of each topic told on which a velocity is about to be commanded."""
    _listeners.append(listener)


def tell_commanded(topic: str, message_type: str) -> None:
    """Say that velocities will be commanded on a topic; a message of its type without any field stops the robot.

    Example:
        >>> hear_commanded(print)
        >>> tell_commanded("/alice/cmd_vel", "geometry_msgs/Twist")
        /alice/cmd_vel geometry_msgs/Twist
        >>> _listeners.clear()
    """
    for listener in _listeners:
        listener(topic, message_type)
