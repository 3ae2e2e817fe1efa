"""The phases of a mission on disk, each as soon as it is over."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from robot_runner.plugins.systems.basic_turtlebot3.mission import Phase, Task
    from robot_runner.plugins.systems.basic_turtlebot3.odometry import Pose

__all__ = ["PhaseLog"]

_HEADING = ("number", "phase", "task", "start_s", "end_s", "x_m", "y_m", "heading_rad")


class PhaseLog:
    """Writes one row a phase: its times on the run's clock, and the pose of the odometry at its end."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(_HEADING)
        self._count = 0

    def add(self, phase: Phase, task: Task | None, start: float, end: float, pose: Pose) -> None:
        """Write the row of a phase that is over, and flush it."""
        self._count += 1
        numbers = (f"{number:.4f}" for number in (start, end, pose.x, pose.y, pose.heading))
        self._rows.writerow((self._count, phase.kind.value, task.value if task else "", *numbers))
        self._file.flush()
