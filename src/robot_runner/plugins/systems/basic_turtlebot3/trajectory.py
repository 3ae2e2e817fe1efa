"""The way that the robot takes during a mission, by its odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.plugins.sampling.raw_files import Column, write_samples

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.plugins.systems.basic_turtlebot3.odometry import Pose

__all__ = ["Trajectory"]

#: Poses a second: at top speed they are 2 cm apart, finer than any figure of the way shows.
_RATE = 10.0


class Trajectory:
    """Keeps at most ten poses a second, and writes them when the mission is over.

    Example:
        >>> from robot_runner.plugins.systems.basic_turtlebot3.odometry import Pose
        >>> way = Trajectory()
        >>> for moment in (0.0, 0.03, 0.1):
        ...     way.add(moment, Pose(moment * 0.2, 0.0, 0.0))
        >>> len(way)
        2
    """

    def __init__(self) -> None:
        self._rows: list[tuple[float, float, float, float]] = []
        self._due = float("-inf")

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, time: float, pose: Pose) -> None:
        """Take a pose of this moment on the run's clock, s; one that comes too soon after the last is left out."""
        if time < self._due - 1e-9:  # clocks round
            return
        self._due = time + 1.0 / _RATE
        self._rows.append((time, pose.x, pose.y, pose.heading))

    def write(self, path: Path) -> None:
        """Write what was taken, with times in s, places in m and headings in rad."""
        columns = list(zip(*self._rows, strict=True)) or [()] * 4
        names = ("time_s", "x_m", "y_m", "heading_rad")
        write_samples(path, [Column(name, values, "%.4f") for name, values in zip(names, columns, strict=True)])
