"""The robot as the mission uses it: one that says where it is, moves, and works on tasks."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.links.graph_names import full_name, missing
from robot_runner.links.simulation_mark import is_simulation
from robot_runner.plugins.systems.basic_turtlebot3.heartbeat import Heartbeat
from robot_runner.plugins.systems.basic_turtlebot3.motion import Pilot
from robot_runner.plugins.systems.basic_turtlebot3.tasks import TaskServices
from robot_runner.plugins.systems.basic_turtlebot3.wheels import COMMAND_TOPIC, Wheels

if TYPE_CHECKING:
    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import RobotLink
    from robot_runner.plugins.systems.basic_turtlebot3.odometry import Odometer

__all__ = ["Robot"]

#: How long, s, the graph may take to say that the robot hears commands, once its odometry is heard.
_LISTENING_SECONDS = 3.0
_LOOK_PERIOD = 0.1


class Robot:
    """One robot that is reached: what it says and what it can be told.

    Attributes:
        odometer: hears the robot's odometry until the robot is closed.
        pilot: moves it.
        tasks: starts and stops its tasks.
        is_simulated: whether it is a simulated one.
    """

    def __init__(self, link: RobotLink, odometer: Odometer, clock: Clock, *, namespace: str = "") -> None:
        self._link = link
        self._clock = clock
        self._command_topic = full_name(namespace, COMMAND_TOPIC)
        self.odometer = odometer
        self.pilot = Pilot(Wheels(link, namespace=namespace), odometer, clock)
        self.tasks = TaskServices(link)
        self.is_simulated = is_simulation(link, namespace)
        self._subscription = link.subscribe("odom", "nav_msgs/Odometry", odometer.hear)
        self._heartbeat = Heartbeat(link)

    def check_listens(self, *, where: str) -> None:
        """See that somebody hears the robot's velocity commands, before a mission begins that goes nowhere.

        Raises:
            LinkError: nobody does.
        """
        deadline = self._clock.now() + _LISTENING_SECONDS
        while self._command_topic not in (topics := self._link.topics()):
            if self._clock.now() >= deadline:
                fix = "Start the robot's bringup, or correct its namespace."
                raise missing("topic", self._command_topic, topics, where=where, fix=fix)
            self._clock.sleep(_LOOK_PERIOD)

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

        A robot that could not be made safe hears no farewell, so that its watchdog stops it.

        Raises:
            LinkError: the robot cannot be reached.
        """
        with ExitStack() as closing:
            closing.callback(self._subscription.close)
            closing.callback(self._heartbeat.end)
            self.make_safe()
            self._heartbeat.end()
            self._heartbeat.say_farewell()
