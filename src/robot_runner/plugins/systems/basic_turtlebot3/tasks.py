"""The tasks of the robot's computer, started and stopped through services."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import LinkError

if TYPE_CHECKING:
    from robot_runner.links.robot import RobotLink
    from robot_runner.plugins.systems.basic_turtlebot3.mission import Task

__all__ = ["TaskServices"]

_TRIGGER = "std_srvs/Trigger"


class TaskServices:
    """Calls `task/<task>/start`, `task/<task>/stop` and `task/stop`, which stops whichever is going on."""

    def __init__(self, link: RobotLink) -> None:
        self._link = link

    def start(self, task: Task) -> None:
        """Start a task.

        Raises:
            LinkError: the robot cannot be reached, has no such service, or refuses.
        """
        self._call(f"task/{task.value}/start")

    def stop(self, task: Task) -> None:
        """Stop a task that is going on.

        Raises:
            LinkError: the robot cannot be reached, has no such service, or refuses.
        """
        self._call(f"task/{task.value}/stop")

    def stop_all(self) -> None:
        """Stop whatever is going on; that nothing is, is no fault.

        Raises:
            LinkError: the robot cannot be reached or has no such service.
        """
        self._link.call("task/stop", _TRIGGER)

    def _call(self, service: str) -> None:
        response = self._link.call(service, _TRIGGER)
        if not response.get("success", False):
            raise LinkError(
                f"the robot refused: {response.get('message') or 'no reason given'}",
                where=f"service {service}",
                fix="Look at the log of the task's node on the robot.",
            )
