"""The robot's wheels: velocity commands of the type that the robot hears."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.links.graph_names import full_name
from robot_runner.links.velocity_commands import TWIST, VELOCITY_COMMANDS, velocity_command

if TYPE_CHECKING:
    from robot_runner.links.robot import RobotLink

__all__ = ["COMMAND_TOPIC", "Wheels"]

#: What the robot hears its velocities on.
COMMAND_TOPIC = "cmd_vel"


class Wheels:
    """Tells a robot how fast to move: as `TwistStamped` where its graph carries that, and as `Twist` elsewhere.

    A TurtleBot3 hears `Twist` up to ROS 2 Humble, and `TwistStamped` by default from Jazzy on.

    Args:
        link: to the robot.
        namespace: the robot's.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> link.known_topics = {"cmd_vel": "geometry_msgs/TwistStamped"}
        >>> Wheels(link).command(0.2, 0.0)
        >>> link.publications[-1].message["twist"]["linear"]["x"]
        0.2
    """

    def __init__(self, link: RobotLink, *, namespace: str = "") -> None:
        self._link = link
        self._topic = full_name(namespace, COMMAND_TOPIC)
        self._type: str | None = None

    def command(self, speed: float, rate: float) -> None:
        """Move ahead at `speed` in m/s and turn at `rate` in rad/s until the next command.

        Raises:
            LinkError: the robot cannot be reached, or hears neither type.
        """
        message_type = self._type or self._heard_type()
        self._link.publish(COMMAND_TOPIC, message_type, velocity_command(message_type, speed, rate))

    def _heard_type(self) -> str:
        heard = self._link.topics().get(self._topic)
        if heard in VELOCITY_COMMANDS:
            self._type = heard
        # Where it is another, or the robot is not heard of yet, the link says so, or asks again next time.
        return self._type or TWIST
