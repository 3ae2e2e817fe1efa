"""The node that starts and stops the tasks."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import rospy
from robot_runner_onboard.parameters import PARAMETERS, task_commands
from robot_runner_onboard.task_desk import TaskDesk
from std_srvs.srv import Trigger, TriggerResponse

if TYPE_CHECKING:
    from typing import Callable

__all__ = ["main"]

_TOPIC_RECORDER = [sys.executable, "-m", "robot_runner_ros1.topic_recorder"]


def main() -> None:
    """Offer the services of the tasks until the node is shut down; then stop what is going on."""
    rospy.init_node("robot_runner_tasks")
    given = {name: rospy.get_param("~" + name, default) for name, default in PARAMETERS.items()}
    given["video/topic"] = rospy.resolve_name(given["video/topic"])
    desk = TaskDesk(task_commands(given, _TOPIC_RECORDER))
    rospy.on_shutdown(desk.stop_all)
    for name, answer in desk.services().items():
        rospy.Service(name, Trigger, lambda _request, answer=answer: _response(answer))
    rospy.loginfo("the tasks are offered under %s", rospy.resolve_name("task"))
    rospy.spin()


def _response(answer: Callable[[], tuple[bool, str]]) -> TriggerResponse:
    success, message = answer()
    (rospy.loginfo if success else rospy.logerr)(message)
    return TriggerResponse(success=success, message=message)
