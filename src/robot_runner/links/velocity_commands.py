"""Velocity commands: the two types that robots hear them in."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.links.robot import Message

__all__ = ["TWIST", "TWIST_STAMPED", "VELOCITY_COMMANDS", "velocity_command", "velocity_of"]

TWIST = "geometry_msgs/Twist"
#: What a TurtleBot3 hears by default from ROS 2 Jazzy on.
TWIST_STAMPED = "geometry_msgs/TwistStamped"
#: A robot goes on carrying out such a command until the next one: a link on which one was published ends with zero.
VELOCITY_COMMANDS = frozenset({TWIST, TWIST_STAMPED})


def velocity_command(message_type: str, speed: float, rate: float) -> Message:
    """Return the command to move ahead at `speed` in m/s and to turn at `rate` in rad/s.

    A stamp is left at zero, which robots take as "now": by one from a laptop whose clock is a second off, a robot would
    take the command as too old, and with it the one to stand still.

    Example:
        >>> velocity_command(TWIST_STAMPED, 0.2, 0.0)["twist"]["linear"]
        {'x': 0.2, 'y': 0.0, 'z': 0.0}
    """
    twist = {"linear": {"x": speed, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": rate}}
    return {"twist": twist} if message_type == TWIST_STAMPED else twist


def velocity_of(message_type: str, message: Message) -> Message:
    """Return the part of a command that is the velocity: `linear` and `angular`.

    Example:
        >>> velocity_of(TWIST_STAMPED, {"twist": {"linear": {"x": 0.2}}})
        {'linear': {'x': 0.2}}
    """
    twist: Message = message.get("twist", {}) if message_type == TWIST_STAMPED else message
    return twist
