"""The node that has the robot stand still when who drives it has fallen silent."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot_runner_onboard.watchdog import HEARTBEAT_TOPIC, RELEASE_SERVICE, Watchdog
from std_msgs.msg import UInt32
from std_srvs.srv import Trigger

from robot_runner_ros2.running import run

if TYPE_CHECKING:
    from typing import Union

    from rclpy.topic_endpoint_info import TopicEndpointInfo

    Command = Union[Twist, TwistStamped]

__all__ = ["main"]

#: How often, in seconds, it is looked whether the robot must stand still, and how often it is told so.
_LOOK_PERIOD = 0.05
#: How often, in seconds, it is looked of which type the robot's commands are.
_SEARCH_PERIOD = 0.5
#: Who asks for best effort hears reliable publishers too.
_HEARING = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
#: The TurtleBot3 takes stamped commands from ROS 2 Jazzy on.
_KINDS = {"geometry_msgs/msg/Twist": Twist, "geometry_msgs/msg/TwistStamped": TwistStamped}


class _WatchdogNode(Node):
    def __init__(self) -> None:
        super().__init__("robot_runner_watchdog")
        timeouts = {name: self.declare_parameter(name, default).value for name, default in _DEFAULTS.items()}
        self._watchdog = Watchdog(**timeouts)
        self._is_stopping = False
        self._topic = self.resolve_topic_name("cmd_vel")
        self._served = {}
        self.create_subscription(UInt32, HEARTBEAT_TOPIC, self._hear_heartbeat, _HEARING)
        self.create_service(Trigger, RELEASE_SERVICE, self._release)
        # The robot must stop on time, however fast the time of a simulation goes by.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_PERIOD, self._look, clock=steady)
        self.create_timer(_SEARCH_PERIOD, self._search, clock=steady)

    def _search(self) -> None:
        """Serve each type in which others hear commands; a robot may come later, or come back with another type."""
        heard = {kind for kind in map(self._kind_heard, self.get_subscriptions_info_by_topic(self._topic)) if kind}
        for kind in self._served.keys() - heard:  # its presence would have others refused
            publisher, subscription = self._served.pop(kind)
            self.destroy_publisher(publisher)
            self.destroy_subscription(subscription)
        for kind in heard - self._served.keys():
            hear = partial(self._hear_command, kind)
            subscription = self.create_subscription(kind, "cmd_vel", hear, _HEARING)
            self._served[kind] = self.create_publisher(kind, "cmd_vel", 1), subscription
            self.get_logger().info(f"it watches who hears {kind.__name__} on {self._topic}")

    def _kind_heard(self, listener: TopicEndpointInfo) -> type[Command] | None:
        is_own = (listener.node_name, listener.node_namespace) == (self.get_name(), self.get_namespace())
        return None if is_own else _KINDS.get(listener.topic_type)

    def _look(self) -> None:
        must_stop = self._watchdog.must_stop(time.monotonic())
        if must_stop:
            for kind, (publisher, _) in self._served.items():
                publisher.publish(self._standstill(kind))
        if must_stop and not self._is_stopping:
            self.get_logger().warning("the run has fallen silent: the robot is stopped until it is heard again")
        if self._is_stopping and not must_stop:
            self.get_logger().info("the robot may move again")
        self._is_stopping = must_stop

    def _standstill(self, kind: type[Command]) -> Command:
        command = kind()
        if kind is TwistStamped:
            command.header.stamp = self.get_clock().now().to_msg()
        return command

    def _hear_heartbeat(self, message: UInt32) -> None:
        self._watchdog.hear_heartbeat(message.data, time.monotonic())

    def _hear_command(self, kind: type[Command], message: Command) -> None:
        twist = message.twist if kind is TwistStamped else message
        is_moving = any(value for part in (twist.linear, twist.angular) for value in (part.x, part.y, part.z))
        self._watchdog.hear_command(is_moving, time.monotonic())

    def _release(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._watchdog.release()
        response.success, response.message = True, "the robot may be moved until the next heartbeat"
        return response


_DEFAULTS = {"heartbeat_timeout": 0.4, "command_timeout": 0.0}


def main() -> None:
    """Watch until the node is told to end."""
    run(_WatchdogNode)
