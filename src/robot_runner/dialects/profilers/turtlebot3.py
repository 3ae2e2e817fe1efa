"""Robot Runner's BasicTurtleBot3: its calls, carried out by our own system plugin on whatever link the robot has."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

from robot_runner.dialects.session import active_context
from robot_runner.errors import LinkError
from robot_runner.links.connect import connect_robot
from robot_runner.plugins.registry import find_plugin

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.events.context import RobotRunnerContext

__all__ = ["BasicTurtleBot3", "BasicTurtleBot3Ros2"]

#: The factor that named the task, and the words for tasks, where they are not ours.
_FACTOR = "mission_task"
_TASKS = {"networking": "Network", "streaming": "Video"}


class BasicTurtleBot3:
    """Executes the circular mission, and records processor, memory and battery ten times a second (`metrics.txt`)."""

    metrics_file = "metrics.txt"

    def __init__(self) -> None:
        self._robot: Any = None
        self._utilisation: Any = None
        self._battery: list[float] = []
        self._subscription: Any = None

    def start_run_mini_mission_real_world(self, context: Any) -> None:
        """Connect to the robot."""
        task = str(context.run_variation.get(_FACTOR, "Computation"))
        task = _TASKS.get(task.casefold(), task.capitalize())
        self._robot = find_plugin("systems", "BasicTurtlebot3").load()(task_factor=None, task=task)  # type: ignore[call-arg]
        self._robot.start_run(_run())

    def start_measurement_mission(self) -> None:
        """Begin to record."""
        self._battery.clear()
        self._subscription = connect_robot(_run()).subscribe(
            "battery_state", "sensor_msgs/BatteryState", lambda message: self._battery.append(message["percentage"])
        )
        self._utilisation = find_plugin("profilers", "PsUtil").load()()
        self._utilisation.start_measurement(_run())

    def launch_mini_mission_real_world(self, context: Any) -> None:
        """Execute the mission."""
        del context
        self._robot.launch_mission(_run())

    def stop_measurement_mission(self) -> None:
        """End the recording; a line of the file holds processor, memory (per cent) and battery."""
        if self._utilisation is None:
            return
        utilisation, self._utilisation = self._utilisation, None
        utilisation.stop_measurement(_run())
        utilisation.stop_run(_run())
        self._subscription.close()
        battery = self._battery[-1] if self._battery else 0.0
        lines = [f"{cpu},{memory},{battery}\n" for cpu, memory in _samples(_run().raw_data_folder / "samples.csv")]
        (_run().run_folder / self.metrics_file).write_text("".join(lines), encoding="ascii")

    def stop_run_mission(self) -> None:
        """Stop the robot."""
        if self._robot is not None:
            self._robot.stop_run(_run())


class BasicTurtleBot3Ros2(BasicTurtleBot3):
    """The same for ROS 2; its file had another name."""

    metrics_file = "metrics.csv"


def _run() -> RobotRunnerContext:
    context = active_context()
    if context is None:
        raise LinkError(
            "the robot can be reached only while a run is executed",
            where="BasicTurtleBot3",
            fix="Call it in start_run and in the events after it.",
        )
    return context


def _samples(path: Path) -> Iterator[tuple[str, str]]:
    if not path.exists():
        return
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            yield row["cpu_percent"], row["memory_percent"]
