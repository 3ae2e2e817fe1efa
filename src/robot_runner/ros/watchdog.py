"""The messages for a robot's watchdog, and its decision that the robot must stand still.

The watchdog's nodes for real robots (`robot/`) decide in the same way; they have code of their own because they keep to
the robot's Python. The tests hold both to one suite.
"""

from __future__ import annotations

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Message

TWIST = "geometry_msgs/Twist"
#: The type that a TurtleBot3 subscribes by default from ROS 2 Jazzy on.
TWIST_STAMPED = "geometry_msgs/TwistStamped"


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


def planar(twist: Message) -> tuple[float, float]:
    """Return how fast a velocity moves a robot on wheels: ahead, m/s, and round, rad/s.

    Example:
        >>> planar({"linear": {"x": 0.2}, "angular": {"z": 0.1}})
        (0.2, 0.1)
    """
    return float(twist["linear"]["x"]), float(twist["angular"]["z"])


#: Counts up from 1 while a run operates the robot; a 0 says farewell.
HEARTBEAT_TOPIC = "robot_runner/heartbeat"
HEARTBEAT_TYPE = "std_msgs/UInt32"
#: For a person who wants to drive a robot that the watchdog holds.
RELEASE_SERVICE = "robot_runner/watchdog/release"
RELEASE_TYPE = "std_srvs/Trigger"


class Watchdog:
    """Decides when a robot must stand still because the run that drives it has fallen silent.

    From the first heartbeat on, silence means that the link is lost: the robot must stand still until a heartbeat is
    received again, or a person releases it. Times are in seconds on one monotonic clock, given by the caller.

    Args:
        heartbeat_timeout: how long the heartbeat may be silent, s; 0 for as long as it likes.
        command_timeout: how long the commands may be silent while the robot moves, s; 0 for as long as they like.

    Raises:
        LinkError: a time-out is negative.

    Example:
        >>> watchdog = Watchdog(heartbeat_timeout=0.4)
        >>> watchdog.hear_heartbeat(1, now=10.0)
        >>> watchdog.must_stop(10.3), watchdog.must_stop(10.5)
        (False, True)
    """

    def __init__(self, *, heartbeat_timeout: float = 0.4, command_timeout: float = 0.0) -> None:
        if heartbeat_timeout < 0 or command_timeout < 0:
            problem = f"the time-outs are {heartbeat_timeout!r} s and {command_timeout!r} s"
            raise LinkError(problem, where="the watchdog", fix="Give 0 or more.")
        self._heartbeat_timeout = heartbeat_timeout
        self._command_timeout = command_timeout
        self._heartbeat_at: float | None = None
        self._moved_at: float | None = None

    def hear_heartbeat(self, count: int, now: float) -> None:
        """Note a heartbeat."""
        self._heartbeat_at = now if count else None

    def hear_command(self, is_moving: bool, now: float) -> None:
        """Note a velocity command, and whether it moves the robot."""
        self._moved_at = now if is_moving else None

    def release(self) -> None:
        """Let a person move the robot, until the next heartbeat."""
        self._heartbeat_at = self._moved_at = None

    def must_stop(self, now: float) -> bool:
        """Whether a stop has to be commanded at this moment."""
        heard = ((self._heartbeat_at, self._heartbeat_timeout), (self._moved_at, self._command_timeout))
        return any(at is not None and timeout > 0 and now - at > timeout for at, timeout in heard)
