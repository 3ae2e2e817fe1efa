"""An action server on the embedded robot that drives it ahead, and the ways in which one can fail."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.links.connect import connect_robot
from robot_runner.core.links.goals import ActionAborted, ActionCanceled

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.events.context import Clock, RobotRunnerContext
    from robot_runner.core.links.robot import RobotLink

__all__ = ["ACTION", "ACTION_TYPE", "DriveServer", "goal_at", "offered"]

ACTION, ACTION_TYPE = "navigate_to_pose", "nav2_msgs/NavigateToPose"
_TWIST = "geometry_msgs/Twist"


def goal_at(x: Any) -> dict[str, Any]:
    """Return the goal so far ahead."""
    return {"pose": {"pose": {"position": {"x": x}, "orientation": {"w": 1.0}}}}


class DriveServer:
    """Drives ahead until the robot is where the goal says.

    Args:
        link: to the robot.
        clock: its.
        aborts_at: gives up there, m.
        obeys: whether it ends when it is asked to.
    """

    def __init__(self, link: RobotLink, clock: Clock, *, aborts_at: float = 99.0, obeys: bool = True) -> None:
        self.link, self.clock = link, clock
        self.aborts_at, self.obeys = aborts_at, obeys
        self.x = 0.0
        self.goals: list[float] = []
        self.cancelled = 0
        link.subscribe("odom", "nav_msgs/Odometry", self._take)

    def _take(self, odometry: Any) -> None:
        self.x = odometry["pose"]["pose"]["position"]["x"]

    def execute(self, execution: Any) -> dict[str, Any]:
        """Execute one goal."""
        goal = execution.goal["pose"]["pose"]["position"]["x"]
        self.goals.append(goal)
        try:
            while self.x < goal:
                if execution.is_cancel_requested and self.obeys:
                    self.cancelled += 1
                    raise ActionCanceled
                if self.x > self.aborts_at:
                    raise ActionAborted("no valid path", {"error_code": 208})
                self.link.publish("cmd_vel", _TWIST, {"linear": {"x": 0.2}})
                execution.feedback({"distance_remaining": goal - self.x, "number_of_recoveries": 2})
                self.clock.sleep(0.1)
        finally:
            self.link.publish("cmd_vel", _TWIST, {})
        return {}


def offered(
    context: RobotRunnerContext, *, accept: Callable[[Any], bool] | None = None, namespace: str = "", **more: Any
) -> DriveServer:
    """Offer the action on the robot of a run."""
    link = connect_robot(context, namespace=namespace)
    server = DriveServer(link, context.clock, **more)
    link.offer_action(ACTION, ACTION_TYPE, server.execute, accept=accept)
    return server
