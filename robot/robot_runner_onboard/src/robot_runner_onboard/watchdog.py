"""Decides when the robot must stand still because who drives it has fallen silent."""

from __future__ import annotations

import math

__all__ = ["HEARTBEAT_TOPIC", "HEARTBEAT_TYPE", "RELEASE_SERVICE", "Watchdog"]

HEARTBEAT_TOPIC = "robot_runner/heartbeat"
HEARTBEAT_TYPE = "std_msgs/UInt32"
RELEASE_SERVICE = "robot_runner/watchdog/release"


class Watchdog:
    """Hears the heartbeat of a run, and the commands that move the robot.

    Heartbeats count up from 1; a 0 says farewell. From the first heartbeat on, silence means that the link is lost: the
    robot must stand still until a heartbeat is heard again, or a person releases it. Times are in seconds on one
    monotonic clock, given by whoever calls.

    Args:
        heartbeat_timeout: how long the heartbeat may be silent.
        command_timeout: how long the commands may be silent while the robot moves; 0 for as long as they like.

    Example:
        >>> watchdog = Watchdog(heartbeat_timeout=0.5)
        >>> watchdog.hear_heartbeat(1, now=10.0)
        >>> watchdog.must_stop(10.4), watchdog.must_stop(10.6)
        (False, True)
    """

    def __init__(self, heartbeat_timeout: float = 0.4, command_timeout: float = 0.0) -> None:
        for name, timeout in (("heartbeat_timeout", heartbeat_timeout), ("command_timeout", command_timeout)):
            if not 0 <= timeout < math.inf:
                raise ValueError(f"{name} is {timeout!r}: set it to seconds, 0 or more")
        self._heartbeat_timeout = heartbeat_timeout
        self._command_timeout = command_timeout
        self._heartbeat_at: float | None = None
        self._moved_at: float | None = None

    def hear_heartbeat(self, count: int, now: float) -> None:
        """Take a heartbeat."""
        self._heartbeat_at = now if count else None

    def hear_command(self, is_moving: bool, now: float) -> None:
        """Take a velocity command: whether it moves the robot, or has it stand still."""
        self._moved_at = now if is_moving else None

    def release(self) -> None:
        """Let the robot be moved by somebody else, until the next heartbeat."""
        self._heartbeat_at = self._moved_at = None

    def must_stop(self, now: float) -> bool:
        """Whether the robot must be told to stand still at this moment."""
        return _is_over(self._heartbeat_at, self._heartbeat_timeout, now) or _is_over(
            self._moved_at, self._command_timeout, now
        )


def _is_over(heard_at: float | None, timeout: float, now: float) -> bool:
    return heard_at is not None and timeout > 0 and now - heard_at > timeout
