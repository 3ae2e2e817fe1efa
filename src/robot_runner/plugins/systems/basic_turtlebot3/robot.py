"""The robot as the mission uses it: one that says where it is, moves, and works on tasks."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.plugins.systems.basic_turtlebot3.motion import Pilot
from robot_runner.plugins.systems.basic_turtlebot3.tasks import TaskServices

if TYPE_CHECKING:
    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.plugins.systems.basic_turtlebot3.odometry import Odometer

__all__ = ["Robot"]


class Robot:
    """One robot that is reached: what it says and what it can be told.

    Attributes:
        odometer: hears the robot's odometry until the robot is closed.
        pilot: moves it.
        tasks: starts and stops its tasks.
        is_simulated: whether it is a simulated one.
    """

    def __init__(self, link: RobotLink, odometer: Odometer, clock: Clock) -> None:
        self.odometer = odometer
        self.pilot = Pilot(link, odometer, clock)
        self.tasks = TaskServices(link)
        self.is_simulated = link.is_simulated
        self._subscription = link.subscribe("odom", "nav_msgs/Odometry", odometer.hear)

    def make_safe(self) -> None:
        """Stop the wheels, and the tasks even if the wheels cannot be reached.

        Raises:
            LinkError: the robot cannot be reached.
        """
        with ExitStack() as closing:
            closing.callback(self.tasks.stop_all)
            closing.callback(self.pilot.stop)

    def close(self) -> None:
        """Make it safe and listen to it no more; closing twice does no harm.

        Raises:
            LinkError: the robot cannot be reached.
        """
        with ExitStack() as closing:
            closing.callback(self._subscription.close)
            closing.callback(self.make_safe)
