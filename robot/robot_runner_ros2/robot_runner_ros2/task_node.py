"""The node that starts and stops the tasks."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from rclpy.node import Node
from robot_runner_onboard.parameters import PARAMETERS, task_commands
from robot_runner_onboard.task_desk import TaskDesk
from std_srvs.srv import Trigger

from robot_runner_ros2.running import run

if TYPE_CHECKING:
    from typing import Callable

__all__ = ["main"]

_TOPIC_RECORDER = [sys.executable, "-m", "robot_runner_ros2.topic_recorder"]


class _TaskNode(Node):
    def __init__(self) -> None:
        super().__init__("robot_runner_tasks")
        given = {name: self._parameter(name, default) for name, default in PARAMETERS.items()}
        given["video/topic"] = self.resolve_topic_name(given["video/topic"])
        self._desk = TaskDesk(task_commands(given, _TOPIC_RECORDER))
        for name, answer in self._desk.services().items():
            self.create_service(Trigger, name, self._responder(answer))
        self.get_logger().info(f"the tasks are offered under {self.get_namespace().rstrip('/')}/task")

    def destroy_node(self) -> None:
        """Stop the task that is going on, and close the node."""
        self._desk.stop_all()
        super().destroy_node()

    def _parameter(self, name: str, default: object) -> object:
        """Return a parameter; ROS 2 has a dot where ROS 1 has a slash."""
        return self.declare_parameter(name.replace("/", "."), default).value

    def _responder(
        self, answer: Callable[[], tuple[bool, str]]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def respond(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = answer()
            if response.success:
                self.get_logger().info(response.message)
            else:
                self.get_logger().error(response.message)
            return response

        return respond


def main() -> None:
    """Offer the services of the tasks until the node is told to end; then stop what is going on."""
    run(_TaskNode)
