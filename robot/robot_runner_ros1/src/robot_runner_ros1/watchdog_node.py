"""The node that has the robot stand still when who drives it has fallen silent."""

from __future__ import annotations

import time

import rospy
from geometry_msgs.msg import Twist
from robot_runner_onboard.watchdog import HEARTBEAT_TOPIC, RELEASE_SERVICE, Watchdog
from std_msgs.msg import UInt32
from std_srvs.srv import Trigger, TriggerResponse

__all__ = ["main"]

#: How often, in seconds, it is looked whether the robot must stand still, and how often it is told so.
_LOOK_PERIOD = 0.05


class _Node:
    def __init__(self) -> None:
        timeouts = {name: rospy.get_param("~" + name, default) for name, default in _DEFAULTS.items()}
        self._watchdog = Watchdog(**timeouts)
        self._is_stopping = False
        self._commands = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        rospy.Subscriber(HEARTBEAT_TOPIC, UInt32, self._hear_heartbeat, tcp_nodelay=True)
        rospy.Subscriber("cmd_vel", Twist, self._hear_command, tcp_nodelay=True)
        rospy.Service(RELEASE_SERVICE, Trigger, self._release)

    def look(self) -> None:
        """Tell the robot to stand still if it must."""
        must_stop = self._watchdog.must_stop(time.monotonic())
        if must_stop:
            self._commands.publish(Twist())
        if must_stop and not self._is_stopping:
            rospy.logwarn("the run has fallen silent: the robot is stopped until it is heard again")
        if self._is_stopping and not must_stop:
            rospy.loginfo("the robot may move again")
        self._is_stopping = must_stop

    def _hear_heartbeat(self, message: UInt32) -> None:
        self._watchdog.hear_heartbeat(message.data, time.monotonic())

    def _hear_command(self, message: Twist) -> None:
        parts = (message.linear, message.angular)
        is_moving = any(value for part in parts for value in (part.x, part.y, part.z))
        self._watchdog.hear_command(is_moving, time.monotonic())

    def _release(self, _request: Trigger) -> TriggerResponse:
        self._watchdog.release()
        return TriggerResponse(success=True, message="the robot may be moved until the next heartbeat")


_DEFAULTS = {"heartbeat_timeout": 0.4, "command_timeout": 0.0}


def main() -> None:
    """Watch until the node is shut down."""
    rospy.init_node("robot_runner_watchdog")
    node = _Node()
    while not rospy.is_shutdown():
        node.look()
        time.sleep(_LOOK_PERIOD)  # the robot must stop on time, however fast the time of a simulation goes by
